"""Sines of any phase that sweeps hold beside their noise, as under a modulation of random phase.

In: cosine series of phases over the sweep, of several sweeps. Out: the frequencies of the sines, and the series without
them. Each sweep's own phase and frequency follow a part of a sine, which is taken out of it here too.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
import scipy.fft

from .limits import SINES


@dataclasses.dataclass(frozen=True)
class Waves:
    """Cosines and sines over K blocks of a sweep, as cosine series without what each sweep has of its own."""

    frequency: np.ndarray  # (F,) [1/block]
    terms: np.ndarray  # (F, 2, K)


@functools.lru_cache(maxsize=8)
def waves(count: int) -> Waves:
    """Return the waves over `count` blocks that are looked for: from one period in a sweep to the fastest."""
    frequency = np.fft.rfftfreq(SINES.fine * count)[1:]
    frequency = frequency[frequency * (count - 1) >= SINES.slowest]
    block = np.arange(count) - 0.5 * (count - 1)
    free = np.linalg.qr(np.stack([np.ones(count), block], axis=1))[0]
    found = np.exp(2j * np.pi * frequency[:, None] * block)
    found -= (found @ free) @ free.T
    terms = scipy.fft.dct(np.stack([found.real, found.imag], axis=1), norm='ortho', axis=-1)
    return Waves(frequency, terms)


def strongest(series: Sequence[np.ndarray], stds: Sequence[np.ndarray], first: int) -> tuple[int, float]:
    """Return the number of the wave that explains most of all series, and its mean gain over that by chance.

    The median over the sweeps counts, so that bursts do not; of the mean each series is a part of at most
    `SINES.shared`, so that a line beside the stations' own, which stands elsewhere at each distance, is none.

    Args:
        series: terms of sweeps less their mean, of each group and channel (n, K).
        stds: of one sweep's noise, of the same (K,).
        first: term from which on they count.
    """
    terms = waves(series[0].shape[-1]).terms[..., first:]
    gains = []
    for values, std in zip(series, stds, strict=True):
        wave = terms / std[first:]
        along = np.einsum('nk,fik->nfi', values[:, first:] / std[first:], wave)
        normal = np.einsum('fik,fjk->fij', wave, wave)
        normal += SINES.singular * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2)
        gains.append(np.median(np.einsum('nfi,fij,nfj->nf', along, np.linalg.inv(normal), along), axis=0))
    over_chance = np.array(gains) / (2.0 * math.log(2.0))
    best = int(np.argmax(over_chance.sum(axis=0)))
    return best, float(np.minimum(over_chance[:, best], SINES.shared).mean())


def several(series: Sequence[np.ndarray], stds: Sequence[np.ndarray], first: int, count: int) -> tuple[int, ...]:
    """Return the numbers of as many waves, the strongest first, each found without those before it.

    Arguments as for `strongest`.
    """
    found: list[int] = []
    for _ in range(count):
        found.append(strongest(series, stds, first)[0])
        series = [without(values, std, found[-1], first) for values, std in zip(series, stds, strict=True)]
    return tuple(found)


def without(values: np.ndarray, std: np.ndarray, number: int, first: int) -> np.ndarray:
    """Return terms of sweeps (n, K) without a wave, of the phase and size that it has in each; arguments as above.

    A part of the noise goes with it. What stays is raised by as much.
    """
    wave = waves(values.shape[-1]).terms[number]
    seen = wave[:, first:] / std[first:]
    inverse = np.linalg.pinv(seen)
    left: np.ndarray = values - (values[:, first:] / std[first:]) @ inverse @ wave
    gone = np.einsum('ki,ik->k', inverse, seen)
    left[:, first:] /= np.sqrt(np.maximum(1.0 - gone, SINES.left))
    return left


def without_strong(series: Sequence[np.ndarray], stds: Sequence[np.ndarray], first: int) -> list[np.ndarray]:
    """Return terms of each group's sweeps (n, K) less their mean, without the few sines that are beyond chance in all.

    Arguments as for `strongest`.
    """
    left = [values - values.mean(axis=0) for values in series]
    chance = 1.0 / (math.log(2.0) * math.sqrt(sum(map(len, series))))  # deviation of a median of exponential gains
    for _ in range(SINES.most):
        number, gain = strongest(left, stds, first)
        if gain < 1.0 + SINES.strong * chance:
            break
        left = [without(values, std, number, first) for values, std in zip(left, stds, strict=True)]
    return left
