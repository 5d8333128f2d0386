"""Which recordings of stations that hear themselves are of one oscillator, and what its shape says of each.

In: each recording's own ramp. Out: the ramp with the shape over frequency that it shares, and how well the shape that
the others alone teach predicts it.
"""

import collections
import contextlib
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from ..recording.dataset import read_dataset
from ..scene.evidence import convention
from ..scene.judge import own_ramp
from ..scene.limits import JUDGE
from ..scene.ramps.ramp import Ramp
from ..scene.ramps.shared import carried_over, overlapping, together


@dataclasses.dataclass(frozen=True)
class OneShape:
    """What the shape of an oscillator says of one of its recordings; misfits of held-out blocks, rms [LSB]."""

    recordings: tuple[str, ...]  # that share the shape, this one among them; this one alone where none does
    station: str
    rate: float  # rms of the relative rate about its mean over the band [1]
    band: tuple[float, float]  # that the recording's own line covers [Hz]
    delay: float  # on the scale that all have in common [s]
    delay_std: float  # of that scale [s]
    straight: float  # misfit of a straight ramp
    own: float  # of a shape of its own
    shared: float  # of the one shape
    predicted: float  # of the shape that the others alone teach; NaN where none shares it
    predicted_delay: float  # by that shape, on the same scale [s]
    noise: float  # of the receiver [LSB]


@dataclasses.dataclass(frozen=True)
class Known:
    """A recording's ramp, and what is said of it."""

    ramp: Ramp | None  # with the shape that it shares; None where it shares none
    shape: OneShape


@functools.lru_cache(maxsize=1)  # once in each worker, for all recordings that it diagnoses
def known_ramps(paths: tuple[str, ...], pair: str | None) -> Mapping[str, Known]:
    """Return the bent ramps of the recordings whose stations hear themselves, by path."""
    alone: dict[tuple[str, ...], dict[str, Ramp]] = collections.defaultdict(dict)
    for path in paths:
        with contextlib.suppress(ConfigurationError):  # has a line of its own in the table
            data = read_dataset(path, pair)
            found = own_ramp(data) if data.topology.hears_itself else None
            if found is not None and found.bends:
                alone[data.stations][path] = found
    return {path: known for ramps in alone.values() for path, known in _known(ramps).items()}


def _known(ramps: Mapping[str, Ramp]) -> dict[str, Known]:
    """Return what is known of the ramps of one station, radar by radar."""
    left, result = dict(ramps), {}
    while left:
        group = one_oscillator(left)
        if not group:
            break
        for path, ramp in group.items():
            result[path] = Known(ramp, _said(left[path], path, group, [left[p] for p in group if p != path]))
        left = {p: r for p, r in left.items() if p not in group}
    return result | {p: Known(None, _said(r, p, {p: r}, [])) for p, r in left.items()}


def one_oscillator(ramps: Mapping[str, Ramp]) -> dict[str, Ramp]:
    """Return the ramps that one shape describes, with it; {} where no two are alike.

    What fits it worst, beside a shape of its own, is left out until all fit.
    """
    group = dict(ramps)
    while len(group) > 1 and overlapping(list(group.values())):
        shared = dict(zip(group, together(list(group.values())), strict=True))
        worse = {path: shared[path].held_out / max(own.held_out, 1e-12) for path, own in group.items()}
        worst = max(worse, key=lambda path: worse[path])
        if worse[worst] < JUDGE.alike:
            return shared
        del group[worst]
    return {}


def _said(own: Ramp, path: str, group: Mapping[str, Ramp], others: Sequence[Ramp]) -> OneShape:
    """Return what is said of a recording: its ramp alone, those of its group with one shape, and the others alone."""
    shared = group[path]
    delay = float(shared.shape.delay[0])
    predicted = predicted_delay = math.nan
    if others:
        learnt = together(others)
        carried = carried_over(learnt[0].shape, own)
        predicted = carried.held_out
        scales = [  # of the delays of the others with the one shape, over those with theirs alone
            r.shape.delay[0] / alone.shape.delay[0]
            for r, alone in zip((r for p, r in group.items() if p != path), learnt, strict=True)
        ]
        predicted_delay = float(carried.shape.delay[0] * np.mean(scales))
    return OneShape(
        recordings=tuple(group),
        station=own.material.station,
        rate=float(np.std(shared.rate())),
        band=(float(own.lines[0].frequency[0]), float(own.lines[0].frequency[-1])),
        delay=delay,
        delay_std=convention(shared) * delay,
        straight=float(np.sqrt(np.mean([s.held_out**2 for s in own.straight]))),
        own=own.held_out,
        shared=shared.held_out,
        predicted=predicted,
        predicted_delay=predicted_delay,
        noise=own.white,
    )
