"""A station's clocks, and how their frequency offsets change the measured range (eqs. 7-13, 18-21)."""

import dataclasses
import math
from typing import TypeVar

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
    stamp: int = 0
    frame_id: str = ''


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
