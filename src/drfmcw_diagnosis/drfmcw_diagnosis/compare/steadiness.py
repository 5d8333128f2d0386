"""Whether what changes from sweep to sweep is a modulation of one size, or noise, and which station's it is.

In: effects, some of random phase, and the sweeps. Out: the odds of each such effect. A modulation has one
size in all sweeps, noise of the same power has one that scatters. The noise near a line is often steeper than any
oscillator's model: its power in a few terms of the ramp alone would pass for a slow modulation. Both lines hold a
modulation, the other station's one path delay later: its power hardly shows that, its phase in each sweep does. An
oscillator's modulation shows in the phases alone. What a second path adds whose length swings shows in the amplitudes
as well.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import special

from drfmcw_sim.effects import Effect

from ..features.extractor import ramp_spectrum
from .comparison import Comparison
from .limits import SCATTER


@dataclasses.dataclass(frozen=True)
class SteadinessLimits:
    """When a modulation counts as noise."""

    size: float = 0.1
    """To what the size of a modulation in one sweep is known [1]: it follows the fitted frequency; chosen."""

    phases: int = 64
    """Phases over which the likelihood of a modulation is averaged; chosen."""

    unlikely: float = -3.0
    """Log odds below which a modulation is in doubt: 20 to 1; chosen."""

    any_size: tuple[float, ...] = (0.5, 0.6, 0.7, 0.84, 1.0, 1.2, 1.4, 1.7, 2.0)
    """Over the size that was fitted, sizes that it may have while other effects are missing [1]; chosen."""

    of_amplitude: float = 0.1
    """Power of the amplitudes' modulation at the same rate over that of the phases [1], at most; chosen: a second path
    makes both alike."""

    shown: float = 5.0
    """Standard deviations from which on such a power is there [1]; chosen."""


LIMITS = SteadinessLimits()


def odds_of_one_size(comparison: Comparison, effects: Sequence[Effect], sizes: Sequence[float] = (1.0,)) -> list[float]:
    """Return by how much more probable one size is than noise of the same power, of each effect: log likelihoods.

    Infinity for effects without a phase of their own in each sweep, and where sweeps are too few to scatter.

    Args:
        comparison: of the recording.
        effects: that act together.
        sizes: over that of the effects [1]; the likeliest one counts, of either.
    """
    found = [np.inf] * len(effects)
    random = _of_random_phase(comparison, effects)
    sums = np.zeros((len(random), len(sizes), 2))
    for changes, waves in _sweeps(comparison, effects, random):
        inverse = np.linalg.pinv(waves @ waves.T, hermitian=True)
        phasors = (changes @ waves.T @ inverse).reshape(len(changes), len(random), 2)
        # with the mean of the sweeps goes that of their phasors
        known = (LIMITS.size**2 + 0.5 / len(changes)) * np.eye(2)
        for number, (index, size) in itertools.product(range(len(random)), enumerate(sizes)):
            own = slice(2 * number, 2 * number + 2)
            # over the size, as errors are
            each = _log_likelihoods(phasors[:, number] / size, inverse[own, own] / size**2 + known)
            sums[number, index] += [x.sum() - 2.0 * len(x) * np.log(size) for x in each]
    for number, index in enumerate(random):
        steady, noise = sums[number].max(axis=0)
        found[index] = float(steady - noise)
    return found


def gains_over_other_station(comparison: Comparison, effects: Sequence[Effect]) -> list[float]:
    """Return by how much more of the sweeps each effect explains than it would at the other station: squared sigma.

    0 for effects without a phase of their own in each sweep, where no other station is, where it has the same effect,
    and where sweeps are too few to scatter.
    """
    found = [0.0] * len(effects)
    random = _of_random_phase(comparison, effects)
    here = _explained(comparison, effects, random)
    for index in random:
        station = other_station(comparison, effects[index].station)
        if not station:
            continue
        elsewhere = dataclasses.replace(effects[index], station=station)
        if not any(type(e) is type(elsewhere) and e.station == station for e in effects):
            moved = [*effects[:index], elsewhere, *effects[index + 1 :]]
            found[index] = here - _explained(comparison, moved, random)
    return found


def amplitude_modulations(comparison: Comparison, effects: Sequence[Effect]) -> list[float]:
    """Return the power with which the lines' amplitudes are modulated at each effect's rate, over that of the phases.

    Beyond what the effect itself does to them. 0 where it is none beyond chance, for effects without a phase of their
    own in each sweep, and where sweeps are too few to scatter.
    """
    found = [0.0] * len(effects)
    random = _of_random_phase(comparison, effects)
    if not random:
        return found
    waves, phases = comparison.quadratures(effects)[..., SCATTER.steady :], comparison.recorded.phases
    amplitudes = [i for i in range(waves.shape[3]) if i not in phases]
    sums = np.zeros((len(random), 3))  # power, weight and what is expected, weighted
    for g, terms, std in _terms(comparison):
        for number, channel in itertools.product(range(len(random)), amplitudes):
            own = waves[number, :, g]
            wave = max((own[:, i] / std[channel] for i in phases), key=np.linalg.norm)
            inverse = np.linalg.pinv(wave @ wave.T, hermitian=True)
            phasors = (terms[:, channel] / std[channel]) @ wave.T @ inverse  # 1 where as large as the phases' wave
            expected = (own[:, channel] / std[channel]) @ wave.T @ inverse
            chance = max(float(np.trace(inverse)), np.finfo(float).tiny)
            power = float(np.mean(np.sum(phasors**2, axis=1))) - chance * (1.0 - 1.0 / len(terms))
            weight = len(terms) / chance**2
            sums[number] += weight * np.array([power, 1.0, 0.5 * float(np.sum(expected**2))])
    for number, index in enumerate(random):
        power, weight, expected = sums[number]
        if power > LIMITS.shown * np.sqrt(weight) and weight > 0.0:
            found[index] = float(power - expected) / float(weight)
    return found


def other_station(comparison: Comparison, station: str) -> str:
    """Return the other one of two stations, '' where there is none."""
    others = [name for name in comparison.data.stations if name != station]
    return others[0] if len(others) == 1 else ''


def _of_random_phase(comparison: Comparison, effects: Sequence[Effect]) -> list[int]:
    """Return the numbers of effects with a phase of their own in each sweep: none where sweeps are too few."""
    return [i for i, e in enumerate(effects) if e.fluctuates and comparison.recorded.scatters]


def _explained(comparison: Comparison, effects: Sequence[Effect], random: Sequence[int]) -> float:
    """Return the power that effects of random phase explain of all sweeps, in each with the phase and size it has."""
    total = 0.0
    for changes, waves in _sweeps(comparison, effects, random):
        along = changes @ waves.T
        total += float(np.sum(along @ np.linalg.pinv(waves @ waves.T, hermitian=True) * along))
    return total


def _sweeps(
    comparison: Comparison, effects: Sequence[Effect], random: Sequence[int]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield whitened terms of each group's sweeps less their mean (n, V), and what random phases add (2 R, V).

    Of all channels and sweeps without bursts; cosine and sine of each effect. Nothing without such an effect.
    """
    if not random:
        return
    waves = comparison.quadratures(effects)[..., SCATTER.steady :]
    for g, terms, std in _terms(comparison):
        yield (terms / std).reshape(len(terms), -1), (waves[:, :, g] / std).reshape(2 * len(random), -1)


