"""Mean and variance of values that come in parts."""

import dataclasses
import math

import numpy as np


@dataclasses.dataclass(frozen=True)
class Moments:
    """Number, mean and sum of squared deviations from it, of any number of values; merged without loss of precision.

    T. F. Chan, G. H. Golub, R. J. LeVeque, "Updating formulae and a pairwise algorithm for computing sample
    variances", 1979. Merging rounds, so merged results are equal to the bit only in the same order.
    """

    n: int = 0
    mean: float = 0.0
    squares: float = 0.0

    @classmethod
    def of(cls, values: np.ndarray) -> 'Moments':
        """Return those of an array."""
        if len(values) == 0:
            return cls()
        mean = float(np.mean(values))
        return cls(len(values), mean, float(np.sum((values - mean) ** 2)))

    def merge(self, other: 'Moments') -> 'Moments':
        """Return those of both sets of values together."""
        n = self.n + other.n
        if n == 0:
            return self
        step = other.mean - self.mean
        return Moments(
            n, self.mean + step * other.n / n, self.squares + other.squares + step * step * self.n * other.n / n
        )

    @property
    def std(self) -> float:
        """Sample standard deviation; NaN of fewer than two values."""
        return math.sqrt(self.squares / (self.n - 1)) if self.n > 1 else math.nan

    @property
    def standard_error(self) -> float:
        """Standard deviation of the mean; NaN of fewer than two values."""
        return self.std / math.sqrt(self.n) if self.n else math.nan
