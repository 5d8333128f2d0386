"""The samples of a station that hears itself, as numbers to compute with."""

import dataclasses
import functools
import math

import numpy as np

from ..features.extractor import as_complex
from ..recording.dataset import Dataset
from .limits import MATERIAL
from .noise import Noise, noise


@dataclasses.dataclass(frozen=True)
class Material:
    """Sweeps of one station, one setting."""

    station: str
    signal: np.ndarray  # (n, N) real or complex [LSB]
    rate: float  # of the samples [Hz]
    start_frequency: float  # [Hz]
    bandwidth: float  # [Hz]
    duration: float  # of the nominal ramp [s]
    full_scale: float  # [LSB]
    group: np.ndarray  # (n,) number of the group of consecutive sweeps under the same conditions

    @property
    def iq(self) -> bool:
        """Quadrature samples."""
        return bool(np.iscomplexobj(self.signal))

    @property
    def nominal_end(self) -> int:
        """Number of samples within the nominal ramp."""
        return int(min(self.signal.shape[1], math.floor(self.duration * self.rate) + 1))

    @property
    def parts(self) -> np.ndarray:
        """Real numbers of the ADC, (n, N) or (2 n, N)."""
        return np.concatenate([self.signal.real, self.signal.imag]) if self.iq else self.signal

    @functools.cached_property
    def noise(self) -> float:
        """Standard deviation of the white noise of each real number [LSB].

        From fourth differences of neighbouring samples, which a signal well below the sampling rate makes small; robust
        against jumps. Quantisation bounds it from below.
        """
        difference = np.diff(self.parts, 4, axis=1)
        spread = MATERIAL.mad_to_std * float(np.median(np.abs(difference))) / math.sqrt(70.0)
        return max(spread, 1.0 / math.sqrt(12.0))

    @functools.cached_property
    def floor(self) -> Noise:
        """The noise beside all lines: what a misfit is compared with."""
        return noise(self.signal[:, : self.nominal_end])

    @property
    def white(self) -> float:
        """Standard deviation of the noise of each real number [LSB]: the lower of both estimates.

        Lines near the sampling rate raise that from neighbouring samples, lines that spread that beside lines.
        """
        return min(self.noise, math.sqrt(self.floor.mean / (2.0 if self.iq else 1.0)))

    def decibels(self, amplitude: float) -> float:
        """Return an amplitude [LSB] in dBFS."""
        return 20.0 * math.log10(max(amplitude, 1e-9) / self.full_scale)


def material(data: Dataset) -> Material:
    """Return the sweeps of the setting that most of them have, thinned evenly where they are too many."""
    setting = int(np.bincount(data.setting).argmax())
    rows = np.flatnonzero(data.setting == setting)
    samples = data.samples_of(0)
    most = max(MATERIAL.fewest, MATERIAL.values // samples.shape[1])
    if len(rows) > most:  # whole runs of consecutive sweeps are kept: movements show in them
        rows = rows[:most]
    signal = samples[rows].astype(float)
    (sweep,) = data.sweeps[setting]
    return Material(
        station=data.stations[0],
        signal=as_complex(signal, data.iq),
        rate=float(sweep.sample_rate),
        start_frequency=float(sweep.start_frequency),
        bandwidth=float(sweep.bandwidth),
        duration=float(sweep.ramp_duration),
        full_scale=float(np.median(data.full_scale[0])),
        group=data.group[rows],
    )


def representative_sweeps(m: Material, most: int, weights: np.ndarray | None = None) -> list[tuple[np.ndarray, int]]:
    """Return some sweeps (N,) of groups spread over the recording: the mean of a group whose sweeps are alike.

    With each comes the number of sweeps of which it is the mean.

    Args:
        m: sweeps.
        most: sweeps or means, at most.
        weights: of the sweeps (n,); of other groups those of the largest weight are returned; None: their first ones.
    """
    groups = np.unique(m.group)
    chosen = groups[np.unique(np.round(np.linspace(0, len(groups) - 1, min(len(groups), most))).astype(int))]
    items: list[tuple[np.ndarray, int]] = []
    for number in chosen:
        rows = np.flatnonzero(m.group == number)
        mean = m.signal[rows].mean(axis=0)
        if np.var(mean) > MATERIAL.alike * np.mean(np.var(m.signal[rows], axis=1)):
            items.append((mean, len(rows)))
        elif weights is None:
            items.append((m.signal[rows[0]], 1))
        else:
            strongest = rows[np.argsort(-weights[rows], kind='stable')[: max(most // len(chosen), 1)]]
            items += [(m.signal[row], 1) for row in strongest]
    return items


def averaged(m: Material, span: int) -> Material:
    """Return the means of spans of so many samples, for a line far below the sampling rate."""
    if span < 2:
        return m
    count = m.signal.shape[1] // span
    signal = m.signal[:, : count * span].reshape(len(m.signal), count, span).mean(axis=2)
    return dataclasses.replace(m, signal=signal, rate=m.rate / span)
