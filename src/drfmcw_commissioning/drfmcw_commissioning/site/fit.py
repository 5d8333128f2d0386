"""Which parts of a calibration the ranges of a site correct, and how far each number may still be off."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import stats

from .candidates import Candidate, Pair, response
from .groups import Group

ACCEPTED = 25.0
"""Fall of chi-square from which on a correction counts: 5 sigma, of a dozen candidates 1e-5 by chance (chosen)."""
_TRUSTED_START_DELAY = 10e-9  # of T_off from its nominal value: tolerance of the integrity test [s]
_OUTLIER = 5.0  # standard deviations from the fit from which on a group is not explained by any calibration
_FEWEST = 3  # groups that are left
_MOST_LEFT_OUT = 1.0 / 3.0  # of groups without doubt; beyond it corrections follow whatever else is there (chosen)
_USEFUL = 1e-3  # displacement of a range that matters [m]
_FLOOR = 0.1e-3  # below which means of ranges are not trusted [m]
_POOR = 1e-3  # probability of what is left by chance, below which its scatter replaces the stated noise


@dataclasses.dataclass(frozen=True)
class Correction:
    """One fitted number."""

    candidate: Candidate
    value: float  # [units]
    std: float  # [units]
    gain: float  # of chi-square without it


@dataclasses.dataclass(frozen=True)
class Undetermined:
    """One number that could be off by more than matters without showing in the ranges."""

    candidate: Candidate
    std: float  # beside what is corrected [units]
    displacement: float  # of a range by that much, at most [m]


@dataclasses.dataclass(frozen=True)
class Posterior:
    """What the explained groups and what was known before say of every candidate."""

    offered: tuple[Candidate, ...]
    information: np.ndarray  # (candidates, candidates) inverse covariance [1/units^2]
    pull: np.ndarray  # (candidates,) information times the most probable values [1/units]
    corrected: Mapping[Candidate, float]  # what is corrected [units]

    def step(self, free: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
        """Return how far some numbers most probably are from what is corrected (k,), and their covariance.

        The other numbers count as they are corrected.
        """
        columns = [self.offered.index(c) for c in free]
        covariance = np.linalg.inv(self.information[np.ix_(columns, columns)])
        return covariance @ self._left[columns], covariance

    def share(self, own: Sequence[Candidate]) -> float:
        """Return the share [0..1] of some numbers in what is left, by the falls of chi-square that each would bring."""
        falls = self._left**2 / np.diag(self.information)
        return float(falls[[self.offered.index(c) for c in own]].sum() / max(falls.sum(), 1e-30))

    @property
    def _left(self) -> np.ndarray:
        """Half the slope of chi-square by each candidate, after the corrections (candidates,) [1/units]."""
        left: np.ndarray = self.pull - self.information @ [self.corrected.get(c, 0.0) for c in self.offered]
        return left


@dataclasses.dataclass(frozen=True)
class SiteFit:
    """What the groups of a recording determine."""

    groups: tuple[Group, ...]
    corrections: tuple[Correction, ...]
    posterior: Posterior
    residual: np.ndarray  # (groups,) error that is left [m]
    residual_std: np.ndarray  # (groups,) its standard deviation [m]
    explained: np.ndarray  # (groups,) whether the fit holds there; nowhere: no calibration explains the site
    undetermined: tuple[Undetermined, ...]
    misfit: float  # chi-square per degree of freedom of the explained groups, ranges only
    before: np.ndarray  # (groups,) error of each group before any correction [m]

    def errors(self, own: Sequence[Candidate]) -> np.ndarray:
        """Return mean squares and products of the errors of some numbers as they are corrected (k, k) [units^2].

        The others count as they are corrected: added in quadrature, as the fusion does, the errors of all then give
        what the site leaves open of a range. A number that is not determined may be off by what the corrections make up
        for. An offset that is not worth a correction is an error, which all share that would explain it.
        """
        free = list(own)
        if any(u.candidate in own for u in self.undetermined):
            free += [c for c in self.posterior.corrected if c not in own]
        off, covariance = self.posterior.step(free)
        return (covariance + self.posterior.share(own) * np.outer(off, off))[: len(own), : len(own)]


def fit_site(
    groups: Sequence[Group],
    calibrations: Pair,
    offered: Sequence[Candidate],
    before: Mapping[Candidate, float] | None = None,
) -> SiteFit:
    """Return the corrections that the groups call for.

    Weighted least squares on mean errors and T_off of all groups. Corrections are added one by one, the largest fall
    of chi-square first; stated standard deviations of the calibration bind them. Groups that no calibration explains
    (clipped, reflected) are set aside and named; where these are too many, nothing is corrected.

    Args:
        groups: of one recording.
        calibrations: that the ranges were computed with, first and second.
        offered: what may be corrected.
        before: corrections that the calibrations hold already [units]. They are fitted anew, as if they did not hold
            them, and stay.
    """
    offered, before = list(offered), before or {}
    problem = _Problem.of(groups, offered, calibrations, before)
    kept = [j for j, candidate in enumerate(offered) if candidate in before]
    explained = np.array([2 * g.doubtful <= g.count for g in groups], bool)
    if np.count_nonzero(explained) < _FEWEST:
        explained[:] = True
    sound = explained.copy()
    chosen = problem.selected(explained, kept)
    while np.count_nonzero(explained) > _FEWEST and np.mean(~explained[sound]) <= _MOST_LEFT_OUT:
        odd = problem.odd_one(chosen, explained, kept)
        if odd is None:
            break
        explained[odd] = False
        chosen = problem.selected(explained, kept)
    explained &= np.abs(problem.left(chosen, problem.solve(chosen, explained)[0])) < _OUTLIER * problem.range_std
    if np.mean(~explained[sound]) > _MOST_LEFT_OUT:
        chosen, explained[:] = [], False
    solution = problem.solve(chosen, explained)[0]
    pull = problem.left(chosen, solution)[explained] / problem.range_std[explained]
    spare = max(len(pull) - len(chosen), 1)
    misfit = float(pull @ pull) / spare
    widened = misfit if stats.chi2.sf(misfit * spare, spare) < _POOR else 1.0
    posterior = problem.posterior(chosen, explained, widened)
    covariance = posterior.step(list(posterior.corrected))[1]
    values = np.array(list(posterior.corrected.values()))
    design = problem.range_design[:, chosen]
    corrections = [
        Correction(offered[j], float(values[k]), math.sqrt(covariance[k, k]), problem.gain(chosen, j, explained))
        for k, j in enumerate(chosen)
    ]
    return SiteFit(
        groups=tuple(groups),
        corrections=tuple(corrections),
        posterior=posterior,
        residual=problem.left(chosen, values),
        residual_std=np.sqrt(problem.range_std**2 + np.einsum('ij,jk,ik->i', design, covariance, design)),
        explained=explained,
        undetermined=tuple(problem.undetermined(posterior)) if explained.any() else (),
        misfit=misfit,
        before=problem.range_error,
    )


@dataclasses.dataclass(frozen=True)
class _Problem:
    """Measured displacements and what each candidate does to them."""

    offered: list[Candidate]
    range_error: np.ndarray  # (groups,) [m]
    range_std: np.ndarray
    range_design: np.ndarray  # (groups, candidates) [m per unit]
    excess: np.ndarray  # (groups,) [s]
    excess_std: np.ndarray
    excess_design: np.ndarray
    known: dict[bytes, tuple[np.ndarray, np.ndarray, float]]  # normal equations by rows

    @classmethod
    def of(
        cls, groups: Sequence[Group], offered: list[Candidate], calibrations: Pair, before: Mapping[Candidate, float]
    ) -> '_Problem':
        designs = np.array([response(candidate, groups, calibrations) for candidate in offered])
        amounts = np.array([before.get(candidate, 0.0) for candidate in offered])
        held = np.einsum('c,cqg->qg', amounts, designs)
        return cls(
            offered,
            np.array([g.error for g in groups]) + held[0],
            np.hypot([g.std for g in groups], _FLOOR),
            designs[:, 0].T,
            np.array([g.excess for g in groups]) + held[1],
            np.hypot([g.excess_std for g in groups], _TRUSTED_START_DELAY),
            designs[:, 1].T,
            {},
        )

    def normal(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the normal equations of all candidates: matrix, right-hand side, chi-square without any."""
        key = rows.tobytes()
        if key not in self.known:
            design = np.vstack(
                [
                    self.range_design[rows] / self.range_std[rows, None],
                    self.excess_design[rows] / self.excess_std[rows, None],
                ]
            )
            target = np.concatenate(
                [self.range_error[rows] / self.range_std[rows], self.excess[rows] / self.excess_std[rows]]
            )
            self.known[key] = design.T @ design + self.bound, design.T @ target, float(target @ target)
        return self.known[key]

    @property
    def bound(self) -> np.ndarray:
        """What was known before of all candidates: inverse covariance [1/units^2]."""
        return np.diag([candidate.prior**-2 for candidate in self.offered])

    def solve(self, chosen: Sequence[int], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return values and covariance of candidates [units], and chi-square with them."""
        matrix, right, chi_square = self.normal(rows)
        columns = list(chosen)
        covariance = np.linalg.inv(matrix[np.ix_(columns, columns)])
        solution = covariance @ right[columns]
        return solution, covariance, chi_square - float(right[columns] @ solution)

    def selected(self, rows: np.ndarray, kept: Sequence[int] = ()) -> list[int]:
        """Return the candidates that the rows call for, in the order in which they were chosen, `kept` first."""
        chosen = list(kept)
        best = self.solve(chosen, rows)[2]
        most = min(len(self.offered), max(1, int(np.count_nonzero(rows)) - 1))
        while len(chosen) < most:
            rest = [j for j in range(len(self.offered)) if j not in chosen]
            tried = [self.solve([*chosen, j], rows)[2] for j in rest]
            if best - min(tried) < ACCEPTED:
                break
            # of those that fit alike the first one offered
            added = next(j for j, value in zip(rest, tried, strict=True) if value < min(tried) + 0.5)
            chosen.append(added)
            best = self.solve(chosen, rows)[2]
            for j in chosen[len(kept) : -1]:  # what a later one makes superfluous
                without = self.solve([i for i in chosen if i != j], rows)[2]
                if without - best < ACCEPTED:
                    chosen.remove(j)
                    best = without
        return chosen

    def odd_one(self, chosen: Sequence[int], rows: np.ndarray, kept: Sequence[int]) -> int | None:
        """Return the group without which the others need less explaining by more than a correction is worth.

        One correction, and no group beyond `_OUTLIER`: nothing is odd.
        """
        solution, _, chi_square = self.solve(chosen, rows)
        pull = np.abs(self.left(chosen, solution)) / self.range_std
        if len(chosen) < 2 and np.max(pull[rows]) < _OUTLIER:
            return None
        least, odd = chi_square + ACCEPTED * len(chosen), None
        for row in np.flatnonzero(rows):
            rest = rows.copy()
            rest[row] = False
            fewer = self.selected(rest, kept)
            cost = self.solve(fewer, rest)[2] + ACCEPTED * (len(fewer) + 1)
            if cost < least:
                least, odd = cost, int(row)
        return odd

    def left(self, chosen: Sequence[int], values: np.ndarray) -> np.ndarray:
        """Return the error of each group with candidates of these values [units] corrected [m]."""
        return self.range_error - self.range_design[:, list(chosen)] @ values

    def gain(self, chosen: Sequence[int], own: int, rows: np.ndarray) -> float:
        """Return by how much chi-square grows without a candidate."""
        others = [j for j in chosen if j != own]
        return self.solve(others, rows)[2] - self.solve(chosen, rows)[2]

    def posterior(self, chosen: Sequence[int], rows: np.ndarray, widened: float) -> Posterior:
        """Return what the groups say of all candidates; `widened` multiplies the squares of their standard deviations.

        Args:
            chosen: candidates that are corrected.
            rows: groups that are explained.
            widened: by how much their scatter exceeds what is stated, squared.
        """
        matrix, right, _ = self.normal(rows)
        offered = tuple(self.offered)
        found = Posterior(offered, (matrix - self.bound) / widened + self.bound, right / widened, {})
        own = [offered[j] for j in chosen]
        return dataclasses.replace(found, corrected=dict(zip(own, found.step(own)[0].tolist(), strict=True)))

    def undetermined(self, posterior: Posterior) -> list[Undetermined]:
        """Return the candidates that could be off by more than matters."""
        found = []
        corrected = list(posterior.corrected)
        for j, candidate in enumerate(self.offered):
            if candidate in corrected:
                continue
            covariance = posterior.step([*corrected, candidate])[1]
            design = self.range_design[:, [*map(self.offered.index, corrected), j]]
            hidden = float(np.sqrt(np.max(np.einsum('ij,jk,ik->i', design, covariance, design))))
            std = math.sqrt(covariance[-1, -1])
            alone = std * float(np.max(np.abs(self.range_design[:, j])))
            if alone > max(_USEFUL, 2.0 * hidden):
                found.append(Undetermined(candidate, std, alone))
        return found
