"""Linear algebra of parameters whose units differ by many orders of magnitude."""

import numpy as np


def scaled_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a normal matrix (P, P), whatever the units of its parameters.

    Directions that the data do not determine are zero in it.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse: np.ndarray = np.linalg.pinv(matrix * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return inverse


def sizes_of(shapes: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return the sizes (k,) with which shapes (k, n), of which some may be alike, fit a rest (n,) best."""
    sizes: np.ndarray = np.linalg.lstsq(shapes @ shapes.T, shapes @ rest, rcond=1e-9)[0]
    return sizes


def gain_of(shapes: np.ndarray, rest: np.ndarray) -> float:
    """Return by how much shapes (k, n) of the best sizes lower the sum of squares of a rest (n,)."""
    return float(sizes_of(shapes, rest) @ (shapes @ rest))
