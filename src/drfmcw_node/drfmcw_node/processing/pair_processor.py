"""Sweeps of both stations in, beat frequencies of both out, evaluated together."""

import collections
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Role

from ..estimators.pair import PairEstimator, pair_estimator
from .processor import StationProcessor, Wanted, refusal, wanted_spectra
from .records import Beat, Spectrum, Sweep

_WAITING_LIMIT = 4096  # sweeps that wait for their partner
_LARGEST_STAMP_DIFFERENCE = 1_000_000_000  # of partners; beyond it one number stands for two runs [ns]


class PairProcessor(StationProcessor):
    """Turns sweeps of both stations of any pairs into beat frequencies of both.

    A sweep waits for its partner, the peer's sweep of the same number, until `give_up` or `finish` is called or too
    many wait. Then it is evaluated alone, by maximum likelihood. The sweep of a station that hears itself is evaluated
    at once. Stamps do not limit the wait, because sweeps may come faster or slower than they were made.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Start without anything waiting; arguments as for `StationProcessor`."""
        super().__init__(*args, **kwargs)
        self._waiting: collections.OrderedDict[tuple, Sweep] = collections.OrderedDict()
        self._newest: dict[tuple[str, str], tuple[int, int]] = {}  # sweep number and checksum of the samples
        self._waited: dict[tuple, Sweep] = {}  # at the last call of give_up
        self._pair_estimators: dict[tuple, PairEstimator | str] = {}
        self.pairs = 0
        """Pairs evaluated since start."""
        self.unpaired = 0
        """Sweeps evaluated alone because their partner did not come, since start."""

    @property
    def waiting(self) -> int:
        """Number of sweeps that wait for their partner."""
        return len(self._waiting)

    def has_settings(self, sweep: Sweep) -> bool:
        """Return True where settings and calibrations have arrived that a sweep and its partner need."""
        peer = self._sweep_settings.get((sweep.peer, sweep.station))
        return super().has_settings(sweep) and peer is not None and peer.at(sweep.stamp) is not None

    def give_up(self) -> list[Beat]:
        """Return the beat frequencies of the sweeps that waited at the last call already, each evaluated alone."""
        overdue = [key for key, sweep in self._waited.items() if self._waiting.get(key) is sweep]
        alone = [self._waiting.pop(key) for key in overdue]
        self._waited = dict(self._waiting)
        return self._alone(alone)

    def finish(self) -> list[Beat]:
        """Return the beat frequencies of the sweeps still waiting, each evaluated alone."""
        alone = list(self._waiting.values())
        self._waiting.clear()
        return self._alone(alone)

    def _alone(self, sweeps: Sequence[Sweep]) -> list[Beat]:
        self.unpaired += len(sweeps)
        return super()._process(sweeps, None)[0]

    def _process(self, sweeps: Sequence[Sweep], wanted: Wanted) -> tuple[list[Beat], list[Spectrum]]:
        alone, pairs = self._matched(sweeps)
        beats, spectra = super()._process(alone, wanted)
        groups: dict[int, tuple[PairEstimator, list[tuple[Sweep, Sweep]]]] = {}
        self.sweeps += 2 * len(pairs)
        for pair in pairs:
            chosen = self._pair_estimator(pair)
            if isinstance(chosen, str):
                for _ in pair:
                    self.drop(chosen)
            else:
                groups.setdefault(id(chosen), (chosen, []))[1].append(pair)
        for chosen, group in groups.values():
            mask = wanted_spectra([pair[0] for pair in group], wanted)
            columns = list(zip(*group, strict=True))
            first, second = (np.stack([np.asarray(s.samples) for s in column]) for column in columns)
            scales = [np.array([s.full_scale for s in column]) for column in columns]
            self.pairs += len(group)
            results = chosen(first, second, (scales[0], scales[1]), mask)
            found = [self._results(column, r, mask) for column, r in zip(columns, results, strict=True)]
            for of_pair in zip(*(b for b, _ in found), strict=True):
                beats.extend(of_pair)
            for of_pair in zip(*(s for _, s in found), strict=True):
                spectra.extend(s for s in of_pair if s is not None)
        return beats, spectra

    def _matched(self, sweeps: Sequence[Sweep]) -> tuple[list[Sweep], list[tuple[Sweep, Sweep]]]:
        """Return the sweeps to evaluate alone, and pairs (first station's, second station's)."""
        alone, unpaired, pairs = [], [], []
        for sweep in sweeps:
            if self._repeats(sweep):
                self.sweeps += 1
                self.drop(f'samples of {sweep.station} are those of the sweep before')
                continue
            if sweep.peer == sweep.station:
                alone.append(sweep)
                continue
            key = (*sorted((sweep.station, sweep.peer)), sweep.sweep_id)
            partner = self._waiting.pop(key, None)
            if partner is None:
                self._waiting[key] = sweep
            elif partner.station == sweep.station or abs(partner.stamp - sweep.stamp) > _LARGEST_STAMP_DIFFERENCE:
                unpaired.append(partner)
                self._waiting[key] = sweep
            else:
                pairs.append((partner, sweep))
        while len(self._waiting) > _WAITING_LIMIT:
            unpaired.append(self._waiting.popitem(last=False)[1])
        self.unpaired += len(unpaired)
        alone += unpaired
        return alone, [self._in_order(pair) for pair in pairs]

    def _repeats(self, sweep: Sweep) -> bool:
        """Return whether a sweep's buffer was read twice; a joint estimate does not show it."""
        samples = np.ascontiguousarray(sweep.samples)
        seen = sweep.sweep_id, zlib.crc32(samples.data)
        before = self._newest.get((sweep.station, sweep.peer))
        self._newest[sweep.station, sweep.peer] = seen
        return before is not None and before[0] != seen[0] and before[1] == seen[1] and len(set(samples.tolist())) > 1

    def _in_order(self, pair: tuple[Sweep, Sweep]) -> tuple[Sweep, Sweep]:
        """Return the first station's sweep first, where the settings are known."""
        conditions = self._conditions(pair[0])
        return pair if isinstance(conditions, str) or conditions[0].role == Role.FIRST else pair[::-1]

    def _pair_estimator(self, pair: tuple[Sweep, Sweep]) -> PairEstimator | str:
        """Return the estimator for both sweeps' settings and calibrations, or why there is none."""
        one, other = self._conditions(pair[0]), self._conditions(pair[1])
        if isinstance(one, str):
            return one
        if isinstance(other, str):
            return other
        (first, own, peer), second = one, other[0]
        for sweep, settings in zip(pair, (first, second), strict=True):
            reason = refusal(sweep, np.asarray(sweep.samples), settings.sample_count)
            if reason:
                return reason
        if pair[0].iq != pair[1].iq:
            return f'one of {first.station} and {second.station} has a quadrature receiver, the other has none'
        key = (id(first), id(second), id(own), id(peer), pair[0].iq)
        chosen = self._pair_estimators.get(key)
        if chosen is None:
            try:
                chosen = pair_estimator(first, second, self._settings, pair[0].iq, own, peer)
            except ConfigurationError as error:
                chosen = str(error)
            self._pair_estimators[key] = chosen
        return chosen

    def _forget_estimators(self) -> None:
        super()._forget_estimators()
        self._pair_estimators.clear()
