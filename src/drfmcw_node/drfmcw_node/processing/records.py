"""A sweep, and what a station publishes of it: the records that travel as messages."""

import dataclasses
import math

import numpy as np


@dataclasses.dataclass(frozen=True, slots=True)
class Sweep:
    """One sweep's samples of one station; the fields of IfSamples."""

    station: str
    peer: str
    sweep_id: int
    full_scale: float  # [LSB]
    iq: bool
    samples: np.ndarray  # int16, or array.array('h')
    stamp: int  # start of the sweep [ns]
    frame_id: str = ''


@dataclasses.dataclass(frozen=True, slots=True)
class Beat:
    """What a station estimated from one sweep; the fields of BeatFrequency."""

    station: str
    peer: str
    sweep_id: int
    flags: int
    frequency: float  # [Hz]
    frequency_std: float  # [Hz]
    phase: float  # [rad]
    power: float  # [dBm]
    snr: float  # [dB]
    stamp: int  # [ns]
    frame_id: str = ''
    independent_std: float = math.nan  # [Hz]
    window: str = ''


@dataclasses.dataclass(frozen=True, slots=True)
class Spectrum:
    """Magnitude spectrum of one sweep; the fields of IfSpectrum."""

    station: str
    peer: str
    sweep_id: int
    window: str
    start_frequency: float  # [Hz]
    frequency_step: float  # [Hz]
    magnitude: np.ndarray  # float32 [dBFS]
    stamp: int  # [ns]
    frame_id: str = ''