def _terms(comparison: Comparison) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Yield each group with the terms of its sweeps without bursts, less their mean (n, 2 S, K), and their noise."""
    for g, (sweeps, calm) in enumerate(zip(comparison.sweeps, comparison.recorded.calm, strict=True)):
        terms = ramp_spectrum(sweeps.ramp[calm])[..., SCATTER.steady :]
        std = np.sqrt(comparison.std['flutter'][g][:, SCATTER.steady :])
        yield g, terms - terms.mean(axis=0), std


def _log_likelihoods(phasors: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return log likelihoods of a phasor of length 1 and any phase, and of noise of the same power (n,) each.

    Args:
        phasors: measured cosine and sine (n, 2).
        covariance: of their errors (2, 2).
    """
    phase = 2.0 * np.pi * np.arange(LIMITS.phases) / LIMITS.phases
    one = np.stack([np.cos(phase), np.sin(phase)], axis=1)
    each = _log_normal(phasors[:, None] - one, covariance)
    steady: np.ndarray = special.logsumexp(each, axis=1) - np.log(LIMITS.phases)
    return steady, _log_normal(phasors, covariance + 0.5 * np.eye(2))


def _log_normal(values: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return log densities of normal values (..., 2) about 0, less the constant that all share."""
    squares = np.einsum('...i,ij,...j->...', values, np.linalg.inv(covariance), values)
    result: np.ndarray = -0.5 * (squares + np.linalg.slogdet(covariance)[1])
    return result
