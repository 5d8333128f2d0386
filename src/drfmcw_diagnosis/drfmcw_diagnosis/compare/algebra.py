"""Linear algebra of parameters whose units differ by many orders of magnitude."""

import numpy as np


def scaled_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse of a normal matrix (P, P), whatever the units of its parameters.

    Directions that the data do not determine are zero in it.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse: np.ndarray = np.linalg.pinv(matrix * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return inverse
