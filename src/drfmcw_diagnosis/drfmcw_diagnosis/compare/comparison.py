"""A recording beside its model: one vector of residuals over their standard deviations, and what effects add to it."""

import dataclasses
import functools
from collections.abc import Iterator, Sequence

import numpy as np

from drfmcw_sim.effects import Effect

from ..features.adc_codes import Codes, evenness
from ..features.extractor import gaussian
from ..recording.dataset import Dataset
from .groups import Entries, Groups
from .known import Known
from .measuring import STEADY, measured
from .predicting import Predictor
from .recorded_sweeps import RecordedSweeps

_FLUTTER_SPREAD = 1.025  # by which the median of so few widens the spread of what is compared with it
_LARGEST = 1e4  # whitened residual beyond which a number says no more
_OF_PATH = ('coherence', 'beat', 'range', 'velocity')  # kinds of number that belong to no single station
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
        self._recorded, self._quiet = recorded, np.array(found.quiet)
        self.entries = self._layout()
        self.residual = self._vector(self.measured)

    def _blocks(self, values: Groups) -> Iterator[tuple[str, np.ndarray]]:
        """Yield what groups hold beyond the plain model, over its deviations: (kind, (G, stations, positions)).

        One row stands for the path, else there is one of each station with samples, or of each of the ramp's channels.
        """

        def over(name: str) -> np.ndarray:
            return (getattr(values, name) - getattr(self.plain, name)) / getattr(self.std, name)

        yield 'ramp', over('ramp')
        freedom = self._freedom[:, None, None]
        fluttering = (gaussian(values.flutter, freedom) - gaussian(np.ones(1), freedom)) / _FLUTTER_SPREAD
        yield 'flutter', np.where(self._compared_flutter, fluttering, 0.0)
        quiet = self._quiet[..., None]
        lines = gaussian(values.lines, quiet) - gaussian(np.ones(1), quiet)
        yield 'lines', np.where(self._compared_lines, lines, 0.0)
        yield 'mean', over('mean')
        yield 'harmonic', np.nan_to_num(over('harmonic'))
        yield 'piled', over('piled')[..., None]
        yield 'burst', over('burst')
        yield 'noise', np.nan_to_num(over('noise'))
        yield 'coherence', over('coherence')[:, None]
        yield 'beat', over('beat')[:, None, None]
        yield 'amplitude', over('amplitude')[..., None]
        yield 'range', over('range')[:, None, None]
        yield 'velocity', over('velocity')[:, None, None]

    @functools.cached_property
    def codes(self) -> tuple[Codes | None, ...]:
        """How uneven the ADC codes of each station with samples are, None where that is not told."""
        rows = np.concatenate(self.members)
        # the least noise, and not what an uneven converter adds to it
        noise = np.fmin(self.measured.noise, self.plain.noise)
        least = 10.0 ** (np.nan_to_num(np.nanmin(np.nanmedian(noise, axis=2), axis=0), nan=-np.inf) / 20.0)
        return tuple(evenness(self.data.samples[i][rows], n) for i, n in zip(self.heard, least, strict=True))

    def _layout(self) -> Entries:
        """Return what each number of the vector is."""
        counts = np.array([len(m) for m in self.members])
        self._freedom = np.maximum((counts - 1) / 2, 0.5)
        bins, terms = self.measured.lines.shape[-1], np.arange(self.measured.flutter.shape[-1])
        self._compared_lines = np.stack([~self._recorded.bands.at_line(s.line.mean(axis=0), bins) for s in self.sweeps])
        self._compared_flutter = self.standing[:, None, None] & (terms >= STEADY) & self._recorded.scatters
        columns: list[tuple[np.ndarray, ...]] = []
        for kind, block in self._blocks(self.measured):
            _, rows, width = block.shape
            station = np.repeat([-1] if kind in _OF_PATH else np.arange(rows), width)
            columns.append((np.full(rows * width, kind, _KIND), station, np.tile(np.arange(width), rows)))
        kinds, stations, positions = map(np.concatenate, zip(*columns, strict=True))
        # the vector goes group by group, what each has alike and then its sweeps' movements
        starts = np.cumsum([0, *(len(kinds) + counts[:-1])])
        self._alike = starts[:, None] + np.arange(len(kinds))
        self._moved = np.concatenate(
            [start + len(kinds) + np.arange(n) for start, n in zip(starts, counts, strict=True)]
        )

        def of_vector(alike: np.ndarray, moved: np.ndarray) -> np.ndarray:
            result = np.empty(self._alike.size + self._moved.size, alike.dtype)
            result[self._alike], result[self._moved] = alike, moved
            return result

        moved = len(self._moved)
        return Entries(
            of_vector(kinds, np.full(moved, 'movement', _KIND)),
            of_vector(stations, np.full(moved, -1)),
            of_vector(np.arange(len(counts))[:, None], np.repeat(np.arange(len(counts)), counts)),
            of_vector(positions, np.concatenate(self.members)),
        )

    def _vector(self, values: Groups) -> np.ndarray:
        """Return features less those of the plain model, over their standard deviations."""
        result = np.empty(len(self.entries.kind))
        blocks = [block.reshape(len(block), -1) for _, block in self._blocks(values)]
        result[self._alike] = np.concatenate(blocks, axis=1)
        result[self._moved] = (values.movement - self.plain.movement) / self.std.movement
        return np.clip(result, -_LARGEST, _LARGEST)

    def predict(self, effects: Sequence[Effect]) -> Groups:
        """Return the features that the model with `effects` predicts."""
        return self._model.predict(effects)

    def changing(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much the ramp with `effects` changes from sweep to sweep (G, 2 S, K), see `Predictor`."""
        return self._model.changing(effects)

    def template(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return what `effects` add to the model, over the standard deviations of the data; compare with `residual`."""
        # apart, as a distortion or a burst takes many sweeps to simulate
        apart = [tuple(e for e in effects if (e.distorts, e.bursts) == kind) for kind in _SIMULATED_APART]
        return sum(self._vector(self.predict(part)) for part in apart if part) if effects else self._vector(self.plain)
