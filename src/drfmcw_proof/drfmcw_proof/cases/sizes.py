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
from ..generator.model import FIRST, SECOND, SPEED_OF_LIGHT, Scene, Stream, clean, digitise, nominal, receive
from ..generator.phase_noise import phase_noise_density
from .concealing import KINDS, Applied, conceal

FLOOR_KNOWN, SKIRTS_KNOWN = 0.04, 0.15  # standard deviations of the calibrated noise [dB]
_AMPLITUDES, _PHASES, _START, _FLIGHT = (0, 1), (2, 3), 4, 5  # indices of the nuisance parameters
_OFF = 0.5  # of a line's amplitude, below which it counts as silent
_ABSENT = 1.0  # [1/Hz] noise density of a side-band that a real IF does not have
_TURNS = 16  # realisations of phases that nobody knows, evenly over the circle
_HALVES = tuple(range(0, _TURNS, 2)), tuple(range(1, _TURNS, 2))  # under one realisation of the noise and another
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


def _covariance(
    scene: Scene,
    row: int,
    noisy: Scene,
    floors: Sequence[float] = (1.0, 1.0),
    skirts: Sequence[np.ndarray | float] = (1.0, 1.0),
) -> tuple[np.ndarray, np.ndarray]:
    """Return the covariance of both stations' side-bands at one row, and which of them exist.

    Lines stand where they are in `scene`, with the noise of `noisy`: of it, each station's floor and each oscillator's
    phase noise [samples / 2] is so many times as strong.

    At each offset f > 0 from the lines, the relative changes g_i of the signals have the side-bands G_1(f), G_1*(-f),
    G_2(f), G_2*(-f): covariance [samples / 2, 4, 4], existence [samples / 2, 4].
    """
    c = scene.condition
    count, rate = c.sample_count, c.sample_rate
    offset = np.arange(count // 2) * (rate / count)
    one = np.array([row])
    flight, start = _flight(scene, one)[0], scene.start_delay[row]
    density = [skirts[s] * phase_noise_density(offset, *noisy.oscillators[s]) for s in (FIRST, SECOND)]
    omega = 2.0 * math.pi * offset
    cross = -density[0] * np.exp(1j * omega * (flight - start)) - density[1] * np.exp(-1j * omega * (flight + start))
    phase = np.empty((count // 2, 2, 2), complex)
    phase[:, 0, 0] = phase[:, 1, 1] = density[0] + density[1]
    phase[:, 0, 1], phase[:, 1, 0] = cross, np.conj(cross)
    bands = np.zeros((4, 2), complex)  # of the phase noise of each station
    bands[0, 0], bands[1, 0], bands[2, 1], bands[3, 1] = 1j, -1j, 1j, -1j
    relative = np.empty((count // 2, 4), complex)  # response of the IF path, relative to that at the line
    thermal = np.empty((count // 2, 4))
    present = np.empty((count // 2, 4), bool)
    for s in (FIRST, SECOND):
        line = _line(scene, s, one)[0]
        alike = np.flatnonzero(scene.setting == scene.setting[row])  # each has its own amplitude
        density_here = floors[s] * noisy.noise_std(s)[row] ** 2 / rate / np.mean(scene.amplitude(s, alike) ** 2)
        for i, side in ((2 * s, 1.0), (2 * s + 1, -1.0)):
            frequency = np.sign(line) * (line + side * offset)
            present[:, i] = (frequency > -0.5 * rate / count) & (frequency < 0.5 * rate)
            gain = np.ones(count // 2, complex)
            for response in noisy.responses[s]:
                gain = gain * response(np.abs(frequency)) / response(abs(line))
            relative[:, i] = gain if side > 0 else np.conj(gain)
            thermal[:, i] = 4.0 * density_here + _folded(noisy, np.abs(frequency), abs(line))
    covariance = np.einsum('ij,fjk,lk->fil', bands, phase, np.conj(bands))
    covariance[:, np.arange(4), np.arange(4)] += thermal
    covariance *= relative[:, :, None] * np.conj(relative[:, None, :])
    both = present[:, :, None] & present[:, None, :]
    covariance = np.where(both, covariance, 0.0)
    covariance[:, np.arange(4), np.arange(4)] += np.where(present, 0.0, _ABSENT)
    return covariance, present


def _folded(scene: Scene, frequency: np.ndarray, line: float) -> np.ndarray:
    """Return the density at frequencies of a real IF of those side-bands that fold back at zero and at Nyquist."""
    rate = scene.condition.sample_rate
    result = np.zeros(frequency.shape)
    for offset in (frequency + line, rate - frequency - line):
        density = sum(phase_noise_density(np.abs(offset), *o) for o in scene.oscillators)
        result += np.where(np.abs(offset) <= 0.5 * rate, density, 0.0)
    return result


def _flight(scene: Scene, rows: np.ndarray) -> np.ndarray:
    far = scene.range_at(rows, scene.time[rows])
    return scene.delay[rows] + (1.0 + 1e-6 * scene.refractivity[rows]) / SPEED_OF_LIGHT * far


def _line(scene: Scene, station: int, rows: np.ndarray) -> np.ndarray:
    """Return the signed IF of a station's line [rows] [Hz]."""
    c = scene.condition
    start = scene.start_delay[rows] * (1.0 if station == FIRST else -1.0)
    apart = scene.alpha[station, rows] - scene.alpha[1 - station, rows]
    return c.chirp_rate * (_flight(scene, rows) + start) + c.start_frequency * apart


def _bands(g: Sequence[np.ndarray]) -> np.ndarray:
    """Return the side-bands [..., samples / 2, 4] of relative changes [..., samples] of both stations."""
    result = []
    for one in g:
        spectrum = np.fft.fft(one)
        half = one.shape[-1] // 2
        below = np.conj(np.roll(spectrum[..., ::-1], 1, axis=-1)[..., :half])
        result += [spectrum[..., :half], below]
    return np.stack(result, axis=-1)


def _relative(change: np.ndarray, carrier: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Return the relative change g of analytic signals, from one of real samples; zero where the carrier is off."""
    count = change.shape[-1]
    spectrum = np.fft.fft(change)
    turning = np.sum(carrier[:, 1:] * np.conj(carrier[:, :-1]), axis=1)
    positive = np.angle(turning) > 0.0
    frequency = np.arange(count)
    upper = 2.0 * ((frequency > 0) & (frequency < count // 2))
    lower = 2.0 * (frequency > count // 2)
    upper[0] = lower[0] = math.sqrt(2.0)  # a constant has one side-band: its energy is counted alike
    analytic = np.fft.ifft(spectrum * np.where(positive[:, None], upper, lower))
    return np.where(on, analytic / np.where(on, carrier, 1.0), 0.0)


def _is_heard(before: Scene, after: Scene, station: int) -> bool:
    """Return whether something acts on what a station receives, noise and all."""
    return any(hooks[station] for scene in (before, after) for hooks in (scene.analogue, scene.digital))


@dataclasses.dataclass(frozen=True)
class _Changes:
    """Relative changes [rows, samples] of both stations."""

    first: list[np.ndarray]  # under one realisation of the noise, the mean over unknown phases
    again: list[np.ndarray]  # under another
    supports: np.ndarray  # bool [2, rows, samples], where signals are on
    own: list[np.ndarray] | None  # differences from that mean at unknown phases [turns, rows, samples], after
    own_before: list[np.ndarray] | None


def _changes(before: Scene, after: Scene, rows: np.ndarray) -> _Changes:
    first: list[np.ndarray] = []
    again: list[np.ndarray] = []
    supports: list[np.ndarray] = []
    own: list[np.ndarray] = []
    own_before: list[np.ndarray] = []
    for s in (FIRST, SECOND):
        olds, news = _turned(before, s, rows), _turned(after, s, rows)
        old, new = np.mean(olds, axis=0), np.mean(news, axis=0)
        # where a chirp is off, a filter's response to its edge is no line whose change could be measured
        was_on, stays_on = (np.abs(x) > _OFF * np.abs(x).max(axis=1, keepdims=True) for x in (old, new))
        on = was_on & stays_on
        ratio = np.where(on, new / np.where(on, old, 1.0), 1.0)
        smooth = np.log(np.abs(ratio)) + 1j * np.unwrap(np.angle(ratio), axis=1)
        smooth = np.where(on, smooth, np.where(was_on, -1.0, 0.0))  # where a chirp is now off, all of the line is gone
        pair = [smooth, smooth]
        is_heard = _is_heard(before, after, s)
        turning = [is_heard and any(station == s for *_, station in scene.own_phases) for scene in (before, after)]
        if is_heard:
            heard = [_heard(before, after, s, rows, new.real, i, any(turning)) for i in (0, 1)]
            pair = [smooth + _relative(np.mean(changed - plain, axis=0), new, on) for plain, changed in heard]
        scenes = zip(turning, (own_before, own), (0, 1), (olds, news), (old, new), strict=True)
        for is_turning, found, which, turned, mean in scenes:
            differences = np.zeros((_TURNS, *new.shape), complex)
            differences += np.where(on, (turned - mean) / np.where(on, mean, 1.0), 0.0)
            if is_turning:
                differences += _relative(np.concatenate([x[which] - np.mean(x[which], axis=0) for x in heard]), new, on)
            found.append(differences)
        first.append(pair[0])
        again.append(pair[1])
        supports.append(was_on)
    return _Changes(
        first, again, np.array(supports), own if after.own_phases else None, own_before if before.own_phases else None
    )


def _turned(scene: Scene, station: int, rows: np.ndarray) -> np.ndarray:
    """Return the noise-free IF [turns, rows, samples], once where no oscillator is modulated at a phase of its own."""
    if not any(scene.hums):
        return clean(scene, station, rows)[None]
    turned = [dataclasses.replace(scene, advance=turn / _TURNS) for half in _HALVES for turn in half]
    return np.array([clean(one, station, rows) for one in turned])


def _heard(
    before: Scene, after: Scene, station: int, rows: np.ndarray, rays: np.ndarray, half: int, turning: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return what a station receives by the hooks of either scene [turns, rows, samples], at every other phase."""
    random = before.stream(Stream.EFFECT, 99, half, station, int(rows[0]))
    noise = random.standard_normal(rays.shape) * before.noise_std(station)[rows, None]
    plain, changed = [], []
    for turn in _HALVES[half] if turning else (0,):
        advance = turn / _TURNS
        one = dataclasses.replace(after, advance=advance)
        other = dataclasses.replace(one, analogue=before.analogue, own_phases=before.own_phases)
        received = receive(other, station, rows, rays, noise), receive(one, station, rows, rays, noise)
        if after.digital[station]:
            received = digitise(before, station, rows, received[0]), digitise(after, station, rows, received[1])
        plain.append(received[0].astype(float))
        changed.append(received[1].astype(float))
    return np.array(plain), np.array(changed)


def _templates(scene: Scene, supports: np.ndarray) -> np.ndarray:
    """Return the side-bands of the nuisances [rows, 6, samples / 2, 4]."""
    c = scene.condition
    count = c.sample_count
    slope = 2j * math.pi * c.chirp_rate * (np.arange(count) - 0.5 * count) / c.sample_rate
    on = supports.astype(complex)
    nothing = np.zeros_like(on[0])
    pairs = [
        (on[0], nothing),
        (nothing, on[1]),
        (1j * on[0], nothing),
        (nothing, 1j * on[1]),
        (slope * on[0], -slope * on[1]),
        (slope * on[0], slope * on[1]),
    ]
    return np.stack([_bands(p) for p in pairs], axis=1)


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
    nothing_heard = not any(_is_heard(before, after, s) for s in (FIRST, SECOND))
    powers = _Powers()
    noise = shape = ranging = amplitude = phase = balance = 0.0
    reference = after.reference() - before.reference()  # the nominal model takes a reading for the distance
    for setting in range(len(condition.distances)):
        everything = np.flatnonzero(before.setting == setting)
        rows = everything[np.unique(np.linspace(0, len(everything) - 1, most).astype(int))]
        weight = len(everything) / len(rows)
        covariance, present = _covariance(before, int(rows[0]), before)
        powers.add(len(everything), covariance, before, int(rows[0]), after)
        precision = 2.0 * np.linalg.inv(covariance) * (present[:, :, None] & present[:, None, :])
        precision /= condition.sample_rate * condition.sample_count  # densities of transforms of `sample_count`
        precision[0] *= 0.5
        change = _changes(before, after, rows)
        q = _bands(change.first)
        other = q if nothing_heard else _bands(change.again)
        templates = _templates(before, change.supports)
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
        error = speed * mean[:, _FLIGHT] - reference[rows]
        variance = speed**2 * spread[:, _FLIGHT, _FLIGHT] + condition.reference_std**2
        ranging += weight * float(np.sum(error**2 / variance))
        common = _NEPER * 0.5 * (mean[:, 0] + mean[:, 1])
        amplitude += weight * float(np.sum(common**2)) / max(condition.amplitude_scatter, 1e-3) ** 2
        balance += weight * float(np.sum(_against(mean, spread, _AMPLITUDES, -1.0)))
        sign = np.sign(_line(before, FIRST, rows))[0]
        moved = _against(mean - np.mean(mean, axis=0), spread, _PHASES, float(sign))
        phase += weight * float(np.sum(moved))
    noise += powers.matched()
    return MatchedSize(*(math.sqrt(x) for x in (shape, ranging, amplitude, noise, phase, balance)))


def _against(fit: np.ndarray, spread: np.ndarray, columns: tuple[int, int], sign: float) -> np.ndarray:
    """Return the squared significance of x_a + sign x_b [rows]."""
    a, b = columns
    variance = spread[:, a, a] + spread[:, b, b] + 2.0 * sign * spread[:, a, b]
    return (fit[:, a] + sign * fit[:, b]) ** 2 / variance


def _whitened(nominal_: np.ndarray, *others: np.ndarray) -> list[np.ndarray]:
    """Return covariances [samples / 2, 4, 4] in units of one, which is the identity then."""
    root = np.linalg.inv(np.linalg.cholesky(nominal_))
    return [root @ other @ np.conj(np.swapaxes(root, 1, 2)) for other in others]


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
        true = _covariance(before, row, after)[0]
        if np.array_equal(nominal_, true):
            return
        raised, tilted = 1.0 / _POWER_NEPER, np.linspace(-1.0, 1.0, len(nominal_)) / _POWER_NEPER  # by 1 dB
        skirts = [(1.0 + x, 1.0) for x in (raised, tilted)] + [(1.0, 1.0 + x) for x in (raised, tilted)]
        errors = [_covariance(before, row, before, floors)[0] for floors in ((1.0 + raised, 1.0), (1.0, 1.0 + raised))]
        errors += [_covariance(before, row, before, skirts=both)[0] for both in skirts]
        ratio, *changed = _whitened(nominal_, true, *(error - nominal_ for error in errors))
        change, slopes = _logarithm(ratio), np.stack(changed)
        self._normal += sweeps * np.einsum('kfij,lfij->kl', np.conj(slopes), slopes).real
        self._along += sweeps * np.einsum('kfij,fij->k', np.conj(slopes), change).real
        self._squares += sweeps * float(np.sum(np.abs(change) ** 2))

    def matched(self) -> float:
        """Return d^2 of all settings."""
        return max(self._squares - float(self._along @ np.linalg.solve(self._normal, self._along)), 0.0)


def _of_own_phases(change: _Changes, precision: np.ndarray, weighted: np.ndarray, spread: np.ndarray) -> float:
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
    own = np.moveaxis(np.concatenate([_bands(one) for one in sets]), 0, 1)  # [rows, realisations, samples / 2, 4]
    by_precision = np.einsum('fij,rkfj->rkfi', precision, own)
    taken = _products(weighted, own)
    gram = _products(own, by_precision) - np.einsum('rqk,rqp,rpl->rkl', taken, spread, taken)
    values, vectors = np.linalg.eigh(gram)
    factors = np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2) / math.sqrt(_TURNS)
    parts = [factors[:, :, i * _TURNS : (i + 1) * _TURNS] for i in range(len(sets))]
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
    louder = _covariance(before, row, dataclasses.replace(before, noise_floor=floor))[0]
    (ratio,) = _whitened(nominal_, louder)
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


def _scaled_parameter(template: Applied) -> str:
    """Return the parameter that makes an effect larger: that of its kind, or what stands for it."""
    instead = {'reference_clock_drift': 'warmup', 'amplitude_loss': 'specific'}.get(template.effect)
    if instead is not None and instead in template.parameters:
        return instead
    return KINDS[template.effect].size.parameter


def resized(template: Applied, size: float, condition: Condition) -> Applied:
    """Return an effect of another size, in the meaning of its `Kind.size`; signs and proportions are kept."""
    name = _scaled_parameter(template)
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
