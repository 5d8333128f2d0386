"""The way of the strongest line that moves, over the sweeps.

What stands still is the same some sweeps later, so it is subtracted. A movement of a fraction of a wavelength between
both is enough, and how far they should be apart for it depends on the target. Of the lines in the spectra that are left
those are taken whose sum of levels is largest, less what their path moves (dynamic programming).
"""

import dataclasses

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT

from .limits import TRACK
from .material import Material


@dataclasses.dataclass(frozen=True)
class Track:
    """A line that differs from sweep to sweep, some sweeps at a time."""

    sweep: np.ndarray  # (n,) middle of the sweeps looked at
    path: np.ndarray  # (n,) length of the whole path in air, NaN where no line stands out [m]


def track(m: Material) -> Track | None:
    """Return the way of the strongest line that moves, None where no line stands out most of the time."""
    count = len(m.signal)
    span = max(TRACK.together, count // TRACK.most)
    tried = [_followed(m, apart, span) for apart in TRACK.apart if apart <= count - span]
    clearest = max((level for level, _ in tried), default=0.0)
    for level, found in tried:
        if level > clearest - TRACK.clear and np.isfinite(found.path).mean() >= TRACK.mostly:
            return found
    return None


def _followed(m: Material, apart: int, span: int) -> tuple[float, Track]:
    """Return the median level [dB] over that of all cells, and the way, of what differs from `apart` sweeps later."""
    length = m.signal.shape[1]
    padded = TRACK.padding * length
    window = np.hanning(length + 2)[1:-1]
    rest = m.signal[apart:] - m.signal[:-apart]
    starts = np.arange(0, len(rest) - span + 1, span)
    level = np.empty((len(starts), padded // 2 - TRACK.padding * TRACK.cells))
    floors = np.empty(len(starts))
    for number, first in enumerate(starts):
        some = rest[first : first + span]
        some = (some - some.mean(axis=1, keepdims=True)) * window
        power = np.mean(np.abs(np.fft.fft(some, padded, axis=1)) ** 2, axis=0)
        if m.iq and m.bandwidth < 0.0:
            power = np.roll(power[::-1], 1)  # a falling ramp has its echoes at negative frequencies
        power = power[: padded // 2]
        floor = max(float(np.median(power)), 1e-30)
        level[number] = 10.0 * np.log10(np.maximum(power[TRACK.padding * TRACK.cells :], 1e-3 * floor) / floor)
        floors[number] = 10.0 * np.log10(floor)
    at = _way(np.where(_crest(level), level, 0.0))
    shown = level[np.arange(len(at)), at]
    cells = (at + TRACK.padding * TRACK.cells) / padded
    paths = cells * m.rate / abs(m.bandwidth) * m.duration * SPEED_OF_LIGHT
    middle = starts + (span + apart) / 2.0
    power = shown + floors  # a target that stops leaves what flickers elsewhere
    there = (shown > TRACK.above) & (power > np.median(power) - TRACK.fainter)
    return float(np.median(shown)), Track(middle, np.where(there, paths, np.nan))


def _crest(level: np.ndarray) -> np.ndarray:
    """Return where levels (n, cells) exceed those beside them: the skirt of 0 Hz is no line."""
    crest = np.zeros(level.shape, bool)
    crest[:, 1:-1] = (level[:, 1:-1] >= level[:, :-2]) & (level[:, 1:-1] > level[:, 2:])
    return crest


def _way(level: np.ndarray) -> np.ndarray:
    """Return the cell of each row (n,) whose levels (n, cells), less `TRACK.turn` for each cell moved, sum to most."""
    count, cells = level.shape
    cost = TRACK.turn * np.arange(cells)
    total, came = level[0], np.zeros((count, cells), int)
    for number in range(1, count):
        below, above = total + cost, (total - cost)[::-1]
        before, behind = _last_largest(below), cells - 1 - _last_largest(above)[::-1]
        rising = below[before] - cost >= total[behind] - (cost[behind] - cost)
        came[number] = np.where(rising, before, behind)
        total = level[number] + np.where(rising, below[before] - cost, total[behind] - (cost[behind] - cost))
    at = np.empty(count, int)
    at[-1] = int(np.argmax(total))
    for number in range(count - 1, 0, -1):
        at[number - 1] = came[number, at[number]]
    return at


def _last_largest(values: np.ndarray) -> np.ndarray:
    """Return where the largest value up to each one stands."""
    largest = np.maximum.accumulate(values)
    return np.maximum.accumulate(np.where(values == largest, np.arange(len(values)), 0))
