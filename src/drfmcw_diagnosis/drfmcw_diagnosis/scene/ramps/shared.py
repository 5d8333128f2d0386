"""Several recordings of one radar: its oscillator's shape is learnt from all of them together.

In: what each recording's own line says. Out: the same with one shape over frequency for all, and delays on one scale.
A shape over frequency is the oscillator's, whatever span of it a setting sweeps and however long the cable is.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .ramp import Ramp
from .shape import Shape, learn, refit


def together(ramps: Sequence[Ramp]) -> list[Ramp]:
    """Return the ramps of several recordings with the shape that they share.

    Delays are on one scale: the mean rate is nominal over the frequencies that all recordings cover. Recordings whose
    bands do not overlap have nothing in common and stay as they are, as does a single one.
    """
    if len(ramps) < 2 or not overlapping(ramps):
        return list(ramps)
    lines = [line for r in ramps for line in r.lines]
    common = learn(lines, [psi for r in ramps for psi in r.shape.phase])
    result, at = [], 0
    for r in ramps:
        part = slice(at, at + len(r.lines))
        at += len(r.lines)
        shape = dataclasses.replace(
            common,
            delay=common.delay[part],
            delay_std=common.delay_std[part],
            phase=common.phase[part],
            scores=common.scores[part],
        )
        result.append(dataclasses.replace(r, shape=shape))
    return result


def overlapping(ramps: Sequence[Ramp]) -> tuple[float, float] | None:
    """Return the nominal frequencies that all ramps cover, from and to [Hz], None where there are none."""
    low = max(float(r.lines[0].frequency[0]) for r in ramps)
    high = min(float(r.lines[0].frequency[-1]) for r in ramps)
    return (low, high) if low < high else None


def carried_over(known: Shape, to: Ramp) -> Ramp:
    """Return a ramp with a shape that was learnt elsewhere: only delay and phase of its lines are its own.

    Samples at frequencies that the shape was not learnt at are left out.
    """
    knots = known.spline.t
    lines, delays, phases, scores = [], [], [], []
    whole = known.spline.antiderivative()
    for line, psi in zip(to.lines, to.shape.phase, strict=True):
        covered = (line.frequency >= knots[0]) & (line.frequency <= knots[-1])
        part = dataclasses.replace(
            line, signal=line.signal[covered], frequency=line.frequency[covered], sample=line.sample[covered]
        )
        turn = 2.0 * np.pi * (whole(part.frequency) - whole(part.frequency[0]))
        delay, offset = np.polyfit(turn, psi[covered], 1)
        delay, offset, found = refit(part, turn, float(delay), float(offset))
        lines.append(part)
        delays.append(delay)
        phases.append(delay * turn + offset)
        scores.append(found)
    count = len(lines)
    shape = Shape(known.spline, known.std, np.array(delays), np.full(count, np.nan), tuple(phases), tuple(scores))
    return dataclasses.replace(to, lines=tuple(lines), shape=shape)
