"""Noise floor and response of a receiver, from sweeps with the antennas terminated."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from drfmcw_node.processing.records import Sweep
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings

_EDGE = 16  # bins next to 0 Hz and half the sampling rate that are left out: offset, alias filter
_BANDS = 16  # of the response
_LINE = 25.0  # above the median, from which on a bin is a line and the antennas are not terminated [dB]
_ROUNDING = 1.0 / 12.0  # variance of the rounding to codes [LSB^2]
_MEDIAN_SPREAD = 1.2533  # standard deviation of a median over that of a mean


@dataclasses.dataclass(frozen=True)
class ReceiverNoise:
    """Additive noise of one receiver."""

    floor: float  # density at the antenna port [dBm/Hz]
    floor_std: float  # [dB]
    frequency: np.ndarray  # (_BANDS,) centres of the bands of the response [Hz]
    gain: np.ndarray  # (_BANDS,) density in each over their median [dB]
    gain_std: np.ndarray  # (_BANDS,) [dB]
    sweeps: int


def receiver_noise(settings: SweepSettings, sweeps: Sequence[Sweep]) -> ReceiverNoise:
    """Return floor and response from sweeps that hold noise only; the rounding of the ADC is taken off.

    Args:
        settings: of the station.
        sweeps: of the station, real or I/Q.

    Raises:
        ConfigurationError: power at full scale unknown, sweeps of other lengths, or a line in the noise.
    """
    if not math.isfinite(settings.full_scale_power):
        raise ConfigurationError(f"'{settings.station}' does not state its full_scale_power: no level without it")
    iq = sweeps[0].iq
    samples = np.stack([np.asarray(sweep.samples, float) for sweep in sweeps])
    if iq:
        samples = samples[:, 0::2] + 1j * samples[:, 1::2]
    count = samples.shape[1]
    spectrum = np.fft.fft(samples, axis=1)[:, : count // 2]
    power = np.mean(np.abs(spectrum) ** 2, axis=0)[_EDGE:-_EDGE] / count  # variance of a sample by this bin [LSB^2]
    shape = stats.gamma(len(sweeps), scale=1.0 / len(sweeps))  # of the mean over sweeps
    median = float(np.median(power)) / shape.median()
    if power.max() > median * 10.0 ** (_LINE / 10.0):
        at = (int(np.argmax(power)) + _EDGE) * settings.sample_rate / count
        raise ConfigurationError(
            f"'{settings.station}' hears a line at {at * 1e-3:.1f} kHz, "
            f'{10.0 * math.log10(power.max() / median):.0f} dB above the noise: are its antennas terminated?'
        )
    variance = median - _ROUNDING * (2.0 if iq else 1.0)
    if variance <= 0.0:
        raise ConfigurationError(f"'{settings.station}': the noise is less than the rounding of the ADC")
    bands = np.array_split(power, _BANDS)
    levels = np.array([float(np.median(band)) / shape.median() for band in bands])
    bins = np.array([len(band) for band in bands])
    decibel = 10.0 / math.log(10.0)
    spread = decibel * _MEDIAN_SPREAD / math.sqrt(len(sweeps))
    centres = [np.mean(at) for at in np.array_split(np.arange(len(power)) + _EDGE, _BANDS)]
    return ReceiverNoise(
        floor=density(settings, float(sweeps[0].full_scale), variance / (2.0 if iq else 1.0), iq),
        floor_std=spread / math.sqrt(len(power)),
        frequency=np.array(centres) * settings.sample_rate / count,
        gain=10.0 * np.log10(levels / np.median(levels)),
        gain_std=spread / np.sqrt(bins),
        sweeps=len(sweeps),
    )


def density(settings: SweepSettings, full_scale: float, variance: float, iq: bool) -> float:
    """Return the density of noise with a variance per real sample [LSB^2], as Station.noise_std has it [dBm/Hz]."""
    bandwidth = settings.sample_rate * (1.0 if iq else 0.5)
    return settings.full_scale_power + 10.0 * math.log10(2.0 * variance / full_scale**2) - 10.0 * math.log10(bandwidth)
