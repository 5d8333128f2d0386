"""What the effects leave over of each sweep: samples of the curves that a measured remainder consists of."""

from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_sim.effects import Effect
from drfmcw_sim.synthesis.measured import covariate

from ..compare.comparison import Comparison
from ..compare.groups import Groups
from ..features.extractor import SweepFeatures, ramp_spectrum
from .limits import LEARNING
from .smoothing import Covariate, Sample

FEATURES: dict[str, Callable[[SweepFeatures], np.ndarray]] = {
    'ramp': lambda sweeps: ramp_spectrum(sweeps.ramp),
    'amplitude': lambda sweeps: sweeps.amplitude[..., None],
    'beat': lambda sweeps: sweeps.beat[:, None, None],
    'range': lambda sweeps: sweeps.range[:, None, None],
}
"""Kinds of numbers of which every sweep has its own, (n, rows, P)."""


class LeftOver:
    """What the model with some effects leaves of the sweeps of a comparison."""

    def __init__(self, comparison: Comparison, effects: Sequence[Effect]) -> None:
        """Predict with the effects."""
        self.comparison, self.effects = comparison, tuple(effects)
        self.predicted: Groups = comparison.predict(self.effects) if effects else comparison.plain
        self.folds = [np.array_split(np.arange(len(m)), self._count) for m in comparison.members]

    @property
    def _count(self) -> int:
        return min(LEARNING.folds, *(len(m) for m in self.comparison.members), LEARNING.folds)

    @property
    def counts(self) -> np.ndarray:
        """Sweeps in each fold of each group (F, G)."""
        return np.array([[len(part) for part in parts] for parts in self.folds], float).T

    def sample(self, kind: str, row: int) -> Sample:
        """Return the remainder of one kind of number at one station or channel, 0 of the path."""
        c = self.comparison
        values = np.stack([self._residual(kind, row, g) for g in range(len(c.members))], axis=1)
        std = c.std[kind]
        std = (std[:, None] if std.ndim == 1 else std)[:, row].reshape(len(c.members), -1)
        counts = np.array([len(m) for m in c.members])[:, None]
        return Sample(values, self.counts, np.where(np.isfinite(std), std**2 * counts, np.nan))

    def _residual(self, kind: str, row: int, group: int) -> np.ndarray:
        """Return means over the folds of one group (F, P)."""
        c = self.comparison
        each = FEATURES[kind](c.sweeps[group])[:, row]
        if kind == 'range':
            each = each - c.data.distance[c.members[group]][:, None]
        predicted = self.predicted[kind][group]
        predicted = np.atleast_1d(predicted[row] if np.ndim(predicted) else predicted)
        residual: np.ndarray = np.stack([each[part].mean(axis=0) for part in self.folds[group]]) - predicted
        return residual

    def noise(self, station: int) -> Sample:
        """Return the noise in bands of one station beyond the model's [dB], fold by fold (F, G, BANDS)."""
        c = self.comparison
        bands = c.recorded.bands
        values = np.empty((self._count, len(c.members), c.std['noise'].shape[2]))
        for g, sweeps in enumerate(c.sweeps):
            for f, part in enumerate(self.folds[g]):
                power = sweeps.power[part].mean(axis=0)
                line = sweeps.line[part].mean(axis=0)
                found = bands.measured(power, line, np.full(power.shape[0], len(part)))
                values[f, g] = found[station] - self.predicted['noise'][g, station]
        std = c.std['noise'][:, station]
        counts = np.array([len(m) for m in c.members])[:, None]
        return Sample(values, self.counts, np.where(np.isfinite(std), std**2 * counts, np.nan))

    def lines(self, station: int) -> Sample:
        """Return the power of each bin of a station's spectrum beyond the model's [LSB^2], fold by fold (F, G, B)."""
        c = self.comparison
        around = c.std['lines'][:, station]
        expected = around * self.predicted['lines'][:, station]
        values = np.stack(
            [
                np.stack([sweeps.power[part][:, station].mean(axis=0) for part in self.folds[g]]) - expected[g]
                for g, sweeps in enumerate(c.sweeps)
            ],
            axis=1,
        )
        beside = c.recorded.beside_lines[:, station]
        # the power of noise scatters by as much as it is
        return Sample(np.where(beside, values, np.nan), self.counts, np.where(beside, around**2, np.nan))

    def covariates(self, stations: Sequence[str]) -> list[Covariate]:
        """Return on what a curve may depend, the likeliest first: distance, the lines and boards of stations, time."""
        found = [Covariate('', '', np.zeros(len(self.comparison.members)))]
        axes = [('range', '')]
        axes += [(axis, station) for axis in ('if_frequency', 'board_temperature') for station in stations]
        found += [Covariate(axis, station, self.over_groups(axis, station)) for axis, station in [*axes, ('time', '')]]
        return [x for x in found if not x.axis or np.ptp(x.values) > 0.0]

    def over_groups(self, axis: str, station: str) -> np.ndarray:
        """Return a covariate in each group (G,)."""
        c = self.comparison
        result = np.empty(len(c.members))
        for part in c.parts:
            result[part.groups] = covariate(axis, station, part.steady)
        return result
