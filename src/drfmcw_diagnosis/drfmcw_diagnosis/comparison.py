"""A recording beside its model: one vector of residuals over their standard deviations, and what effects add to it."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from drfmcw_sim.effects import Effect

from .dataset import Dataset
from .features import gaussian
from .groups import Entries, Groups
from .known import Known
from .measuring import STEADY, measured
from .predicting import Predictor
from .recorded_sweeps import RecordedSweeps

_FLUTTER_SPREAD = 1.025  # by which the median of so few widens the spread of what is compared with it
_LARGEST = 1e4  # whitened residual beyond which a number says no more
_OF_PATH = ('coherence', 'beat', 'range', 'velocity', 'movement')  # kinds of number that belong to no single station
_SIMULATED_APART = ((False, False), (True, False), (False, True))  # of distorting, of bursts
_KIND = 'U9'  # the longest name


class Comparison:
    """Measured features, their standard deviations, and predictions of the simulator's forward model.

    Attributes:
        data, heard, members, parts, sweeps, slope, standing: of the sweeps that are compared, see `RecordedSweeps`.
        receivers: names of the stations with samples (S,).
        known: what is known to expect of them.
        channels: what each of the ramp's series is (2 S,).
        time: of the ramp's blocks in the first station's sweep (K,) [s].
        measured: features of all groups.
        std: their standard deviations, and those of the model.
        plain: features that the model predicts without effects.
        entries: what each number of the vector is.
        residual: measured features less those of the plain model, over their standard deviations.
    """

    def __init__(self, data: Dataset, rows: np.ndarray | None = None) -> None:
        """Measure the features of a recording, and predict those of the model without effects.

        Args:
            data: the recording, of two stations or of one.
            rows: sweeps to use, None for all.

        Raises:
            ConfigurationError: too few sweeps can be compared, see `RecordedSweeps`.
        """
        recorded = RecordedSweeps(data, rows)
        self.data, self.heard, self.members = data, recorded.heard, recorded.members
        self.receivers = tuple(data.stations[i] for i in self.heard)
        self.sweeps, self.parts = recorded.sweeps, recorded.parts
        self.slope, self.standing = recorded.slope, recorded.standing
        self.time, self.channels = self.sweeps[0].time, self.parts[0].extract.channels
        self.known = Known(data, self.heard, self.members, recorded.scatters, recorded.unsound)
        found = measured(recorded, self.known)
        self._model = Predictor(recorded, found.std)
        self.measured, self.plain = found.values, self._model.plain
        limit = self._model.noise.limit(self.plain.noise)
        self.std = dataclasses.replace(found.std, noise=np.hypot(found.std.noise, limit))
        self._recorded, self._quiet = recorded, found.quiet
        self.entries = self._layout()
        self.residual = self._vector(self.measured)

    def _blocks(self, values: Groups, g: int) -> Iterator[tuple[str, np.ndarray]]:
        """Yield what a group holds beyond the plain model, over its deviations: (kind, (stations, positions)).

        One row stands for the path, else there is one of each station with samples, or of each of the ramp's channels.
        """
        count, start = len(self.members[g]), int(self._starts[g])
        inside = slice(start, start + count)

        def over(name: str) -> np.ndarray:
            return (getattr(values, name)[g] - getattr(self.plain, name)[g]) / getattr(self.std, name)[g]

        yield 'ramp', over('ramp')
        freedom = max((count - 1) / 2, 0.5)
        fluttering = (gaussian(values.flutter[g], freedom) - gaussian(np.ones(1), freedom)) / _FLUTTER_SPREAD
        compared = (np.arange(fluttering.shape[1]) >= STEADY) & self._recorded.scatters & self.standing[g]
        yield 'flutter', np.where(compared, fluttering, 0.0)
        quiet = self._quiet[g][:, None]
        lines = gaussian(values.lines[g], quiet) - gaussian(np.ones(1), quiet)
        yield 'lines', np.where(self._compared_lines[g], lines, 0.0)
        yield 'mean', over('mean')
        yield 'harmonic', np.nan_to_num(over('harmonic'))
        yield 'burst', over('burst')
        yield 'noise', np.nan_to_num(over('noise'))
        yield 'coherence', over('coherence')[None]
        yield 'beat', np.reshape(over('beat'), (1, 1))
        yield 'amplitude', over('amplitude')[:, None]
        yield 'range', np.reshape(over('range'), (1, 1))
        yield 'velocity', np.reshape(over('velocity'), (1, 1))
        moved = (values.movement[inside] - self.plain.movement[inside]) / self.std.movement[inside]
        yield 'movement', moved[None]

    def _layout(self) -> Entries:
        """Return what each number of the vector is."""
        parts: list[tuple[np.ndarray, ...]] = []
        bins = self.measured.lines.shape[-1]
        self._compared_lines = np.stack([~self._recorded.bands.at_line(s.line.mean(axis=0), bins) for s in self.sweeps])
        self._starts = np.cumsum([0, *map(len, self.members)])
        for g, members in enumerate(self.members):
            for kind, block in self._blocks(self.measured, g):
                rows, columns = block.shape
                station = np.repeat([-1] if kind in _OF_PATH else np.arange(rows), columns)
                position = np.tile(members if kind == 'movement' else np.arange(columns), rows)
                parts.append((np.full(block.size, kind, _KIND), station, np.full(block.size, g), position))
        return Entries(*map(np.concatenate, zip(*parts, strict=True)))

    def _vector(self, values: Groups) -> np.ndarray:
        """Return features less those of the plain model, over their standard deviations."""
        parts = [block.ravel() for g in range(len(self.members)) for _, block in self._blocks(values, g)]
        return np.clip(np.concatenate(parts), -_LARGEST, _LARGEST)

    def predict(self, effects: Sequence[Effect]) -> Groups:
        """Return the features that the model with `effects` predicts."""
        return self._model.predict(effects)

    def changing(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much the ramp with `effects` changes from sweep to sweep (G, 2 S, K), see `Predictor`."""
        return self._model.changing(effects)

    def template(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return what `effects` add to the model, over the standard deviations of the data; compare with `residual`."""
        # apart, as a distortion or a burst takes many sweeps to simulate
        apart = [tuple(e for e in effects if (e.distorts(), e.bursts()) == kind) for kind in _SIMULATED_APART]
        return sum(self._vector(self.predict(part)) for part in apart if part) if effects else self._vector(self.plain)
