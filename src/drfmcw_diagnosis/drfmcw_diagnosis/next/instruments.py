"""Instruments that read the state of stations, air and reference as effects change it."""

import abc
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from drfmcw_node.estimators.noise import QUANTISATION
from drfmcw_sim.effects import Effect
from drfmcw_sim.measurements import Measurements

from ..compare.comparison import Comparison

Effects = tuple[Effect, ...]


@dataclasses.dataclass(frozen=True)
class View:
    """What a measurement shows under an explanation."""

    show: Callable[[Effects], np.ndarray]  # deviations from the nominal model, over their standard deviations
    comparison: Comparison | None = None  # to which the numbers belong, where they are sweeps


@dataclasses.dataclass(frozen=True)
class Measurement(abc.ABC):
    """A hypothetical measurement."""

    text: ClassVar[str] = ''
    """What to do; a template with the measurement's fields and properties in braces."""

    @property
    def sentence(self) -> str:
        """What to do."""
        return self.text.format(m=self)

    @staticmethod
    def predictable(effect: type[Effect]) -> bool:
        """Return whether the result of the measurement under an effect can be predicted."""
        return True

    @abc.abstractmethod
    def view(self, comparison: Comparison, count: int) -> View | None:
        """Return what it shows, None where it cannot be made.

        Args:
            comparison: the recording, whose conditions, noise and settings hold for it too.
            count: distances at which sweeps are simulated, at most.
        """


class _Reading(Measurement):
    """Reads clocks, noise, distance or reference at single moments."""

    @abc.abstractmethod
    def read(self, m: Measurements, effects: Effects) -> np.ndarray:
        """Return the readings of a state in which the effects act already."""

    @abc.abstractmethod
    def moments(self, comparison: Comparison) -> Measurements | None:
        """Return the nominal state at each moment of a reading."""

    @abc.abstractmethod
    def std(self, comparison: Comparison, m: Measurements) -> np.ndarray | float:
        """Return the standard deviation of each reading."""

    def view(self, comparison: Comparison, count: int) -> View | None:
        """Return the readings less the nominal ones."""
        m = self.moments(comparison)
        if m is None:
            return None
        nominal, std = self.read(m, ()), self.std(comparison, m)

        def show(effects: Effects) -> np.ndarray:
            state = m.rows(slice(None))
            for effect in sorted(effects, key=lambda e: e.stage):
                effect.prepare(state)
            return (self.read(state, effects) - nominal) / std

        return View(show)


