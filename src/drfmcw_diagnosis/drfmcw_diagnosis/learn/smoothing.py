"""Smooth curves of many numbers over one covariate; covariate and smoothness are chosen by held-out sweeps.

Candidates are the same value everywhere, a straight line, natural cubic splines of several stiffnesses, and a value of
its own at each point. Each fold of the sweeps is predicted by the others. Of all candidates that predict as well as the
best one, the smoothest is taken; without gain beyond that of noise there is no curve.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from .limits import LEARNING


@dataclasses.dataclass(frozen=True)
class Sample:
    """P numbers of G groups of sweeps in F folds; NaN where a number is not known."""

    values: np.ndarray  # (F, G, P) means over the sweeps of a fold
    count: np.ndarray  # (F, G) sweeps of each
    variance: np.ndarray  # (G, P) of one sweep


@dataclasses.dataclass(frozen=True)
class Covariate:
    """What a curve may depend on."""

    axis: str  # as in `drfmcw_sim.synthesis.measured.AXES`
    station: str  # whose line or board, '' for distance and time
    values: np.ndarray  # (G,)


@dataclasses.dataclass(frozen=True)
class Smooth:
    """A curve of P numbers over M points of a covariate."""

    covariate: Covariate
    at: np.ndarray  # (M,)
    values: np.ndarray  # (M, P)
    variance: np.ndarray  # (M, P) of the same
    freedom: float  # values that the data determine of each number
    terms: int  # numbers that are not zero, the first ones
    gain: float  # squared standard deviations that it explains of held-out sweeps
    elsewhere: float  # share of what it explains that it also predicts where it was not learnt [1]; NaN: not testable


def points(covariate: Covariate) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct values of a covariate (M,), and the point of each group (G,)."""
    values = covariate.values
    order = np.argsort(values, kind='stable')
    step = LEARNING.alike * max(float(np.ptp(values)), 1e-12)
    number = np.cumsum(np.diff(values[order], prepend=values[order][0]) > step)
    point = np.empty(len(values), int)
    point[order] = number
    at = np.bincount(point, values) / np.bincount(point)
    return at, point


def smooth(sample: Sample, covariates: Sequence[Covariate], ordered: bool) -> Smooth | None:
    """Return the curve that predicts held-out sweeps best, None where none does better than nothing.

    Args:
        sample: what is to be described.
        covariates: on which it may depend, the likeliest first; the first one is the same everywhere.
        ordered: the numbers are terms of a series, of which the first ones may do.
    """
    tried: list[tuple[float, float, int, Covariate, float]] = []
    for covariate in covariates:
        at, point = points(covariate)
        if covariate.axis and len(at) < 2:
            continue
        for stiffness in _stiffnesses(len(at), covariate.axis):
            gains, freedom = _held_out(sample, at, point, stiffness)
            terms = _terms(gains, freedom) if ordered else len(gains)
            if terms:
                tried.append((float(gains[:terms].sum()), freedom, terms, covariate, stiffness))
    if not tried:
        return None
    best = max(tried, key=lambda t: t[0])
    noise = math.sqrt(2.0 * best[1] * best[2])
    if best[0] < LEARNING.beyond_chance * noise:
        return None
    good = [t for t in tried if t[0] > best[0] - LEARNING.as_good * noise]
    gain, freedom, terms, covariate, stiffness = min(good, key=lambda t: round(t[1] * t[2], 3))
    return _fitted(sample, covariate, stiffness, terms, gain)


def first_terms(sample: Sample) -> int:
    """Return how many of the first numbers, alike in all groups, predict held-out sweeps best; 0 for none."""
    point = np.zeros(sample.values.shape[1], int)
    gains, freedom = _held_out(sample, np.zeros(1), point, math.inf)
    terms = _terms(gains, freedom)
    return terms if gains[:terms].sum() > LEARNING.beyond_chance * math.sqrt(2.0 * max(terms, 1)) else 0


def _stiffnesses(count: int, axis: str) -> list[float]:
    """Return the candidates' stiffnesses, inf a straight line."""
    if not axis:
        return [math.inf]
    if count == 2:
        return [LEARNING.free]
    return [math.inf, *LEARNING.stiffness, LEARNING.free]


