"""The IF path is AC-coupled."""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import fft

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe, geometric
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class AcCoupling(Effect, name='ac_coupling', of=Of.STATION):
    """First-order high-pass between mixer and amplifier, at rest as the record begins; noise passes it too.

    What the capacitor holds, a first-order low-pass, is taken off. It is discretised as that of `if_filter`. The
    record's spectrum is padded with as many zeros; what is left of the exponential after these is taken out.
    """

    title = 'AC coupling'
    acts_on = ActsOn.SAMPLES
    formula = 'X(f) → X(f) j f / (pole + j f)'
    example = {'pole': 2e4}
    stage = Stage.FILTER
    recipes = (Recipe('', {}, {'pole': 2e4}, {'pole': geometric(1e3, 1e6, 10)}),)

    pole: float = parameter(unit='Hz', bounds=(0.0, 1e9), description='frequency at which the power is halved')

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
        period = fft.next_fast_len(2 * count, real=True)
        frequency = np.arange(period // 2 + 1) * (rate / period)
        response = (1.0 / (1.0 + 1j * frequency / self.pole)).astype(np.complex64)
        # the circle's next turn begins with what an amplitude at mid-padding has become
        middle = (count + period) // 2
        later = np.arange(period - middle, period - middle + count) / rate
        fading = np.exp(-2.0 * np.pi * self.pole * later).astype(np.float32)
        channels = [signal[..., 0], signal[..., 1]] if station.iq else [signal]
        for channel in channels:
            held = fft.irfft(fft.rfft(channel, period) * response, period)
            channel -= held[:, :count] - held[:, middle, None] * fading
