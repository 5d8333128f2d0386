"""The part of a sweep in which its ramp is straight: between dead time and fly-back."""

import dataclasses

import numpy as np

from ..limits import WINDOW
from ..material import Material


@dataclasses.dataclass(frozen=True)
class Window:
    """Samples of the ramp's generator and, within them, those in which the signal follows it."""

    begins: int  # first sample of the ramp, behind the kinks of the fly-back
    ends: int  # first sample behind the ramp
    first: int  # first sample that follows the ramp: behind a dead time
    last: int  # first sample behind those that are clear of kinks

    @property
    def length(self) -> int:
        """Samples between the kinks."""
        return self.ends - self.begins


def window(m: Material, period: float) -> Window:
    """Return where kinks and standstill bound the ramp; all samples of the nominal ramp where nothing does.

    Args:
        m: sweeps.
        period: of the strongest line [samples].
    """
    count = m.nominal_end
    signal = m.signal[:, :count]
    third = np.median(np.abs(np.diff(signal, 3, axis=1)), axis=0)
    bad = third > WINDOW.kink * max(float(np.median(third)), m.noise)
    crowd = np.convolve(bad, np.ones(5), 'same') >= WINDOW.together
    early, late = int(WINDOW.early * count), int(WINDOW.late * count)
    begins, ends = 0, count
    if crowd[:early].any():
        begins = int(np.flatnonzero(crowd[:early])[-1]) + 1
    if crowd[late:].any():
        ends = late + int(np.flatnonzero(crowd[late:])[0]) + 2
    first, last = begins, ends - WINDOW.clear - 1 if ends < count else count
    width = int(np.clip(period / 6.0, 6, count / 8))  # a crest moves four times as much as what is dead
    step = np.mean(np.abs(np.diff(signal, axis=1)) ** 2, axis=0)
    moving = np.convolve(step, np.ones(width) / width, 'same')
    usual, noise = float(np.median(moving[begins:ends])), 2.0 * m.noise**2 * (2.0 if m.iq else 1.0)
    level = WINDOW.dead * usual
    if usual > WINDOW.above * noise:  # noise alone is no movement either
        level = max(level, WINDOW.alone * noise)
    fine = np.convolve(step, np.ones(4) / 4.0, 'same')
    settled = begins + WINDOW.clear if begins else 0
    asleep = _still(step[settled:ends], width, level)
    if asleep:
        awake = np.flatnonzero(fine[settled + asleep :] > level * WINDOW.awake / WINDOW.dead)
        first = settled + asleep + (int(awake[0]) if len(awake) else 0)
    asleep = _still(step[begins:ends][::-1], width, level) if ends == count else 0
    if asleep:
        ends = last = ends - asleep - width
    return Window(begins, ends, first, max(last, first + 1))


def _still(step: np.ndarray, width: int, level: float) -> int:
    """Return how many of the first spans of `width` samples do not move."""
    if len(step) < 2 * width:
        return 0
    power = np.convolve(step, np.ones(width) / width, 'valid')
    return int(np.minimum.accumulate(power < level).sum())
