"""What has a known shape over the sweep and no name, as numbers of the ramp.

In: shapes over the blocks of the sweep. Out: vectors over the numbers' standard deviations, as templates of effects.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.fft

from drfmcw_sim.effects import Effect

from .comparison import Comparison
from .kinds import Kind
from .limits import MODEL


def ramp_of(c: Comparison) -> tuple[Kind, list[int]]:
    """Return the kind of the ramp's numbers, and which of its channels are phases."""
    kind = next(k for k in c.kinds if k.name == 'ramp')
    return kind, c.recorded.phases


def as_shown(shapes: np.ndarray, of_phase: bool) -> np.ndarray:
    """Return cosine series of shapes (M, K) without each sweep's own level, and of phases its frequency.

    So a kink of the phase shows a step of the frequency.
    """
    block = np.arange(shapes.shape[1])
    free = np.stack([np.ones(len(block)), block - block.mean()][: 2 if of_phase else 1])
    free /= np.linalg.norm(free, axis=1, keepdims=True)
    shown: np.ndarray = scipy.fft.dct(shapes - (shapes @ free.T) @ free, norm='ortho', axis=1)
    return shown


def over_sweep(c: Comparison, shape: np.ndarray, sizes: np.ndarray, channels: Mapping[int, float]) -> np.ndarray:
    """Return a shape over the sweep (K,) of a size in each group (G,), over the numbers' standard deviations (n,).

    Args:
        c: the recording and its model.
        shape: over the blocks of the sweep.
        sizes: of each group.
        channels: of the ramp that show it, and their signs.
    """
    kind, phases = ramp_of(c)
    result = np.zeros(len(c.residual))
    for channel, factor in channels.items():
        shown = as_shown(shape[None], channel in phases)
        result[c.rows(kind, channel)] = np.ravel(factor * sizes[:, None] * shown / c.std['ramp'][:, channel])
    return result


def fadings(c: Comparison, effects: Sequence[Effect]) -> np.ndarray:
    """Return what remains at the line of what fades after the begin of the signal (k, n).

    A real receiver may have settled before. At each distance any share of it may be there, at any phase of the line.

    Args:
        c: the recording and its model.
        effects: of which some may have settled, see `Effect.memory`.
    """
    found = [np.zeros((0, len(c.residual)))]
    for effect in effects:
        for number, station in enumerate(c.receivers):
            if effect.memory and effect.applies_to(station):
                found += [_fading_at_line(c, effect.memory, number, g) for g in range(len(c.members))]
    return np.concatenate(found)


def _fading_at_line(c: Comparison, memory: float, station: int, group: int) -> np.ndarray:
    """Return what fades with a time constant [s] in a station's amplitude, and in its phase, in one group (4, n)."""
    _, phases = ramp_of(c)
    turning = 1.0 / memory + 2j * np.pi * float(c.recorded.sweeps[group].line[:, station].mean())
    step = float(c.time[1] - c.time[0])
    begin = np.maximum(c.time - 0.5 * step, 0.0)
    shape = np.exp(-turning * begin) * -np.expm1(-turning * step) / (turning * step)  # mean over each block
    of_phase = {phases[0]: 1.0} | {channel: 1.0 - 2.0 * station for channel in phases[1:]}
    size = np.where(np.arange(len(c.members)) == group, MODEL.unsettled, 0.0)
    shapes = (shape.real, shape.imag)
    return np.array([over_sweep(c, s, size, channels) for channels in ({station: 1.0}, of_phase) for s in shapes])
