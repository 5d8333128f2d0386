"""What a model leaves of samples that were held out, over what noise leaves there, and the chance of that."""

import dataclasses
import math

import numpy as np
from scipy import stats
from scipy.special import gammaincc

from ..noise import Noise
from .tracks import Solved, Sweeps


@dataclasses.dataclass(frozen=True)
class Misfit:
    """Misfit of samples."""

    per_freedom: float  # sum of squares over the noise's, per degree of freedom [1]
    freedom: float  # degrees of freedom, fewer than numbers where the noise is coloured
    probability: float  # of a misfit this large by chance, over the tests of `tests`
    tests: tuple[tuple[str, float], ...]  # what was tested, and the chance of each


def of_sweeps(
    s: Sweeps, left: np.ndarray, parameters: float, floor: Noise, learnt: int = 0, own: bool = False
) -> Misfit:
    """Return the misfit of whole sweeps, whose amplitudes were fitted with so many parameters per sweep.

    Tested are the mean square, the mean square of what is the same in all sweeps, and the strongest frequency.

    Args:
        s: sweeps.
        left: what the model leaves (n, N) [LSB].
        parameters: real numbers fitted in each sweep.
        floor: noise.
        learnt: number of sweeps whose mean was taken away from these.
        own: these are those sweeps.
    """
    count, length = left.shape
    parts = 2.0 if s.iq else 1.0
    of_mean = 1.0 / learnt if learnt else 0.0  # variance of that mean over the noise's
    numbers = max((parts * float(s.used.sum()) - parameters * count) * (1.0 - of_mean if own else 1.0), 1.0)
    wider = 1.0 if own else 1.0 + of_mean  # variance of what is left over the noise's
    each = floor.mean / parts * wider
    ratio = float(np.sum(np.abs(left[s.used]) ** 2)) / each / numbers
    freedom = numbers * floor.evenness
    tests = [('mean square', tail(ratio, freedom, floor.freedom))]
    if s.used.all():
        if not own:
            mean = math.sqrt(count) * left.mean(axis=0)
            repeated = max(parts * length - parameters, 1.0)
            noise = floor.mean / parts * (1.0 + count * of_mean)
            same = float(np.sum(np.abs(mean) ** 2)) / noise / repeated
            tests.append(('what repeats', tail(same, repeated * floor.evenness, floor.freedom)))
        spectrum = np.sum(np.abs(np.fft.fft(left, axis=1)) ** 2, axis=0) / (length * floor.power * wider)
        half = spectrum if s.iq else spectrum[1 : length // 2]
        strongest = float(half.max()) if half.size else 0.0
        tests.append(('one frequency', min(1.0, float(gammaincc(count, strongest)) * half.size)))
    chance = min(1.0, len(tests) * min(p for _, p in tests))
    return Misfit(ratio, freedom, chance, tuple(tests))


def of_blocks(
    s: Sweeps, found: Solved, held: np.ndarray, slopes: np.ndarray, floor: Noise, whole: np.ndarray
) -> Misfit:
    """Return the misfit of samples (N,) that were held out in each sweep.

    What a fit to the other samples predicts there has errors of its own: of each column that was fitted, `slopes`
    (n, P, N) of what the frequencies change among them. `whole` (n, N) is what the receiver makes of the lines.
    """
    parts = 2.0 if s.iq else 1.0
    ones = np.ones((len(found.waves), 1, found.waves.shape[2]))
    linear = [ones, found.waves] if s.iq else [ones, found.waves.real, found.waves.imag]
    columns = np.concatenate([*linear, slopes], axis=1)
    known, asked = columns[..., ~held], columns[..., held]
    normal = np.matmul(known, known.conj().swapaxes(1, 2))
    scale = np.einsum('nkk->nk', normal).real
    normal = normal + np.einsum('nk,kl->nkl', 1e-9 * scale + 1e-12, np.eye(normal.shape[1]))
    leverage = np.einsum('nka,nkl,nla->na', asked.conj(), np.linalg.inv(normal).conj(), asked).real
    expected = floor.mean * float(np.sum(1.0 + leverage))
    left = (s.signal - whole)[:, held]
    ratio = float(np.sum(np.abs(left) ** 2)) / expected
    freedom = parts * left.size * floor.evenness / float(np.mean(1.0 + leverage))
    chance = tail(ratio, freedom, floor.freedom)
    return Misfit(ratio, freedom, chance, (('mean square', chance),))


def bounded(gain: float) -> float:
    """Return the largest chance of a gain of the logarithm of the likelihood, the inverse of the likelihood's ratio."""
    return math.exp(-min(max(gain, 0.0), 690.0))


def tail(ratio: float, freedom: float, of_noise: float) -> float:
    """Return the chance of so large a ratio of two mean squares of noise."""
    return float(stats.f.sf(ratio, freedom, of_noise))
