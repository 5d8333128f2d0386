"""Whether what changes from sweep to sweep is a modulation of one size, or noise.

In: an explanation with effects of random phase, and the sweeps. Out: the odds of each such effect. A modulation has one
size in all sweeps, noise of the same power has one that scatters. The noise near a line is often steeper than any
oscillator's model: its power in a few terms of the ramp alone would pass for a slow modulation.
"""

import dataclasses

import numpy as np
from scipy import special

from ..compare.limits import SCATTER
from ..features.extractor import ramp_spectrum
from ..search.fitted import Fitted
from ..search.fitting import Fitting


@dataclasses.dataclass(frozen=True)
class SteadinessLimits:
    """When a modulation counts as noise."""

    size: float = 0.1
    """To what the size of a modulation in one sweep is known [1]: it follows the fitted frequency; chosen."""

    phases: int = 64
    """Phases over which the likelihood of a modulation is averaged; chosen."""

    unlikely: float = -3.0
    """Log odds below which a modulation is in doubt: 20 to 1; chosen."""


LIMITS = SteadinessLimits()


def odds_of_one_size(fitting: Fitting, fitted: Fitted) -> list[float]:
    """Return by how much more probable one size is than noise of the same power, of each effect: log likelihoods.

    Infinity for effects without a phase of their own in each sweep, and where sweeps are too few to scatter.
    """
    found = [np.inf] * len(fitted.effects)
    built = [e.build() for e in fitted.effects]
    random = [i for i, effect in enumerate(built) if effect.fluctuates]
    c = fitting.comparison
    if not (random and c.recorded.scatters):
        return found
    waves = c.quadratures(built)[..., SCATTER.steady :]
    sums = np.zeros(len(random))
    for g, sweeps in enumerate(c.sweeps):
        terms = ramp_spectrum(sweeps.ramp)[..., SCATTER.steady :]
        std = np.sqrt(c.std['flutter'][g][:, SCATTER.steady :])
        way = (waves[:, :, g] / std).reshape(2 * len(random), -1)
        changes = ((terms - terms.mean(axis=0)) / std).reshape(len(terms), -1)
        inverse = np.linalg.pinv(way @ way.T, hermitian=True)
        sizes = (changes @ way.T @ inverse).reshape(len(terms), len(random), 2)
        # with the mean of the sweeps goes that of their phasors
        known = (LIMITS.size**2 + 0.5 / len(terms)) * np.eye(2)
        for number in range(len(random)):
            own = slice(2 * number, 2 * number + 2)
            sums[number] += _log_odds(sizes[:, number], inverse[own, own] + known).sum()
    for number, index in enumerate(random):
        found[index] = float(sums[number])
    return found


def _log_odds(sizes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return log likelihoods of a phasor of length 1 and any phase, less those of noise of the same power (n,).

    Args:
        sizes: measured cosine and sine (n, 2).
        covariance: of their errors (2, 2).
    """
    phase = 2.0 * np.pi * np.arange(LIMITS.phases) / LIMITS.phases
    phasors = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    each = _log_normal(sizes[:, None] - phasors, covariance)
    steady: np.ndarray = special.logsumexp(each, axis=1) - np.log(LIMITS.phases)
    return steady - _log_normal(sizes, covariance + 0.5 * np.eye(2))


def _log_normal(values: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return log densities of normal values (..., 2) about 0, less the constant that all share."""
    squares = np.einsum('...i,ij,...j->...', values, np.linalg.inv(covariance), values)
    result: np.ndarray = -0.5 * (squares + np.linalg.slogdet(covariance)[1])
    return result
