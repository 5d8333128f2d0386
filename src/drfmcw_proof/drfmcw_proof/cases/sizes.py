"""Matched signal-to-noise of a concealed effect, and its parameter for a wanted one.

d^2 is the sum over all sweeps and samples of the squared noise-whitened change of the data. What each sweep has of its
own (amplitude and phase of each station, start delay) and the distance, which only the reference knows, are taken out
first: they are fitted by generalised least squares in the thermal and phase noise of the pair, in which the sum of both
stations' phases is quieter than their difference. What the fit takes as distance is judged against the reference and
its noise, what it takes as amplitude against the scatter of the sweeps' amplitudes. Changes of the noise itself are
counted by the spread of its spectral powers, beyond what each station's floor and each oscillator's skirts may differ
from their calibration in all sweeps: no calibration states how well it knows them, so d takes what the diagnosis does.

Unknown parameters are not counted as if they were known. For a known change d^2 is twice the mean logarithm of the
best detector's likelihood ratio (twice the Kullback-Leibler divergence). The same definition holds for:

- A phase that an effect draws in every sweep (spur, fan, dither) makes it a part of the sweep's noise. Its covariance
  is taken over a circle of phases; whitened, its eigenvalues l add to those of the noise, and d^2 of a sweep is the sum
  of l - ln(1 + l). A line of energy rho^2, wherever between the bins, has two of rho^2 / 2: over N sweeps d is
  sqrt(N) rho^2 / 2 where it is weak, as that of the sum of its powers, and sqrt(N) rho where it is strong; in between
  at most 4 % less than for a detector that knows rho.
- The time of a burst is unknown. The record is divided into windows of the burst's length. The power in a window is a
  number of unit standard deviation, which a burst shifts by s; each window holds a burst with the same small
  probability. d^2 is twice the divergence of that mixture from its noise, which accounts for the number of windows.
  Bursts of one station in two explanations count by the difference of their d, the least that separates them.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from ..generator.condition import Condition
from ..generator.model import FIRST, SECOND, SPEED_OF_LIGHT, Scene, nominal
from .changes import TURNS, Changes, changes, is_heard
from .concealing import KINDS, Applied, conceal
from .side_bands import AMPLITUDES, FLIGHT, PHASES, noise_covariance, nuisances, side_bands, signed_line, whitened

FLOOR_KNOWN, SKIRTS_KNOWN = 0.04, 0.15  # standard deviations of the calibrated noise [dB]
_FEW = 2  # sweeps of a setting for which they are computed
_NEPER, _POWER_NEPER = 20.0 / math.log(10.0), 10.0 / math.log(10.0)  # of an amplitude, of a power [dB]


@dataclasses.dataclass(frozen=True)
class MatchedSize:
    """Matched signal-to-noise of an effect by the level at which it shows; `total` is the root of their squares' sum.

    `phase` (carrier phase sum from sweep to sweep) and `balance` (amplitude of one station against the other) are
    further information that the definition of d does not count.
    """

    shape: float  # phase and amplitude over the sweep
    range: float
    amplitude: float  # both stations together, against the scatter
    noise: float
    phase: float
    balance: float

    @property
    def total(self) -> float:
        """The matched signal-to-noise d."""
        return math.sqrt(self.shape**2 + self.range**2 + self.amplitude**2 + self.noise**2)

    def as_object(self) -> dict[str, float]:
        """Return a JSON-ready object."""
        return {'total': self.total, **dataclasses.asdict(self)}


def matched_size(
    condition: Condition, effects: Sequence[Applied], background: Sequence[Applied] = (), most: int = 4
) -> MatchedSize:
    """Return the matched signal-to-noise of effects.

    Args:
        condition: of the recording.
        effects: concealed in it.
        background: others, which are there before and after.
        most: sweeps computed of each setting; the others are taken to be like them.
    """
    return _between(condition, background, [*background, *effects], most)


def separation(condition: Condition, explained: Sequence[Applied], truth: Sequence[Applied], most: int = 4) -> float:
    """Return how far apart the data of two sets of effects lie, in standard deviations, as d counts them."""
    return _between(condition, explained, truth, most).total


def _between(condition: Condition, some: Sequence[Applied], all_: Sequence[Applied], most: int) -> MatchedSize:
    """Return the matched signal-to-noise of what changes from one set of effects to the other."""

    def scene(effects: Sequence[Applied]) -> Scene:
        return conceal(nominal(condition), [e for e in effects if e.effect != 'interference_burst'])

    before, after = scene(some), scene(all_)
    bursts = [conceal(nominal(condition), effects).burst_power for effects in (some, all_)]
    if before.own_phases or after.own_phases:
        most = min(most, _FEW)
    nothing_heard = not any(is_heard(before, after, s) for s in (FIRST, SECOND))
    powers = _Powers()
    noise = shape = ranging = amplitude = phase = balance = 0.0
    reference = after.reference() - before.reference()  # the nominal model takes a reading for the distance
    for setting in range(len(condition.distances)):
        everything = np.flatnonzero(before.setting == setting)
        rows = everything[np.unique(np.linspace(0, len(everything) - 1, most).astype(int))]
        weight = len(everything) / len(rows)
        covariance, present = noise_covariance(before, int(rows[0]), before)
        powers.add(len(everything), covariance, before, int(rows[0]), after)
        precision = 2.0 * np.linalg.inv(covariance) * (present[:, :, None] & present[:, None, :])
        precision /= condition.sample_rate * condition.sample_count  # densities of transforms of `sample_count`
        precision[0] *= 0.5
        change = changes(before, after, rows)
        q = side_bands(change.first)
        other = q if nothing_heard else side_bands(change.again)
        templates = nuisances(before, change.supports)
        weighted = np.einsum('fij,rkfj->rkfi', precision, templates)
        fisher = np.einsum('rkfi,rlfi->rkl', np.conj(templates), weighted).real
        spread = np.linalg.inv(fisher)
        b, b_other = (np.einsum('rkfi,rfi->rk', np.conj(weighted), x).real for x in (q, other))
        fit, fit_other = (np.einsum('rkl,rl->rk', spread, x) for x in (b, b_other))
        w_other = np.einsum('fij,rfj->rfi', precision, other)
        coherent = np.einsum('rfi,rfi->r', np.conj(q), w_other).real - np.einsum('rk,rk->r', b, fit_other)
        shape += weight * max(float(np.sum(coherent)), 0.0)
        if not nothing_heard:
            own = np.einsum('rfi,fij,rfj->r', np.conj(q), precision, q).real - np.einsum('rk,rk->r', b, fit)
            freedom = float(np.sum(present)) * 2.0
            excess = max(float(np.mean(own - coherent)), 0.0) / freedom
            noise += 0.5 * len(everything) * freedom * math.log1p(excess) ** 2
        noise += weight * _of_own_phases(change, precision, weighted, spread)
        for s in (FIRST, SECOND):
            without, with_them = (
                sum(_of_bursts(before, int(rows[0]), covariance, *b) for b in listed if b[0] == s) for listed in bursts
            )
            noise += len(everything) * (math.sqrt(with_them) - math.sqrt(without)) ** 2
        mean = 0.5 * (fit + fit_other)
        speed = SPEED_OF_LIGHT / (1.0 + 1e-6 * before.refractivity[rows])
        error = speed * mean[:, FLIGHT] - reference[rows]
        variance = speed**2 * spread[:, FLIGHT, FLIGHT] + condition.reference_std**2
        ranging += weight * float(np.sum(error**2 / variance))
        common = _NEPER * 0.5 * (mean[:, 0] + mean[:, 1])
        amplitude += weight * float(np.sum(common**2)) / max(condition.amplitude_scatter, 1e-3) ** 2
        balance += weight * float(np.sum(_against(mean, spread, AMPLITUDES, -1.0)))
        sign = np.sign(signed_line(before, FIRST, rows))[0]
        moved = _against(mean - np.mean(mean, axis=0), spread, PHASES, float(sign))
        phase += weight * float(np.sum(moved))
    noise += powers.matched()
    return MatchedSize(*(math.sqrt(x) for x in (shape, ranging, amplitude, noise, phase, balance)))


def _against(fit: np.ndarray, spread: np.ndarray, columns: tuple[int, int], sign: float) -> np.ndarray:
    """Return the squared significance of x_a + sign x_b [rows]."""
    a, b = columns
    variance = spread[:, a, a] + spread[:, b, b] + 2.0 * sign * spread[:, a, b]
    return (fit[:, a] + sign * fit[:, b]) ** 2 / variance


def _logarithm(ratio: np.ndarray) -> np.ndarray:
    """Return the logarithm of whitened covariances [samples / 2, 4, 4]."""
    values, vectors = np.linalg.eigh(ratio)
    return (vectors * np.log(np.maximum(values, 1e-12))[:, None, :]) @ np.conj(np.swapaxes(vectors, 1, 2))


class _Powers:
    """Changes of the noise's spectral powers in all settings.

    Each station's floor and each oscillator's skirts, their level and their tilt up to the Nyquist frequency, are known
    to a standard deviation, alike in all settings. What they may be counts for nothing.
    """

    def __init__(self) -> None:
        self._normal = np.diag(np.array([FLOOR_KNOWN] * 2 + [SKIRTS_KNOWN] * 4) ** -2.0)
        self._along = np.zeros(6)
        self._squares = 0.0

    def add(self, sweeps: int, nominal_: np.ndarray, before: Scene, row: int, after: Scene) -> None:
        """Add a setting of so many sweeps like one, of which `nominal_` is the covariance before."""
        true = noise_covariance(before, row, after)[0]
        if np.array_equal(nominal_, true):
            return
        raised, tilted = 1.0 / _POWER_NEPER, np.linspace(-1.0, 1.0, len(nominal_)) / _POWER_NEPER  # by 1 dB
        skirts = [(1.0 + x, 1.0) for x in (raised, tilted)] + [(1.0, 1.0 + x) for x in (raised, tilted)]
        errors = [
            noise_covariance(before, row, before, floors)[0] for floors in ((1.0 + raised, 1.0), (1.0, 1.0 + raised))
        ]
        errors += [noise_covariance(before, row, before, skirts=both)[0] for both in skirts]
        ratio, *changed = whitened(nominal_, true, *(error - nominal_ for error in errors))
        change, slopes = _logarithm(ratio), np.stack(changed)
        self._normal += sweeps * np.einsum('kfij,lfij->kl', np.conj(slopes), slopes).real
        self._along += sweeps * np.einsum('kfij,fij->k', np.conj(slopes), change).real
        self._squares += sweeps * float(np.sum(np.abs(change) ** 2))

    def matched(self) -> float:
        """Return d^2 of all settings."""
        return max(self._squares - float(self._along @ np.linalg.solve(self._normal, self._along)), 0.0)


def _of_own_phases(change: Changes, precision: np.ndarray, weighted: np.ndarray, spread: np.ndarray) -> float:
    """Return d^2 of the rows' covariances that phases of their own make, after against before.

    Args:
        change: of the rows.
        precision: of side-bands [samples / 2, 4, 4].
        weighted: side-bands of the nuisances by it [rows, nuisances, samples / 2, 4].
        spread: covariance of the nuisances [rows, nuisances, nuisances].
    """
    sets = [own for own in (change.own, change.own_before) if own is not None]
    if not sets:
        return 0.0
    own = np.moveaxis(np.concatenate([side_bands(one) for one in sets]), 0, 1)  # [rows, realisations, samples / 2, 4]
    by_precision = np.einsum('fij,rkfj->rkfi', precision, own)
    taken = _products(weighted, own)
    gram = _products(own, by_precision) - np.einsum('rqk,rqp,rpl->rkl', taken, spread, taken)
    values, vectors = np.linalg.eigh(gram)
    factors = np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2) / math.sqrt(TURNS)
    parts = [factors[:, :, i * TURNS : (i + 1) * TURNS] for i in range(len(sets))]
    covariances = [np.eye(factors.shape[1]) + x @ np.swapaxes(x, 1, 2) for x in parts]
    if len(sets) == 2:
        root = np.linalg.inv(np.linalg.cholesky(covariances[1]))
        covariances[0] = root @ covariances[0] @ np.swapaxes(root, 1, 2)
    ratio = np.linalg.eigvalsh(covariances[0])
    ratio = np.maximum(ratio, 1.0 / ratio)  # a missing line is as informative as an extra one
    return float(np.sum(ratio - 1.0 - np.log(ratio)))


def _products(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the real scalar products [rows, a, b] of side-bands [rows, a, ...] and [rows, b, ...]."""
    one, other = (np.ascontiguousarray(x).reshape(*x.shape[:2], -1).view(float) for x in (one, other))
    return one @ np.swapaxes(other, 1, 2)


