"""Which sweeps are taken together: consecutive ones under the same conditions, and how fast the crane drives there."""

import numpy as np

from .limits import GROUPS


def groups(setting: np.ndarray, time: np.ndarray, distance: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Return the number of each sweep's group, (n,); arguments (n,), `std` of the distances."""
    step = np.diff(time)
    pause = max(GROUPS.pause, 5.0 * float(np.median(step))) if len(step) else GROUPS.pause
    noise = _noise(distance, std)
    still = GROUPS.still + GROUPS.peak * noise
    new = (np.diff(setting) != 0) | (step > pause) | (np.abs(np.diff(distance)) > GROUPS.fastest * step + still)
    group = np.empty(len(time), int)
    number = 0
    for run in np.split(np.arange(len(time)), np.flatnonzero(new) + 1):
        parts = min(int((time[run[-1]] - time[run[0]]) / GROUPS.steady) + 1, max(len(run) // GROUPS.most, 1))
        drives = np.ptp(distance[run]) > still
        if drives:
            parts = max(parts, -(-len(run) // GROUPS.most))
        for part in np.array_split(run, parts):
            for piece in _steady(part, time, distance, noise) if drives else [part]:
                group[piece] = number
                number += 1
    return group


def _steady(rows: np.ndarray, time: np.ndarray, distance: np.ndarray, noise: float) -> list[np.ndarray]:
    """Return the rows in pieces, halved until the speed is steady in each as far as the `noise` [m] of distances shows.

    Otherwise one velocity would not hold for a whole group of a crane that accelerates.
    """
    if len(rows) < 2 * GROUPS.smallest:
        return [rows]
    bend = np.polynomial.legendre.Legendre.fit(time[rows], distance[rows], 2).coef[2]
    # the coefficient's variance is that of the mean times 5; its polynomial reaches 1 at the ends
    if abs(bend) <= GROUPS.bent * noise * np.sqrt(5.0 / len(rows)):
        return [rows]
    return [piece for half in np.array_split(rows, 2) for piece in _steady(half, time, distance, noise)]


def _noise(distance: np.ndarray, std: np.ndarray) -> float:
    """Return the noise of distances, as stated or as they scatter from sweep to sweep if that is more [m]."""
    stated = float(np.median(std[np.isfinite(std)])) if np.isfinite(std).any() else 0.0
    if len(distance) < 3:
        return stated
    return max(stated, noise_by_bends(distance))


def noise_by_bends(values: np.ndarray) -> float:
    """Return the standard deviation of noise on values that change steadily (n,), at least 3, by how they bend.

    A steady change has no second differences; those of noise have sqrt(6) times its standard deviation.
    """
    return GROUPS.mad_to_std * float(np.median(np.abs(np.diff(values, 2)))) / np.sqrt(6.0)


def slopes(group: np.ndarray, time: np.ndarray, distance: np.ndarray, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the slope of distances over each group and its standard deviation, (n,) [m/s].

    Arguments (n,), NaN where a distance or its standard deviation is unknown; fewer than three distances give NaN.
    """
    slope, error = np.full((2, len(group)), np.nan)
    for number in range(group[-1] + 1):
        rows = np.flatnonzero((group == number) & np.isfinite(distance))
        t = time[rows] - np.mean(time[rows]) if len(rows) else rows
        if len(rows) < 3 or not (spread := np.sum(t * t)):
            continue
        value = np.sum(t * distance[rows]) / spread
        residual = distance[rows] - np.mean(distance[rows]) - value * t
        # where too small a standard deviation is stated, or none, their own scatter counts
        noise = np.fmax(np.sqrt(np.mean(std[rows] ** 2)), np.sqrt(np.sum(residual**2) / (len(rows) - 2)))
        slope[group == number], error[group == number] = value, noise / np.sqrt(spread)
    return slope, error
