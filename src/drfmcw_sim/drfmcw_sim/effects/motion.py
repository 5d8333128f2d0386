"""How motion of the crane and the slant between the antennas change the paths."""

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT

from ..measurements import Measurements


def slowness(m: Measurements) -> np.ndarray:
    """Return the delay per length of air [n] [s/m]."""
    return np.asarray(m.refractive_index) / SPEED_OF_LIGHT


def move(
    m: Measurements,
    distance: np.ndarray | float = 0.0,
    velocity: np.ndarray | float = 0.0,
    acceleration: np.ndarray | float = 0.0,
) -> None:
    """Add to the distance [m], velocity [m/s] and acceleration [m/s^2] at station 1's sweep start, on every path."""
    per_length = slowness(m)
    m.range = m.range + distance
    m.velocity = m.velocity + velocity
    for path in m.paths:
        path.delay = path.delay + distance * per_length
        path.rate = path.rate + velocity * per_length
        path.acceleration = path.acceleration + acceleration * per_length


def hypotenuse_excess(m: Measurements, square: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return by how much sqrt(R^2 + square) exceeds R: length [m], velocity [m/s] and acceleration [m/s^2].

    Args:
        m: measurements with range R.
        square: of the other side [m^2].
    """
    length = np.sqrt(m.range**2 + square)
    safe = np.where(length > 0.0, length, 1.0)
    cosine = np.where(length > 0.0, m.range / safe, 1.0)
    acceleration = m.paths[0].acceleration / slowness(m)
    excess = square / np.where(length > 0.0, length + m.range, 1.0)
    return excess, m.velocity * (cosine - 1.0), acceleration * (cosine - 1.0) + m.velocity**2 * square / safe**3
