"""Residuals made white: what the forward models may be off by counts as noise, single numbers and common errors alike.

A model's error is rarely independent from number to number: a floor that is 0.04 dB too low is so in every band. Such
an error is a direction in the space of all numbers with a prior standard deviation. It is marginalised: with N the
directions times their priors (k, n), the covariance of the whitened residuals is 1 + N^T N, and
(1 + N^T N)^(-1/2) = 1 - U (1 - (1 + L)^(-1/2)) U^T with the eigenvectors U and eigenvalues L of N^T N.

Numbers whose noise is correlated in pairs become independent first, by Cholesky's factor: of the second of a pair
remains what the first does not say of it.
"""

import numpy as np

from ...compare.groups import Correlated
from .limits import FIT


class Whitening:
    """Turns residuals over their measured standard deviations into independent numbers of variance one."""

    def __init__(self, weight: np.ndarray, directions: np.ndarray, correlated: Correlated) -> None:
        """Combine both kinds of model error.

        Args:
            weight: one over the standard deviation of each number, model errors of its own included (n,).
            directions: common errors, each times its prior standard deviation (k, n).
            correlated: numbers whose noise is correlated.
        """
        self.weight, self._directions, self._correlated = weight, directions, correlated
        # a model error of its own is no part of what a pair has in common
        self._shared = correlated.share * weight[correlated.first] * weight[correlated.second]
        self._apart = np.sqrt(1.0 - self._shared**2)
        self._vectors = np.zeros((0, len(weight)))
        self._shrunk = np.zeros(0)
        if len(self._directions):
            common = self._uncorrelated(self._directions * weight)
            values, vectors = np.linalg.eigh(common @ common.T)
            used = values > FIT.unfelt
            self._vectors = (vectors[:, used] / np.sqrt(values[used])).T @ common
            self._shrunk = 1.0 - 1.0 / np.sqrt(1.0 + values[used])

    def beside(self, directions: np.ndarray) -> 'Whitening':
        """Return the same with further common errors, each times its prior standard deviation (k, n)."""
        return Whitening(self.weight, np.concatenate([self._directions, directions]), self._correlated)

    def reweighted(self, weight: np.ndarray) -> 'Whitening':
        """Return the same with another weight of each number (n,)."""
        return Whitening(weight, self._directions, self._correlated)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return whitened values (..., n)."""
        return self._mixed(self._uncorrelated(values * self.weight))

    def transposed(self, values: np.ndarray) -> np.ndarray:
        """Return the transposed operation on values (..., n): `whitening(a) @ b == a @ whitening.transposed(b)`."""
        mixed = self._mixed(values)
        if len(self._shared):
            first, second = self._correlated.first, self._correlated.second
            mixed = mixed.copy()
            of_second = mixed[..., second] / self._apart
            mixed[..., first] -= self._shared * of_second
            mixed[..., second] = of_second
        return mixed * self.weight

    def _uncorrelated(self, values: np.ndarray) -> np.ndarray:
        """Return values (..., n), times the weights, with the second of each pair beside the first."""
        if not len(self._shared):
            return values
        first, second = self._correlated.first, self._correlated.second
        result = values.copy()
        result[..., second] = (values[..., second] - self._shared * values[..., first]) / self._apart
        return result

    def _mixed(self, values: np.ndarray) -> np.ndarray:
        if not len(self._shrunk):
            return values
        return values - ((values @ self._vectors.T) * self._shrunk) @ self._vectors
