"""Which parts of a calibration the ranges of a site correct, with covariance, rivals, and what stays unknown."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from .candidates import Candidate, Pair, response
from .groups import Group

ACCEPTED = 25.0
"""Fall of chi-square from which on a correction counts: 5 sigma, of a dozen candidates 1e-5 by chance (chosen)."""
RIVAL = 9.0
"""Difference of chi-square within which another explanation fits as well: 3 sigma (chosen)."""
_TRUSTED_START_DELAY = 10e-9  # of T_off from its nominal value: tolerance of the integrity test [s]
_OUTLIER = 5.0  # standard deviations from the fit from which on a group is not explained by any calibration
_FEWEST = 3  # groups that are left, or a third of all
_USEFUL = 1e-3  # displacement of a range that matters [m]
_FLOOR = 0.1e-3  # below which means of ranges are not trusted [m]


@dataclasses.dataclass(frozen=True)
class Correction:
    """One fitted number."""

    candidate: Candidate
    value: float  # [units]
    std: float  # [units]
    gain: float  # of chi-square without it
    rivals: tuple[Candidate, ...]  # which explain the ranges as well in its place


@dataclasses.dataclass(frozen=True)
class SiteFit:
    """What the groups of a recording determine."""

    groups: tuple[Group, ...]
    corrections: tuple[Correction, ...]
    covariance: np.ndarray  # of their values [units]
    residual: np.ndarray  # (groups,) error that is left [m]
    residual_std: np.ndarray  # (groups,) its standard deviation [m]
    explained: np.ndarray  # (groups,) whether the fit holds there
    undetermined: tuple[tuple[Candidate, float], ...]  # and how much of a range, at most, it may hide [m]
    misfit: float  # chi-square per degree of freedom of the explained groups, ranges only
    before: np.ndarray  # (groups,) error of each group before any correction [m]


def fit_site(
    groups: Sequence[Group],
    calibrations: Pair,
    offered: Sequence[Candidate],
    before: Mapping[Candidate, float] | None = None,
) -> SiteFit:
    """Return the corrections that the groups call for.

    Weighted least squares on mean errors and T_off of all groups. Corrections are added one by one, the largest fall
    of chi-square first; stated standard deviations of the calibration bind them. Groups that no calibration explains
    (clipped, reflected) are set aside and named.

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
    fewest = max(_FEWEST, len(groups) // 3)
    chosen = problem.selected(explained, kept)
    while np.count_nonzero(explained) > fewest:
        odd = problem.odd_one(chosen, explained, kept)
        if odd is None:
            break
        explained[odd] = False
        chosen = problem.selected(explained, kept)
    solution, covariance, _ = problem.solve(chosen, explained)
    residual = problem.range_error - problem.range_design[:, chosen] @ solution
    pull = np.abs(residual) / problem.range_std
    explained &= pull < _OUTLIER
    predicted = np.einsum('ij,jk,ik->i', problem.range_design[:, chosen], covariance, problem.range_design[:, chosen])
    corrections = [
        Correction(offered[j], float(solution[k]), math.sqrt(covariance[k, k]), *problem.rivals(chosen, j, explained))
        for k, j in enumerate(chosen)
    ]
    spare = max(int(np.count_nonzero(explained)) - len(chosen), 1)
    return SiteFit(
        groups=tuple(groups),
        corrections=tuple(corrections),
        covariance=covariance,
        residual=residual,
        residual_std=np.sqrt(problem.range_std**2 + predicted),
        explained=explained,
        undetermined=tuple(problem.undetermined(chosen, explained)),
        misfit=float(np.sum(pull[explained] ** 2)) / spare,
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
            bound = np.diag([candidate.prior**-2 for candidate in self.offered])
            self.known[key] = design.T @ design + bound, design.T @ target, float(target @ target)
        return self.known[key]

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
        while len(chosen) < min(len(self.offered), int(np.count_nonzero(rows)) - 1):
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
        pull = np.abs(self.range_error - self.range_design[:, list(chosen)] @ solution) / self.range_std
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

    def rivals(self, chosen: Sequence[int], own: int, rows: np.ndarray) -> tuple[float, tuple[Candidate, ...]]:
        """Return by how much chi-square grows without a candidate, and which ones would do as well."""
        best = self.solve(chosen, rows)[2]
        others = [j for j in chosen if j != own]
        found = [
            self.offered[j]
            for j in range(len(self.offered))
            if j not in chosen and self.solve([*others, j], rows)[2] < best + RIVAL
        ]
        return self.solve(others, rows)[2] - best, tuple(found)

    def undetermined(self, chosen: Sequence[int], rows: np.ndarray) -> list[tuple[Candidate, float]]:
        """Return the candidates that could be off by more than matters, and by how much [m]."""
        found = []
        for j, candidate in enumerate(self.offered):
            if j in chosen:
                continue
            with_it = [*chosen, j]
            covariance = self.solve(with_it, rows)[1]
            design = self.range_design[:, with_it]
            hidden = float(np.sqrt(np.max(np.einsum('ij,jk,ik->i', design, covariance, design))))
            alone = math.sqrt(covariance[-1, -1]) * float(np.max(np.abs(self.range_design[:, j])))
            if alone > max(_USEFUL, 2.0 * hidden):
                found.append((candidate, alone))
        return found
