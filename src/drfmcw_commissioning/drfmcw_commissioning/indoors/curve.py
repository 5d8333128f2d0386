"""Frequency of a clock over the board temperature, from readings of a counter: constant, linear or AT-cut cubic."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from drfmcw_physics.settings import ConfigurationError

SHAPES = {'constant': 0, 'linear': 1, 'cubic': 3}
"""Order of the polynomial of each shape; an AT-cut crystal follows a cubic over its whole range."""

_ORDERS = range(4)
_FEWEST = {'constant': 1, 'linear': 3, 'cubic': 6}  # different temperatures: two more than a shape has parameters
_SAME = 0.5  # temperatures closer than this are one [K]
_POOR = 1e-3  # probability of residuals this large by chance, below which their scatter replaces the counter's
_GRID = 100  # temperatures at which the largest standard deviation is sought


@dataclasses.dataclass(frozen=True)
class Curve:
    """A clock's deviation from its nominal frequency: the sum of coefficients[i] (T - temperature)^i."""

    shape: str
    temperature: float  # at which the coefficients hold [degC]
    coefficients: np.ndarray  # (4,) [1, 1/K, 1/K^2, 1/K^3]
    covariance: np.ndarray  # (4, 4) of them, the counter's time base included
    low: float  # range of the readings [degC]
    high: float
    temperatures: np.ndarray  # (n,) of the readings [degC]
    residuals: np.ndarray  # (n,) reading minus curve [1]
    misfit: float  # chi-square per degree of freedom; NaN where no reading is left over
    widened: float  # factor on the counter's standard deviation that the residuals ask for, 1 where none

    def at(self, temperature: np.ndarray | float) -> np.ndarray:
        """Return the deviation at board temperatures [degC], their shape [1]."""
        return _powers(temperature, self.temperature) @ self.coefficients

    def std(self, temperature: np.ndarray | float) -> np.ndarray:
        """Return the standard deviation of `at` [1]."""
        powers = _powers(temperature, self.temperature)
        return np.sqrt(np.einsum('...i,ij,...j', powers, self.covariance, powers))

    def about(self, temperature: float) -> 'Curve':
        """Return the same curve with its coefficients given at another temperature [degC]."""
        shift = temperature - self.temperature
        matrix = np.array([[math.comb(j, i) * shift ** max(j - i, 0) for j in _ORDERS] for i in _ORDERS])
        return dataclasses.replace(
            self,
            temperature=temperature,
            coefficients=matrix @ self.coefficients,
            covariance=matrix @ self.covariance @ matrix.T,
        )

    @property
    def largest_std(self) -> float:
        """The standard deviation where it is largest within the range of the readings [1]."""
        return float(np.max(self.std(np.linspace(self.low, self.high, _GRID))))


def fit(
    deviations: Sequence[float] | np.ndarray,
    temperatures: Sequence[float] | np.ndarray,
    stds: Sequence[float] | np.ndarray,
    time_base_std: float,
    shape: str = 'auto',
    reference: float = 25.0,
    longest: str = 'cubic',
) -> Curve:
    """Fit a curve over the board temperature by weighted least squares.

    The shape is chosen by the Bayesian information criterion. Where the residuals are larger than the readings'
    standard deviations allow, these are widened until they agree.

    Args:
        deviations: of a clock, frequency / nominal - 1, or any other quantity, (n,) [1].
        temperatures: of the board, (n,) [degC].
        stds: of each reading by itself, (n,) [1].
        time_base_std: what the counter's time base may be off, the same in all readings [1].
        shape: one of SHAPES, or 'auto'.
        reference: temperature at which the coefficients are given, moved into the range of the readings [degC].
        longest: shape of the highest order that 'auto' may choose.

    Raises:
        ConfigurationError: no readings, or too few temperatures for the shape asked for.
    """
    y, t, sigma = (np.asarray(values, float) for values in (deviations, temperatures, stds))
    if not len(y):
        raise ConfigurationError('no reading of this clock')
    low, high = float(t.min()), float(t.max())
    different = 1 + int(np.count_nonzero(np.diff(np.sort(t)) > _SAME))
    if shape != 'auto' and different < _FEWEST[shape]:
        raise ConfigurationError(
            f'a {shape} curve needs readings at {_FEWEST[shape]} board temperatures at least, not {different}'
        )
    at = min(max(reference, low), high)
    shapes = [shape]
    if shape == 'auto':
        shapes = [name for name, order in SHAPES.items() if order <= SHAPES[longest] and different >= _FEWEST[name]]
    tried = [_solve(y, _powers(t, at)[:, : SHAPES[name] + 1], sigma) for name in shapes]
    chosen = min(range(len(tried)), key=lambda i: tried[i][2] + len(tried[i][0]) * math.log(len(y)))
    solution, covariance, chi_square = tried[chosen]
    spare = len(y) - len(solution)
    widened = 1.0
    if spare > 0 and stats.chi2.sf(chi_square, spare) < _POOR:
        widened = math.sqrt(chi_square / spare)
    coefficients, full = np.zeros(4), np.zeros((4, 4))
    coefficients[: len(solution)] = solution
    full[: len(solution), : len(solution)] = covariance * widened**2
    full[0, 0] += time_base_std**2
    return Curve(
        shape=shapes[chosen],
        temperature=at,
        coefficients=coefficients,
        covariance=full,
        low=low,
        high=high,
        temperatures=t,
        residuals=y - _powers(t, at) @ coefficients,
        misfit=chi_square / spare if spare > 0 else math.nan,
        widened=widened,
    )


def _powers(temperature: np.ndarray | float, reference: float) -> np.ndarray:
    """Return (T - reference)^0 ... 3, shape of `temperature` and (4,)."""
    return (np.asarray(temperature, float)[..., None] - reference) ** np.arange(4)


def _solve(y: np.ndarray, design: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return solution, covariance and chi-square of a weighted least-squares problem, columns scaled to one."""
    weighted = design / sigma[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    q, r = np.linalg.qr(weighted / scale)
    solution = np.linalg.solve(r, q.T @ (y / sigma)) / scale
    inverse = np.linalg.inv(r) / scale[:, None]
    residual = (y - design @ solution) / sigma
    return solution, inverse @ inverse.T, float(residual @ residual)
