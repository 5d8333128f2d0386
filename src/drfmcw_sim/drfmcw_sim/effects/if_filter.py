"""The IF path filters out high frequencies."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import scipy

from drfmcw_physics.settings import parameter

from ..measurements import Measurements, Station
from .base import Effect
from .recipe import Recipe, geometric
from .traits import ActsOn, Of, Stage


@dataclasses.dataclass(frozen=True)
class IfFilter(Effect, name='if_filter', of=Of.STATION):
    """First-order low-pass between mixer and amplifier. It filters signal and leakage, and by default the noise.

    The record is padded with as many zeros, and its spectrum is multiplied by the analogue response H(f) up to the
    Nyquist frequency. This is exact for signals without aliasing, even if the pole lies above the Nyquist frequency.
    The cut-off there rings: n samples after a step of the signal, the error is |Im H(f_s/2)| / (pi n) of the step.
    """

    title = 'IF filter'
    acts_on = ActsOn.SAMPLES
    formula = 'X(f) → X(f) / (1 + j f / pole)'
    example = {'pole': 2e6}
    stage = Stage.FILTER
    recipes = (
        Recipe('', {}, {'pole': 2e6}, {'pole': geometric(3e5, 2e7, 8)}),
        Recipe('', {'noise_behind': True}, {'pole': 2e6}, {'pole': geometric(3e5, 2e7, 8)}),
    )

    pole: float = parameter(unit='Hz', bounds=(1e3, 1e18), description='frequency at which the filter halves the power')
    noise_behind: bool = parameter(
        False, description="true if the receiver's noise enters behind the filter, which then does not filter it"
    )

    @property
    def memory(self) -> float:
        """Time constant of the pole [s]."""
        return 1.0 / (2.0 * math.pi * self.pole)

    def prepare(self, m: Measurements) -> None:
        """Set where the noise enters."""
        for station in self.own_stations(m):
            station.noise_behind |= self.noise_behind

    def receive(
        self,
        signal: np.ndarray,
        station: Station,
        m: Measurements,
        streams: Callable[[], list[np.random.Generator]],
    ) -> None:
        """Filter the signal."""
        rate = station.sweep.sample_rate * station.sample_clock
        if np.all(rate < 1e-7 * self.pole):  # nothing that float32 could hold
            return
        count = signal.shape[1]
        period = scipy.fft.next_fast_len(2 * count, real=True)
        frequency = np.arange(period // 2 + 1) * (rate / period)[:, None]
        response = (1.0 / (1.0 + 1j * frequency / self.pole)).astype(np.complex64)
        channels = [signal[..., 0], signal[..., 1]] if station.iq else [signal]
        for channel in channels:
            channel[...] = scipy.fft.irfft(scipy.fft.rfft(channel, period) * response, period)[:, :count]
