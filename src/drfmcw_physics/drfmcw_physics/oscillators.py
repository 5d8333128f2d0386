"""A station's clocks, and how their frequency offsets change the measured range (eqs. 7-13, 18-21)."""

import dataclasses
import functools
import math
from typing import Any, TypeVar

import numpy as np

from .settings import parameter

Alpha = TypeVar('Alpha', float, np.ndarray)


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Indoor calibration stored on a station; the fields of StationCalibration."""

    station: str
    alpha: float = parameter(1.0, bounds=(0.999, 1.001), description='reference frequency / nominal')
    sample_clock_alpha: float = parameter(1.0, bounds=(0.999, 1.001), description='ADC clock / nominal ADC clock')
    temperature: float = parameter(
        25.0, unit='degC', bounds=(-100.0, 150.0), description='board temperature at which both were measured'
    )
    delay: float = parameter(
        0.0, unit='s', bounds=(-1e-3, 1e-3), description="hardware delay of this station's part of the path"
    )
    noise_floor: float = parameter(
        math.nan,
        unit='dBm/Hz',
        bounds=(-250.0, 0.0),
        nan_means='not characterised',
        description='additive noise at the receive antenna port',
    )
    phase_noise_level: float = parameter(
        math.nan,
        unit='dBc/Hz',
        bounds=(-250.0, 0.0),
        nan_means='not characterised',
        description='single side-band phase noise at 100 kHz offset',
    )
    phase_noise_corner: float = parameter(
        math.nan,
        unit='Hz',
        bounds=(1.0, 1e9),
        nan_means='not characterised',
        description='corner of the one-pole phase-noise shape: flat below, -20 dB per decade above',
    )
    alpha_std: float = parameter(
        0.0, bounds=(0.0, 1e-3), description='one standard deviation of alpha, in the whole temperature range'
    )
    sample_clock_alpha_std: float = parameter(
        0.0, bounds=(0.0, 1e-3), description='one standard deviation of sample_clock_alpha, in the whole range'
    )
    delay_std: float = parameter(
        0.0, unit='s', bounds=(0.0, 1e-3), description="one standard deviation of delay, of the pair's with delay_peer"
    )
    alpha_linear: float = parameter(
        0.0, unit='1/K', bounds=(-1e-5, 1e-5), description='alpha over board temperature: factor of d = T - temperature'
    )
    alpha_quadratic: float = parameter(0.0, unit='1/K^2', bounds=(-1e-6, 1e-6), description='factor of d^2')
    alpha_cubic: float = parameter(0.0, unit='1/K^3', bounds=(-1e-8, 1e-8), description='factor of d^3')
    sample_clock_linear: float = parameter(
        0.0, unit='1/K', bounds=(-1e-5, 1e-5), description='sample_clock_alpha over board temperature: factor of d'
    )
    sample_clock_quadratic: float = parameter(0.0, unit='1/K^2', bounds=(-1e-6, 1e-6), description='factor of d^2')
    sample_clock_cubic: float = parameter(0.0, unit='1/K^3', bounds=(-1e-8, 1e-8), description='factor of d^3')
    delay_slope: float = parameter(
        0.0, unit='s/K', bounds=(-1e-8, 1e-8), description='delay over board temperature: factor of d'
    )
    temperature_low: float = parameter(
        0.0, unit='degC', bounds=(-100.0, 150.0), description='coldest board in the calibration'
    )
    temperature_high: float = parameter(
        0.0, unit='degC', bounds=(-100.0, 150.0), description='warmest; equal to the coldest: range not stated'
    )
    delay_peer: str = parameter('', description='the only station with which `delay` holds; empty: any')
    version: int = parameter(0, bounds=(0, 2**32 - 1), description='of the stored document, 0: none')
    stamp: int = 0
    frame_id: str = ''

    def __post_init__(self) -> None:
        """Take fields that an older recording lacks (NaN) as not stated."""
        for name in _LATER_FIELDS:
            if math.isnan(getattr(self, name)):
                object.__setattr__(self, name, 0.0)

    @functools.cached_property
    def depends_on_temperature(self) -> bool:
        """True where clocks or delay have a curve over the board temperature."""
        return any(getattr(self, name) for name in _CURVES)

    @property
    def states_uncertainty(self) -> bool:
        """True where the calibration says how uncertain it is."""
        return max(self.alpha_std, self.sample_clock_alpha_std, self.delay_std) > 0.0

    def covers(self, temperature: float) -> bool | None:
        """Return whether a board temperature [degC] is in the calibrated range; None where no range is stated."""
        if not self.temperature_high > self.temperature_low:
            return None
        return self.temperature_low <= temperature <= self.temperature_high

    def alpha_at(self, temperature: Any) -> Any:
        """Return alpha at board temperatures [degC], shape as given; NaN counts as that of the calibration."""
        d = self._excess(temperature)
        return self.alpha + d * (self.alpha_linear + d * (self.alpha_quadratic + d * self.alpha_cubic))

    def sample_clock_at(self, temperature: Any) -> Any:
        """Return sample_clock_alpha at board temperatures [degC], as `alpha_at`."""
        d = self._excess(temperature)
        slope = self.sample_clock_linear + d * (self.sample_clock_quadratic + d * self.sample_clock_cubic)
        return self.sample_clock_alpha + d * slope

    def delay_at(self, temperature: Any) -> Any:
        """Return the hardware delay at board temperatures [degC], as `alpha_at` [s]."""
        return self.delay + self._excess(temperature) * self.delay_slope

    def at(self, temperature: float) -> 'Calibration':
        """Return the calibration as it holds at a board temperature [degC]: the same without curves."""
        if not self.depends_on_temperature:
            return self
        values: dict[str, Any] = dict.fromkeys(_CURVES, 0.0)
        values |= {
            'alpha': float(self.alpha_at(temperature)),
            'sample_clock_alpha': float(self.sample_clock_at(temperature)),
            'delay': float(self.delay_at(temperature)),
        }
        return dataclasses.replace(self, **values)

    def _excess(self, temperature: Any) -> Any:
        """Return board temperatures over that of the calibration [K]; beyond the stated range, the end of the range."""
        if self.temperature_high > self.temperature_low:
            temperature = np.clip(temperature, self.temperature_low, self.temperature_high)
        return np.where(np.isfinite(temperature), np.subtract(temperature, self.temperature), 0.0)


_CURVES = (
    'alpha_linear',
    'alpha_quadratic',
    'alpha_cubic',
    'sample_clock_linear',
    'sample_clock_quadratic',
    'sample_clock_cubic',
    'delay_slope',
)
_LATER_FIELDS = ('alpha_std', 'sample_clock_alpha_std', 'delay_std', 'temperature_low', 'temperature_high', *_CURVES)


def delay_from_beat_sum(beat_sum: Alpha, chirp_rate: float, alpha_first: float, alpha_second: float) -> Alpha:
    """Return the path delay from the range-proportional frequency f_IF of eqs. 5, 6 and 18 [s].

    Args:
        beat_sum: f_IF,1 - f_IF,2 (short distance) or f_IF,1 + f_IF,2 (long distance), true clock [Hz].
        chirp_rate: nominal k [Hz/s].
        alpha_first: station 1's reference / nominal [1].
        alpha_second: station 2's [1].
    """
    return beat_sum / (chirp_rate * (alpha_first**2 + alpha_second**2))


def range_bias(true_range: float, alpha_first: Alpha, alpha_second: Alpha) -> Alpha:
    """Return the range error that uncompensated references cause, eqs. 20 and 21 [m]: measured minus true."""
    return true_range * (alpha_first**2 + alpha_second**2 - 2.0) / 2.0