def _state(comparison: Comparison, groups: Sequence[int]) -> Measurements:
    """Return the nominal state in the middle of groups, one row each, as if all had the settings of the first."""
    members = comparison.members
    rows = [int(members[g][len(members[g]) // 2]) for g in groups]
    data = comparison.data
    if len(set(data.setting[rows].tolist())) > 1:
        data = dataclasses.replace(data, setting=np.full(len(data), data.setting[rows[0]]))
    return data.nominal(np.array(rows))


@dataclasses.dataclass(frozen=True)
class FrequencyCounter(_Reading):
    """A counter on a clock of every station, once or twice."""

    clock: str  # 'alpha' or 'sample_clock' of the simulator's stations
    warmer: float = 0.0  # board temperature of the second reading over that of the first [K]
    later: float = 0.0  # its time after the first [s]
    accuracy: float = 1e-8

    @property
    def sentence(self) -> str:
        """What to do."""
        clock = {'alpha': 'reference oscillator', 'sample_clock': 'ADC clock'}[self.clock]
        text = f'Read the {clock} of each station with a frequency counter, to {1e6 * self.accuracy:g} ppm'
        if self.warmer:
            text += f', at two board temperatures {self.warmer:g} K apart'
        if self.later:
            text += f', at the start and at the end of {self.later / 60.0:g} minutes'
        return text + '.'

    def moments(self, comparison: Comparison) -> Measurements:
        """Return one moment, or two."""
        middle = len(comparison.members) // 2
        if not self.warmer and not self.later:
            return _state(comparison, [middle])
        m = _state(comparison, [middle, middle])
        m.time = m.time + np.array([0.0, self.later])
        for station in m.stations:
            station.temperature = station.temperature + np.array([0.0, self.warmer])
        return m

    def read(self, m: Measurements, effects: Effects) -> np.ndarray:
        """Return the first reading of each clock over its nominal frequency, and how much the second one differs."""
        clocks = np.array([getattr(s, self.clock) for s in m.stations])
        return np.concatenate([clocks[:, 0], (clocks[:, 1:] - clocks[:, :1]).ravel()])

    def std(self, comparison: Comparison, m: Measurements) -> float:
        """Return the counter's accuracy."""
        return self.accuracy


@dataclasses.dataclass(frozen=True)
class PhaseNoiseMeter(_Reading):
    """A phase-noise analyser on every station's transmitter."""

    text = 'Measure the phase noise of each station with an analyser, to {m.accuracy:g} dB.'

    accuracy: float = 1.0  # [dB]
    offsets: tuple[float, ...] = (3e4, 1e5, 3e5)  # [Hz]

    def moments(self, comparison: Comparison) -> Measurements | None:
        """Return any moment; None where no phase noise is known to compare with."""
        m = _state(comparison, [0])
        return m if all(s.phase_noise is not None for s in m.stations) else None

    def read(self, m: Measurements, effects: Effects) -> np.ndarray:
        """Return single side-bands [dBc/Hz]."""
        oscillators = [s.phase_noise for s in m.stations if s.phase_noise is not None]  # of all, see `moments`
        sidebands = [oscillator.single_sideband(np.array(self.offsets)) for oscillator in oscillators]
        return 10.0 * np.log10(np.concatenate(sidebands))

    def std(self, comparison: Comparison, m: Measurements) -> float:
        """Return the analyser's accuracy."""
        return self.accuracy


@dataclasses.dataclass(frozen=True)
class TerminatedAntenna(_Reading):
    """The receivers alone: no line, and no skirt of the oscillators' noise around it."""

    text = 'Terminate the antennas and record the noise floor alone.'

    accuracy: float = 0.02  # of the ADC's scale [dB]

    def moments(self, comparison: Comparison) -> Measurements | None:
        """Return any moment; None where the calibrations give no noise."""
        return _state(comparison, [0]) if np.isfinite(comparison.std.noise).any() else None

    def read(self, m: Measurements, effects: Effects) -> np.ndarray:
        """Return the noise of each station [dB of 1 LSB^2 per sample]."""
        return 10.0 * np.log10(np.concatenate([s.noise_std() ** 2 + QUANTISATION for s in m.stations]))

    def std(self, comparison: Comparison, m: Measurements) -> float:
        """Return the standard deviation over all bands of a station, with as many sweeps as the recording has."""
        together = math.sqrt(len(m.stations) / np.sum(comparison.std.noise**-2.0))
        return math.hypot(self.accuracy, together)


class _OfReference(_Reading):
    """Compares the reference instrument with something better known."""

    def read(self, m: Measurements, effects: Effects) -> np.ndarray:
        """Return the reference's readings less the true distances [m]."""
        standing = m.range - m.velocity * m.time

        def distance_at(time: np.ndarray | float) -> np.ndarray | float:
            return standing + m.velocity * time

        error = np.zeros(len(m))
        for effect in effects:
            error = error + effect.reference_error(m.time, m.range, distance_at)
        return error - m.range

    @staticmethod
    def _reference_std(comparison: Comparison, reads: float = 1.0) -> float:
        """Return that of the mean of several readings at one distance [m]."""
        data = comparison.data
        rows = np.concatenate(comparison.members)
        own = float(np.nanmedian(data.reference_std[rows])) / math.sqrt(reads)
        return math.hypot(own, float(np.median(data.reference_limit[rows])))


@dataclasses.dataclass(frozen=True)
class SecondInstrument(_OfReference):
    """A total station beside the reference."""

    text = (
        'Measure the shortest and the longest distance between the antennas with a second instrument too, '
        'a total station of {m.millimetres:g} mm + {m.millimetres:g} ppm.'
    )

    millimetres: float = 1.0  # and as many ppm

    def moments(self, comparison: Comparison) -> Measurements | None:
        """Return the moments at the shortest and the longest distance; None without a reference."""
        if not np.isfinite(comparison.data.reference).any():
            return None
        distances = [comparison.data.distance[m].mean() for m in comparison.members]
        return _state(comparison, [int(np.argmin(distances)), int(np.argmax(distances))])

    def std(self, comparison: Comparison, m: Measurements) -> np.ndarray:
        """Return that of the difference, the reference read as often as at one distance of the recording."""
        reads = np.mean([len(rows) for rows in comparison.members])
        return np.hypot(1e-3 * self.millimetres * (1.0 + 1e-3 * m.range), self._reference_std(comparison, float(reads)))


@dataclasses.dataclass(frozen=True)
class DrivePast(_OfReference):
    """The crane passes a known point in both directions: the reference is read at that instant."""

    text = (
        'Drive the crane at {m.speed:g} m/s past a mark of known distance, in both directions, '
        'and read the reference at the mark.'
    )

    speed: float = 0.5  # [m/s]
    accuracy: float = 5e-3  # of the mark and of the instant, as distance [m]

    def moments(self, comparison: Comparison) -> Measurements | None:
        """Return one moment in each direction; None without a reference."""
        if not np.isfinite(comparison.data.reference).any():
            return None
        middle = len(comparison.members) // 2
        m = _state(comparison, [middle, middle])
        m.velocity = np.array([self.speed, -self.speed])
        return m

    def std(self, comparison: Comparison, m: Measurements) -> float:
        """Return the standard deviation of one passage."""
        return math.hypot(self.accuracy, self._reference_std(comparison))
