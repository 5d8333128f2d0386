"""The way of the strongest line that moves, over the sweeps."""

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


def track(m: Material, mean: np.ndarray) -> Track | None:
    """Return the way of what differs from the mean sweep (N,), None where no line stands out most of the time."""
    count, length = m.signal.shape
    span = max(TRACK.together, count // TRACK.most)
    padded = TRACK.padding * length
    window = np.hanning(length + 2)[1:-1]
    starts = np.arange(0, count - span + 1, span)
    paths = np.full(len(starts), np.nan)
    for number, first in enumerate(starts):
        rest = (m.signal[first : first + span] - mean) * window
        power = np.mean(np.abs(np.fft.fft(rest, padded, axis=1)) ** 2, axis=0)[: padded // 2]
        power[: TRACK.padding * TRACK.cells] = 0.0
        at = int(np.argmax(power))
        if power[at] > 10.0 ** (TRACK.above / 10.0) * np.median(power):
            paths[number] = at / padded * m.rate / abs(m.bandwidth) * m.duration * SPEED_OF_LIGHT
    if np.isfinite(paths).mean() < TRACK.mostly:
        return None
    return Track(starts + span / 2.0, paths)