def _of_bursts(
    before: Scene,
    row: int,
    nominal_: np.ndarray,
    station: int,
    probability: float,
    length: float,
    power: float,
) -> float:
    """Return d^2 of bursts in a sweep like one, by the power in windows of their length."""
    count = before.condition.sample_count
    floor = before.noise_floor.copy()
    floor[station] += 10.0 * np.log10(1.0 + power / before.noise_std(station) ** 2)
    louder = noise_covariance(before, row, dataclasses.replace(before, noise_floor=floor))[0]
    (ratio,) = whitened(nominal_, louder)
    values = np.maximum(np.linalg.eigvalsh(ratio), 1e-12)
    covered = float(np.sum(np.log(values) ** 2))  # were all of the sweep in a burst
    windows = max(count / length, 1.0)
    chance = min(probability / windows, 1.0 - 1e-12)
    return 2.0 * windows * _mixture_divergence(chance, math.sqrt(covered / windows))


def _mixture_divergence(chance: float, shift: float) -> float:
    """Return Kullback and Leibler's divergence of a normal number that moves with a chance from one that does not."""
    z = np.linspace(-9.0, 9.0, 721)
    weight = np.exp(-0.5 * z**2) / np.sum(np.exp(-0.5 * z**2))

    def log_ratio(x: np.ndarray) -> np.ndarray:
        return np.logaddexp(math.log1p(-chance), math.log(chance) + shift * x - 0.5 * shift**2)

    return float(max(np.sum(weight * ((1.0 - chance) * log_ratio(z) + chance * log_ratio(z + shift))), 0.0))


