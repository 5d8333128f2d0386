"""A recording beside its model: one vector of residuals over their standard deviations, and what effects add to it."""

import functools
from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_sim.effects import Effect

from ..features.adc_codes import Codes, evenness
from ..features.extractor import as_complex, ramp_spectrum
from ..features.repeating import repeating_share
from ..features.sines import several
from ..recording.dataset import Dataset
from .groups import Correlated, Entries, Groups
from .kinds import KINDS, Kind
from .kinds.kind import Of
from .known import Known
from .limits import MODEL, SCATTER
from .measuring import Evidence
from .predicting import Expected, Predictor
from .recorded_sweeps import RecordedSweeps


class Comparison:
    """Measured features, their standard deviations, and predictions of the simulator's forward model.

    Attributes:
        data, heard, members, parts, sweeps, slope, standing: of the sweeps that are compared, see `RecordedSweeps`.
        receivers: names of the stations with samples (S,).
        recorded: the sweeps that are compared.
        kinds: of numbers that are compared.
        known: what is known to expect of them.
        channels: what each of the ramp's series is (2 S,).
        time: of the ramp's blocks in the first station's sweep (K,) [s].
        measured: features of all groups.
        std: their standard deviations, and those of the model.
        plain: features that the model predicts without effects.
        entries: what each number of the vector is.
        residual: measured features less those of the plain model, over their standard deviations.
        correlated: which of these numbers' noise is correlated.
    """

    def __init__(self, data: Dataset, rows: np.ndarray | None = None) -> None:
        """Measure the features of a recording, and predict those of the model without effects.

        Args:
            data: the recording, of two stations or of one.
            rows: sweeps to use, None for all.

        Raises:
            ConfigurationError: too few sweeps can be compared, see `RecordedSweeps`.
        """
        self.recorded = recorded = RecordedSweeps(data, rows)
        self.kinds = tuple(KINDS)
        self.data, self.heard, self.members = data, recorded.heard, recorded.members
        self.receivers = recorded.topology.receivers
        self.sweeps, self.parts = recorded.sweeps, recorded.parts
        self.slope, self.standing = recorded.slope, recorded.standing
        self.time, self.channels = recorded.time, recorded.channels
        self.known = Known(data, self.heard, self.members, recorded.scatters, recorded.unsound)
        evidence = Evidence(recorded, self.known)
        found = {kind.name: kind.measured(evidence) for kind in self.kinds}
        self.measured = Groups({name: values for name, (values, _) in found.items()})
        std = Groups({name: std for name, (_, std) in found.items()})
        self._model = Predictor(recorded, std)
        self.plain = self.predict(())
        nominal = self._model.expected(())
        self.std = Groups({kind.name: kind.limited(std[kind.name], nominal) for kind in self.kinds})
        self.entries, self._rows = self._layout()
        self.residual = self._vector(self.measured)
        self.correlated = self._correlated(evidence)

    def _whitened(self, kind: Kind, values: Groups) -> np.ndarray:
        """Return what groups hold of a kind beyond the plain model, whitened."""
        return kind.whitened(values[kind.name], self.plain[kind.name], self.std[kind.name], self.recorded)

    @functools.cached_property
    def codes(self) -> tuple[Codes | None, ...]:
        """How uneven the ADC codes of each station with samples are, None where the samples do not show it."""
        rows = np.concatenate(self.members)
        # the least noise, and not what an uneven converter adds to it
        noise = np.fmin(self.measured.noise, self.plain.noise)
        least = 10.0 ** (np.nan_to_num(np.nanmin(np.nanmedian(noise, axis=2), axis=0), nan=-np.inf) / 20.0)
        return tuple(evenness(self.data.samples_of(i)[rows], n) for i, n in zip(self.heard, least, strict=True))

    @functools.cached_property
    def repeating(self) -> np.ndarray:
        """Share of the power in bands that repeats in each sweep of a group (G, S, N), NaN of single sweeps."""
        found = np.full(self.measured.noise.shape, np.nan)
        for receiver, station in enumerate(self.heard):
            samples, rate = self.data.samples_of(station), self.recorded.sample_rate
            for g, rows in enumerate(self.members):
                if len(rows) > 1:
                    each = as_complex(samples[rows].astype(np.float32), self.recorded.topology.iq)
                    found[g, receiver] = repeating_share(each, self.sweeps[g].line[:, receiver], rate)
        return found

    def _layout(self) -> tuple[Entries, dict[str, np.ndarray]]:
        """Return what each number of the vector is, and where each kind's numbers stand in it, by its name.

        The vector goes group by group: what each group has of every kind, then what each of its sweeps has.
        """
        counts = np.array([len(m) for m in self.members])
        shapes = {k: k.rows(self._whitened(k, self.measured)).shape[1:] for k in self.kinds if not k.per_sweep}
        alike = sum(rows * width for rows, width in shapes.values())
        per_sweep = [kind for kind in self.kinds if kind.per_sweep]
        starts = np.cumsum([0, *(alike + len(per_sweep) * counts[:-1])])
        total = int(starts[-1] + alike + len(per_sweep) * counts[-1])
        names = np.empty(total, f'U{max(len(kind.name) for kind in self.kinds)}')
        station, group, position = (np.full(total, -1) for _ in range(3))
        places, at = {}, 0
        for kind, (rows, width) in shapes.items():
            columns = at + np.arange(rows * width)
            places[kind.name] = where = starts[:, None] + columns
            names[where], group[where] = kind.name, np.arange(len(counts))[:, None]
            if kind.of is not Of.PATH:
                station[where] = np.repeat(np.arange(rows), width)
            position[where] = np.tile(np.arange(width), rows)
            at += rows * width
        for number, kind in enumerate(per_sweep):
            first = starts + alike + number * counts
            places[kind.name] = where = np.concatenate(
                [start + np.arange(n) for start, n in zip(first, counts, strict=True)]
            )
            names[where], group[where] = kind.name, np.repeat(np.arange(len(counts)), counts)
            position[where] = np.concatenate(self.members)
        return Entries(names, station, group, position), places

    def _vector(self, values: Groups) -> np.ndarray:
        """Return features less those of the plain model, over their standard deviations."""
        result = np.empty(len(self.entries.kind))
        for kind in self.kinds:
            where = self._rows[kind.name]
            result[where] = self._whitened(kind, values).reshape(where.shape)
        return np.clip(result, -MODEL.largest, MODEL.largest)

    def _correlated(self, evidence: Evidence) -> Correlated:
        """Return both phases' terms, where one station is far noisier than the other."""
        first, second, share = [], [], []
        for kind in self.kinds:
            pair, shares = kind.in_pairs(evidence)
            if shares.any():
                one, other = (self.rows(kind, row).reshape(shares.shape) for row in pair)
                used = shares != 0.0
                first.append(one[used])
                second.append(other[used])
                share.append(shares[used])
        if not share:
            return Correlated(np.zeros(0, int), np.zeros(0, int), np.zeros(0))
        return Correlated(np.concatenate(first), np.concatenate(second), np.concatenate(share))

    def rows(self, kind: Kind, station: int | None = None) -> np.ndarray:
        """Return where the numbers of a kind stand in the vector, in order (n,); those of one station or of all."""
        rows = self._rows[kind.name].ravel()
        return rows if station is None else rows[self.entries.station[rows] == station]

    def rows_of_kinds(self, chosen: Callable[[Kind], bool]) -> np.ndarray:
        """Return where the numbers of the kinds chosen stand in the vector, kind by kind (n,)."""
        return np.concatenate([self.rows(kind) for kind in self.kinds if chosen(kind)])

    def series(self) -> list[tuple[Kind, int]]:
        """Return kinds with the stations, or the ramp's channels, that have numbers of each; -1 for the path."""
        stations = ((kind, np.unique(self.entries.station[self.rows(kind)])) for kind in self.kinds)
        return [(kind, int(station)) for kind, numbers in stations for station in numbers]

    def predict(self, effects: Sequence[Effect]) -> Groups:
        """Return the numbers that the model with `effects` predicts."""
        return self._predict(tuple(effects))

    @functools.lru_cache(maxsize=64)  # noqa: B019 a comparison lives as long as its predictions are wanted
    def _predict(self, effects: tuple[Effect, ...]) -> Groups:
        expected = self._model.expected(effects)
        return Groups({kind.name: self._joined(kind, expected) for kind in self.kinds})

    def _joined(self, kind: Kind, expected: Sequence[Expected]) -> np.ndarray:
        """Return the predicted numbers of a kind of all groups in their order."""
        return self._model.joined([kind.predicted(e) for e in expected], kind.per_sweep)

    @functools.cached_property
    def common_errors(self) -> np.ndarray:
        """What the forward model without effects may be off by in many numbers at once, whitened (k, n).

        Each row is one error of one standard deviation of its prior.
        """
        nominal = self._model.expected(())
        found = [np.zeros((0, len(self.residual)))]
        for kind in self.kinds:
            for values in kind.common_errors(self.std[kind.name], nominal):
                row = np.zeros((1, len(self.residual)))
                row[0, self._rows[kind.name].ravel()] = np.nan_to_num(values / self.std[kind.name]).ravel()
                found.append(row)
        return np.concatenate(found)

    def displaced(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return `template` with the target farther by the standard deviation of each group's mean reference."""
        return self._altered(effects, displaced=True)

    def outcomes(self, effects: Sequence[Effect]) -> list[np.ndarray]:
        """Return `template` with the random phases of effects scattered by a standard deviation, in each way."""
        count = sum(e.fluctuates for e in effects)
        return [self._altered(effects, outcome=number) for number in range(4 * count)]

    def _altered(self, effects: Sequence[Effect], displaced: bool = False, outcome: int | None = None) -> np.ndarray:
        expected = self._model.expected(tuple(e for e in effects if not e.bursts), displaced, outcome)
        altered = self._vector(Groups({kind.name: self._joined(kind, expected) for kind in self.kinds}))
        bursting = tuple(e for e in effects if e.bursts)
        return altered + self._vector(self.predict(bursting)) if bursting else altered

    @functools.lru_cache(maxsize=4)  # noqa: B019 a comparison lives as long as its predictions are wanted
    def sines(self, count: int) -> tuple[int, ...]:
        """Return the numbers of the strongest sines of any phase that the phases of all sweeps hold, see `waves`."""
        rows = range(len(self.channels) // 2, len(self.channels))
        chosen = [(g, row) for g in range(len(self.members)) for row in rows]
        terms = [ramp_spectrum(self.sweeps[g].ramp[:, row]) for g, row in chosen]
        stds = [np.sqrt(self.std.flutter[at]) for at in chosen]
        return several([values - values.mean(axis=0) for values in terms], stds, SCATTER.steady, count)

    def distances(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return where effects of the reference have the crane, on average in each group (G,) [m]."""
        return self._model.distances(tuple(effects))

    def disturbance(self, effect: Effect) -> float:
        """Return by how much an effect alone changes the lines within a sweep: rms of log amplitude or phase [rad].

        The largest of all groups and stations, of a change of the level as well.
        """
        if effect.distorts or effect.bursts or effect.fluctuates:
            return np.inf
        found = []
        for expected, nominal in zip(self._model.expected((effect,)), self._model.expected(()), strict=True):
            ramp = expected.features.ramp - nominal.features.ramp
            level = (expected.features.amplitude - nominal.features.amplitude) * (np.log(10.0) / 20.0)
            found += [float(np.sqrt(np.mean(ramp**2, axis=-1)).max()), float(np.abs(level).max())]
        return max(found)

    def quadratures(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return what cosine and sine of each random phase do to the ramp (E, 2, G, 2 S, K)."""
        return self._model.quadratures(tuple(e for e in effects if not e.bursts))

    def changing(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much the ramp with `effects` changes from sweep to sweep (G, 2 S, K), see `Predictor`."""
        return self._model.changing(tuple(effects))

    def uneven(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return by how much distortion among `effects` makes noise uneven (G, S, NUMBERS), see `Predictor.uneven`."""
        return self._model.uneven(tuple(effects))

    def scattering(self, effects: Sequence[Effect]) -> np.ndarray:
        """Return how far distortion among `effects` changes noise by chance (G, S, N), see `Predictor.scattering`."""
        return self._model.scattering(tuple(effects))

    def template(self, effects: Sequence[Effect], around: tuple[Effect, ...] | None = None) -> np.ndarray:
        """Return what `effects` add to the model, over the standard deviations of the data; compare with `residual`.

        Args:
            effects: that act.
            around: effects without distortion, on which a distortion acts in place of those among `effects`: what it
                adds to similar ones is nearly the same, and so known already. None: on the very ones.
        """
        if not effects:
            return self._vector(self.plain)
        # bursts are simulated apart: they come and go among the noise, whatever the line does
        apart = tuple(e for e in effects if e.bursts), tuple(e for e in effects if not e.bursts)
        distorting = tuple(e for e in effects if e.distorts)
        if around is not None and distorting:
            apart = apart[0], tuple(e for e in apart[1] if not e.distorts)
        vectors = (self._vector(self.predict(part)) for part in apart if part)
        result = functools.reduce(np.add, vectors, np.zeros(len(self.residual)))
        if around is not None and distorting:
            result += self._vector(self.predict((*around, *distorting)))
            if around:
                result -= self._vector(self.predict(around))
        return result
