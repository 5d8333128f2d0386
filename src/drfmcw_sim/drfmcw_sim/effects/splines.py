"""The rate of a ramp as a spline over its elapsed share, and the phase that its error adds."""

import functools

import numpy as np
import scipy

DEGREE = 3


@functools.lru_cache(maxsize=32)
def excess(rates: tuple[float, ...]) -> 'scipy.interpolate.PPoly':
    """Return the second integral of the relative rate, over its mean and less 1, over the elapsed share of the ramp.

    As polynomials, which take an eighth of the time of B-splines at the samples of a sweep.

    Args:
        rates: coefficients of the spline; its knots are uniform and clamped at the ramp's ends.
    """
    knots = _knots(len(rates))
    mean = float(scipy.interpolate.BSpline(knots, np.array(rates), DEGREE).integrate(0.0, 1.0))
    error = scipy.interpolate.BSpline(knots, np.array(rates) / mean - 1.0, DEGREE)
    return scipy.interpolate.PPoly.from_spline(error.antiderivative(2))


def coefficients(turns: np.ndarray, count: int) -> list[float]:
    """Return coefficients whose `excess` fits values best, apart from a straight line.

    Args:
        turns: values at equal steps from the ramp's start to its end (n,).
        count: of coefficients.
    """
    x = np.linspace(0.0, 1.0, len(turns))
    splines = [scipy.interpolate.BSpline(_knots(count), unit, DEGREE) for unit in np.eye(count)]
    means = np.array([spline.integrate(0.0, 1.0) for spline in splines])
    bends = np.array([spline.antiderivative(2)(x) for spline in splines]) - 0.5 * np.outer(means, x**2)
    errors = np.linalg.lstsq(np.vstack([bends, np.ones_like(x), x]).T, turns, rcond=1e-10)[0][:count]
    rates: list[float] = (1.0 + errors - errors @ means).tolist()
    return rates


def _knots(count: int) -> np.ndarray:
    """Return the knots of a spline of so many coefficients."""
    return np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, count - DEGREE + 1), np.ones(DEGREE)])
