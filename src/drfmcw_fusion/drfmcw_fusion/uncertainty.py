"""What a range is uncertain by that does not average over sweeps: clocks, delays and weather as calibrated."""

import dataclasses
import functools
import math

from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration

from .combination import PathDelay, Station


@dataclasses.dataclass(frozen=True)
class Weather:
    """Readings of the sensors at the site with their standard deviations; 0 where a sensor states none."""

    temperature: float  # [degC]
    pressure: float  # [Pa]
    humidity: float  # [0..1]
    temperature_std: float = 0.0
    pressure_std: float = 0.0
    humidity_std: float = 0.0


UNKNOWN = {'temperature': 10.0, 'pressure': 1500.0, 'humidity': 0.25}
"""Standard deviations that stand for a missing sensor [K, Pa, 1]: the spread of a year's weather (chosen)."""


@dataclasses.dataclass(frozen=True)
class Contributions:
    """Standard deviations of a range by cause [m]."""

    reference_clocks: float
    sample_clocks: float
    delay: float
    weather: float

    @property
    def total(self) -> float:
        """All of them together [m]."""
        return math.sqrt(self.reference_clocks**2 + self.sample_clocks**2 + self.delay**2 + self.weather**2)


def contributions(first: Station, second: Station, path: PathDelay, weather: Weather, model: str) -> Contributions:
    """Return what calibrations and weather contribute to the uncertainty of one range.

    Derivatives of eq. 19: an error of alpha shifts the delay by itself times -tau, one of the ADC clock by itself times
    f / 2k. The errors of different clocks count as independent, those of a station's clocks too.

    Args:
        first: station 1, or the one that hears itself.
        second: station 2, the same object where the station hears itself.
        path: their combination.
        weather: of the site.
        model: of the air, as FusionSettings.atmosphere.
    """
    rate = abs(first.sweep.chirp_rate)
    index = 1.0 if model == 'vacuum' else _index(weather.temperature, weather.pressure, weather.humidity, model)
    light = SPEED_OF_LIGHT / index
    stations = (first,) if first is second else (first, second)
    weight = 2.0 if first is second else 1.0  # its clock acts in both directions
    reference = math.hypot(*(weight * path.delay * s.calibration.alpha_std for s in stations))
    sample = math.hypot(
        *(weight * s.beat.frequency * s.calibration.sample_clock_alpha_std / (2.0 * rate) for s in stations)
    )
    hardware = sum(s.calibration.delay for s in stations)
    distance = abs(path.delay - hardware) * light
    return Contributions(
        reference_clocks=reference * light,
        sample_clocks=sample * light,
        delay=delay_std(*(s.calibration for s in stations)) * light,
        weather=0.0 if model == 'vacuum' else distance * _index_std(weather, model) / index,
    )


def delay_std(*calibrations: Calibration) -> float:
    """Return the standard deviation of the hardware delay of one station or a pair [s].

    A delay measured together with the peer states the standard deviation of the sum of both.
    """
    if len(calibrations) == 2:
        for own, peer in (calibrations, calibrations[::-1]):
            if own.delay_peer == peer.station:
                return own.delay_std
    return math.hypot(*(c.delay_std for c in calibrations))


def holds_for(own: Calibration, peer: str) -> bool:
    """Return whether the delay of a calibration holds in a measurement with `peer`."""
    return own.delay_peer in ('', peer)


@functools.lru_cache(maxsize=16)
def _index_std(weather: Weather, model: str) -> float:
    """Return the standard deviation of the refractive index; readings change once a minute, sweeps a thousand times."""
    values = {'temperature': weather.temperature, 'pressure': weather.pressure, 'humidity': weather.humidity}
    at = _index(**values, model=model)
    stds = {name: getattr(weather, f'{name}_std') for name in values}
    return math.hypot(
        *(_index(**(values | {name: values[name] + std}), model=model) - at for name, std in stds.items())
    )


@functools.lru_cache(maxsize=64)
def _index(temperature: float, pressure: float, humidity: float, model: str) -> float:
    return float(refractive_index(temperature, pressure, humidity, model))