def _pooled(values: np.ndarray, weight: np.ndarray, point: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return weighted means (M, P) and weights (M, P) of groups' values and weights (G, P) at each point."""
    total, mean = np.zeros((2, count, values.shape[1]))
    np.add.at(total, point, weight)
    np.add.at(mean, point, weight * values)
    return mean / np.maximum(total, 1e-300), total


def _hat(weight: np.ndarray, at: np.ndarray, stiffness: float) -> np.ndarray:
    """Return the matrices (P, M, M) that smooth values with weights (M, P) at M points."""
    count, numbers = weight.shape
    weights = weight.T
    mean = weights.mean(axis=1)
    mean = np.where(mean > 0.0, mean, 1.0)
    weights = np.maximum(weights, 1e-9 * mean[:, None])  # a number that is nowhere known is anything
    if math.isinf(stiffness):
        basis = np.stack([np.ones(count), at - at.mean()][: min(count, 2)], axis=1)
        normal = np.einsum('mi,pm,mj->pij', basis, weights, basis)
        scale = np.sqrt(np.einsum('pii->pi', normal))
        inverse = np.linalg.inv(normal / scale[:, :, None] / scale[:, None]) / scale[:, :, None] / scale[:, None]
        hat: np.ndarray = np.einsum('mi,pij,nj,pn->pmn', basis, inverse, basis, weights)
        return hat
    if count <= 2:
        return np.broadcast_to(np.eye(count), (numbers, count, count))
    # Reinsch's equations keep straight lines exactly, however near two points are or little is known at one
    q, r = _roughness(at)
    pulled = stiffness * mean[:, None, None] * q / weights[:, :, None]
    inner = np.linalg.solve(r + q.T @ pulled, np.broadcast_to(q.T, (numbers, *q.T.shape)))
    return np.eye(count) - pulled @ inner


def _roughness(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return matrices Q (M, M - 2) and R (M - 2, M - 2) of a natural cubic spline (Reinsch 1967).

    The integral of its squared second derivative is f^T Q R^-1 Q^T f of its values f at M points.
    """
    step = np.diff(at) / np.ptp(at)
    inner = len(at) - 2
    q, r = np.zeros((len(at), inner)), np.zeros((inner, inner))
    for i in range(inner):
        q[i, i], q[i + 2, i] = 1.0 / step[i], 1.0 / step[i + 1]
        q[i + 1, i] = -q[i, i] - q[i + 2, i]
        r[i, i] = (step[i] + step[i + 1]) / 3.0
        if i + 1 < inner:
            r[i, i + 1] = r[i + 1, i] = step[i + 1] / 6.0
    return q, r


def _weights(sample: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Return values and weights (F, G, P); weight zero where a number is not known."""
    variance = np.broadcast_to(sample.variance, sample.values.shape)
    known = np.isfinite(sample.values) & np.isfinite(variance) & (variance > 0.0)
    weight = np.where(known, sample.count[..., None] / np.where(known, variance, 1.0), 0.0)
    return np.where(known, sample.values, 0.0), weight


def _without(values: np.ndarray, weight: np.ndarray, fold: int) -> tuple[np.ndarray, np.ndarray]:
    """Return means and weights (G, P) of all folds but one; of all with -1."""
    kept = np.arange(len(values)) != fold
    total = weight[kept].sum(axis=0)
    return (weight[kept] * values[kept]).sum(axis=0) / np.maximum(total, 1e-300), total


def _held_out(sample: Sample, at: np.ndarray, point: np.ndarray, stiffness: float) -> tuple[np.ndarray, float]:
    """Return the gain on held-out folds by each number (P,), and the degrees of freedom of each."""
    values, weight = _weights(sample)
    gains = np.zeros(values.shape[2])
    freedom = 0.0
    for fold in _folds(sample):
        mean, total = _pooled(*_without(values, weight, fold), point, len(at))
        hat = _hat(total, at, stiffness)
        predicted = np.einsum('pmn,np->mp', hat, mean)[point]
        test = values[fold]
        gains += np.sum(weight[fold] * (test**2 - (test - predicted) ** 2), axis=0)
        freedom = float(np.einsum('pmm->p', hat).mean())
    return gains, freedom


def _folds(sample: Sample) -> Iterator[int]:
    yield from range(len(sample.values))


def _terms(gains: np.ndarray, freedom: float) -> int:
    """Return how many of the first terms predict best: the fewest of those that do so as well."""
    total = np.cumsum(gains)
    best = int(np.argmax(total))
    if total[best] <= 0.0:
        return 0
    least = total[best] - LEARNING.as_good * math.sqrt(2.0 * freedom * (best + 1))
    return int(np.argmax(total >= least)) + 1


def _fitted(sample: Sample, covariate: Covariate, stiffness: float, terms: int, gain: float) -> Smooth:
    """Return the chosen curve, fitted to all sweeps."""
    at, point = points(covariate)
    values, weight = _weights(sample)
    if not covariate.axis:
        at = at[:1]
    mean, total = _pooled(*_without(values, weight, -1), point, len(at))
    hat = _hat(total, at, stiffness)
    found = np.einsum('pmn,np->mp', hat, mean)
    variance = np.einsum('pmn,np,pmn->mp', hat, 1.0 / np.maximum(total, 1e-300), hat)
    variance[~np.isfinite(variance) | (total <= 0.0)] = 0.0
    found[:, terms:] = variance[:, terms:] = 0.0
    freedom = float(np.einsum('pmm->p', hat)[:terms].mean())
    elsewhere = _elsewhere(mean[:, :terms], total[:, :terms], at, stiffness)
    return Smooth(covariate, at, found, variance, freedom, terms, gain, elsewhere)


def _elsewhere(mean: np.ndarray, weight: np.ndarray, at: np.ndarray, stiffness: float) -> float:
    """Return the share of the excess at each point that a curve through the other points predicts; NaN below 3 points.

    Args:
        mean: values at the points (M, P).
        weight: of the same.
        at: the points (M,).
        stiffness: of the curve.
    """
    if len(at) < 3:
        return math.nan
    before = after = 0.0
    for left_out in range(len(at)):
        kept = np.arange(len(at)) != left_out
        hat = _hat(weight[kept], at[kept], stiffness)
        curve = np.einsum('pmn,np->mp', hat, mean[kept])
        predicted = np.array([np.interp(at[left_out], at[kept], column) for column in curve.T])
        used = weight[left_out] > 0.0
        before += float(np.sum((weight[left_out] * mean[left_out] ** 2 - 1.0)[used]))
        after += float(np.sum((weight[left_out] * (mean[left_out] - predicted) ** 2 - 1.0)[used]))
    return 1.0 - after / before if before > 0.0 else math.nan
