"""The IF path is AC-coupled."""

import dataclasses
from collections.abc import Callable

import numpy as np
import scipy

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe, geometric
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class AcCoupling(Effect, name='ac_coupling', of=Of.STATION):
    """First-order high-pass between mixer and amplifier, at rest when a record begins. It filters signal and noise.

    The filter subtracts the capacitor's voltage, which is the output of a first-order low-pass. The low-pass is
    discretised as in `if_filter`, with the record padded by as many zeros. The exponential that the padding does not
    let decay is subtracted.
    """

    title = 'AC coupling'
    evidence = 'droop'
    acts_on = ActsOn.SAMPLES
    formula = 'X(f) → X(f) j f / (pole + j f)'
    example = {'pole': 2e4}
    stage = Stage.FILTER
    recipes = (Recipe('', {}, {'pole': 2e4}, {'pole': geometric(1e3, 1e6, 10)}),)

    pole: float = parameter(unit='Hz', bounds=(0.0, 1e9), description='frequency at which the filter halves the power')

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Filter the signal."""
        if self.pole == 0.0:
            return
        rate = (station.sweep.sample_rate * station.sample_clock)[:, None]
        count = signal.shape[1]
        period = scipy.fft.next_fast_len(2 * count, real=True)
        frequency = np.arange(period // 2 + 1) * (rate / period)
        response = (1.0 / (1.0 + 1j * frequency / self.pole)).astype(np.complex64)
        # the transform is periodic: its next period begins with what is left of the voltage at mid-padding
        middle = (count + period) // 2
        later = np.arange(period - middle, period - middle + count) / rate
        fading = np.exp(-2.0 * np.pi * self.pole * later).astype(np.float32)
        channels = [signal[..., 0], signal[..., 1]] if station.iq else [signal]
        for channel in channels:
            held = scipy.fft.irfft(scipy.fft.rfft(channel, period) * response, period)
            channel -= held[:, :count] - held[:, middle, None] * fading