def scaled_parameter(template: Applied) -> str:
    """Return the parameter that makes an effect larger: that of its kind, or what stands for it."""
    instead = {'reference_clock_drift': 'warmup', 'amplitude_loss': 'specific'}.get(template.effect)
    if instead is not None and instead in template.parameters:
        return instead
    return KINDS[template.effect].size.parameter


def resized(template: Applied, size: float, condition: Condition) -> Applied:
    """Return an effect of another size, in the meaning of its `Kind.size`; signs and proportions are kept."""
    name = scaled_parameter(template)
    given = template.parameters.get(name)
    value: float | list[float]
    if template.effect == 'phase_noise':
        station = condition.names.index(template.station) if template.station else FIRST
        value = condition.stations[station].phase_noise_level + size
    elif isinstance(given, list | tuple):
        neutral = KINDS[template.effect].size.neutral
        largest = max(abs(v - neutral) for v in given)
        value = [neutral + size * (v - neutral) / largest for v in given]
    else:
        value = KINDS[template.effect].size.value(size)
        if isinstance(value, float) and given is not None and given < 0.0 < value:
            value = -value
    return dataclasses.replace(template, parameters={**template.parameters, name: value})


def scaled(
    condition: Condition,
    template: Applied,
    wanted: float,
    background: Sequence[Applied] = (),
    tolerance: float = 0.02,
) -> tuple[Applied, MatchedSize]:
    """Return an effect of the wanted d, or as near as its bounds allow, and its matched size."""
    rule = KINDS[template.effect].size
    low, high = math.log(rule.lower), math.log(rule.upper)
    x = math.log(rule.start)
    known: list[tuple[float, float]] = []
    tried: list[tuple[float, Applied, MatchedSize]] = []
    for _ in range(14):
        trial = resized(template, math.exp(x), condition)
        size = matched_size(condition, [trial], background)
        y = math.log(max(size.total, 1e-9) / wanted)
        tried.append((abs(y), trial, size))
        if abs(y) < tolerance or high - low < 1e-4:
            break
        low, high = (x, high) if y < 0.0 else (low, x)
        known.append((x, y))
        x = _next(known, low, high)
    return min(tried, key=lambda one: one[0])[1:]


def _next(known: list[tuple[float, float]], low: float, high: float) -> float:
    """Return the next abscissa by the secant of the last two points, by d in proportion to size at first."""
    slope = 1.0
    if len(known) > 1:
        (x0, y0), (x1, y1) = known[-2:]
        slope = (y1 - y0) / (x1 - x0) if x1 != x0 else 1.0
    if slope > 0.05:
        guess = known[-1][0] - known[-1][1] / slope
        if low < guess < high:
            return guess
    return 0.5 * (low + high)
