"""Scanners: where in a remainder the search for an effect with a sharp shape should begin.

Such an effect fits only within a resolution cell, of which there are hundreds: too many to simulate each. To first
order most respond as a rotating phasor, so transforms of the remainder show all cells at once. An effect's recipe names
the scanner that finds its starting points. A scanner only starts the search: the simulator's forward model alone says
what an effect does.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy.fft
from scipy import stats

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_physics.sweep import Role
from drfmcw_sim.effects import Recipe

from ...compare.comparison import Comparison
from ...features.limits import SPECTRUM, SURGES
from ...features.sines import waves
from ...features.surges import surge_power
from ..limits import SCAN
from .phasors import echoes, per_metre, reflections, ripples, sweep_resolution
from .scanning import Rest, Scanner, Values, peaks
from .swaying import oscillations


def starting_points(rest: Rest, recipe: Recipe, station: int) -> list[dict[str, float]]:
    """Return values of the scanned parameters at which an effect would explain most, best first.

    Args:
        rest: of an explanation.
        recipe: of the effect.
        station: its number, -1 for none.

    Raises:
        ConfigurationError: no scanner has the name that the recipe gives.
    """
    scanner = _scanner(recipe.scan)
    if scanner.of_station and station < 0:
        return []
    names = (recipe.scanned, *recipe.scanned_with)
    found = scanner.find(rest, station, recipe)
    return [dict(zip(names, v if isinstance(v, tuple) else (v,), strict=True)) for v in found]


def resolution(comparison: Comparison, recipe: Recipe) -> float:
    """Return the width of a resolution cell, in units of the scanned parameter; 0 where there is none."""
    return _scanner(recipe.scan).resolution(comparison) if recipe.scan else 0.0


def _scanner(name: str) -> Scanner:
    if name not in SCANNERS:
        raise ConfigurationError(f"no scanner '{name}'{nearest(name, sorted(SCANNERS))}")
    return SCANNERS[name]


def _rhythms(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return frequencies at which the phases change from sweep to sweep, as a modulation of random phase does [Hz].

    First those at which the sweeps themselves hold sines, then those that the remainder suggests: it shows a strong
    modulation distorted, but a faint one beside others.
    """
    c, residual = rest.comparison, rest.residual
    groups, channels, count = c.std.flutter.shape
    step = float(c.time[1] - c.time[0])
    frequency = waves(count).frequency
    turn = 2.0 * math.pi * frequency[:, None] * np.arange(count)
    power = scipy.fft.dct(np.cos(turn), norm='ortho') ** 2 + scipy.fft.dct(np.sin(turn), norm='ortho') ** 2
    z = residual[c.entries.where(kind='flutter')].reshape(groups, channels, count)[:, channels // 2 :].sum(axis=0)
    # each channel has a size of its own: that in which the oscillators' noise cancels shows a part of it
    gain = np.maximum(z @ power.T, 0.0) ** 2 / np.sum(power**2, axis=1)
    found = [*c.sines(SCAN.peaks), *peaks(gain.sum(axis=0))]
    return tuple(float(frequency[number]) / step for number in dict.fromkeys(found))


def _suspicious(c: Comparison, residual: np.ndarray, station: int) -> bool:
    """Return whether a station's spectrum and levels differ from the model's: a distortion takes long to simulate."""
    chances = []
    for kind in ('harmonic', 'lines', 'noise', 'amplitude', 'piled'):
        z = residual[c.entries.where(kind=kind, station=station)]
        used = np.count_nonzero(z)
        share = 1.9 if kind == 'lines' else 1.0  # neighbouring bins of a Hann window share their noise
        chances.append(stats.chi2.sf(z @ z / share, used / share) if used else 1.0)
    chances += _third_harmonic(c, residual, station)
    return bool(len(chances) * min(chances) <= SCAN.suspicion)


def _odd_harmonics(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return third-order terms of a curve, 1 at full scale, where a station's spectrum or levels suggest a distortion.

    The strongest line, of amplitude A, loses the shares 3/4 c A^2 that the recipe tries: the least ones, and that which
    the third harmonics suggest. A line of amplitude A has one of c A^2 / 4 relative to itself, against its own phase.
    """
    c, residual = rest.comparison, rest.residual
    if not _suspicious(c, residual, station):
        return ()
    power = 10.0 ** (_strongest(c, station) / 10.0)
    least = min(map(abs, recipe.tries))
    tried = [share for share in recipe.tries if abs(share) == least]
    term = _curve_term(rest, [station], 3, lambda line: -0.25 * line**2)
    if term is not None:
        suggested = 0.75 * power * term
        alike = (share for share in recipe.tries if share * suggested > 0.0)
        tried += sorted(alike, key=lambda share: abs(math.log(share / suggested)))[:1]
    return tuple(share / (0.75 * power) for share in dict.fromkeys(tried))


def _even_harmonics(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return the second-order term of a curve, 1 at full scale, that the lines' second harmonics suggest.

    A line of amplitude A has one of c A / 2 relative to itself, at its own phase.
    """
    stations = range(len(rest.comparison.receivers)) if station < 0 else (station,)
    term = _curve_term(rest, stations, 2, lambda line: 0.5 * line)
    return () if term is None else (term,)


def _curve_term(
    rest: Rest, stations: Sequence[int], order: int, relative: Callable[[np.ndarray], np.ndarray]
) -> float | None:
    """Return the coefficient of a curve's term that harmonics suggest; None where chance may make as much of them.

    Args:
        rest: of an explanation.
        stations: numbers of those that have it.
        order: of the harmonics.
        relative: harmonic over the line by a coefficient of 1, from the line's amplitude over full scale; least squares
            over all groups.
    """
    c, number, overlap, power = rest.comparison, SPECTRUM.harmonics.index(order), 0.0, 0.0
    for i in stations:
        z = rest.residual[c.entries.where(kind='harmonic', station=i)].reshape(len(c.members), -1)[:, number]
        line = 10.0 ** (c.measured.amplitude[:, i] / 20.0) / _full_scale(c, i)
        unit = np.where(z != 0.0, relative(line) / c.std.harmonic[:, i, number], 0.0)
        overlap, power = overlap + float(unit @ z), power + float(unit @ unit)
    if power == 0.0 or 2.0 * stats.norm.sf(abs(overlap) / math.sqrt(power)) > SCAN.suspicion:
        return None
    return overlap / power


def _limits(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return limits of a station's samples [dB of full scale], where its spectrum or levels suggest a distortion.

    Samples pile up at a limit. Where that does not show, as codes are too coarse for it, it may be at any level.
    """
    c, residual = rest.comparison, rest.residual
    if not _suspicious(c, residual, station):
        return ()
    std = c.std.piled[:, station]
    if np.isfinite(std).any():
        piled = c.measured.piled[:, station] / std
        most = int(np.argmax(piled))
        return _limit(c, station, most) if piled[most] > SCAN.piled else ()
    strongest = _strongest(c, station)
    return tuple(np.arange(strongest, strongest - SCAN.deepest, -SCAN.level_step).tolist())


def _limit(c: Comparison, station: int, group: int) -> tuple[float, ...]:
    """Return limits about that at which a station's samples pile up in a group [dB of full scale].

    How many samples pile up depends on the level, which is known less well: a slightly different limit may fit better.
    """
    samples = c.data.samples[c.heard[station]]
    assert samples is not None  # of a station that is heard
    limit = 20.0 * math.log10(np.abs(samples[c.members[group]].astype(int)).max() / _full_scale(c, station))
    return tuple(limit + above for above in SCAN.above_limit)


def _strongest(c: Comparison, station: int) -> float:
    """Return the level of a station's strongest line [dB of full scale]."""
    return float(c.measured.amplitude[:, station].max()) - 20.0 * math.log10(_full_scale(c, station))


def _full_scale(c: Comparison, station: int) -> float:
    """Return the full scale of a station's converter [LSB]."""
    return float(np.median(c.data.full_scale[c.heard[station]]))


def _third_harmonic(c: Comparison, residual: np.ndarray, station: int) -> list[float]:
    """Return p-values of third harmonics at the line's phase that grow with the line as those of a distortion do."""
    groups = len(c.members)
    z = residual[c.entries.where(kind='harmonic', station=station)].reshape(groups, -1)[:, SPECTRUM.harmonics.index(3)]
    line = 10.0 ** ((c.measured.amplitude[:, station] - c.measured.amplitude[:, station].max()) / 20.0)
    chances = []
    for power in SCAN.growth:
        expected = np.where(z != 0.0, line**power / c.std.harmonic[:, station, SPECTRUM.harmonics.index(3)], 0.0)
        if expected.any():
            chances.append(float(2.0 * stats.norm.sf(abs(expected @ z) / np.linalg.norm(expected))))
    return chances


def _bursts(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return (probability in a sweep, level [dB of full scale], duration [s]) of bursts of noise.

    The sweeps with loud spans suggest them; none where the power is spread evenly.
    """
    c, residual = rest.comparison, rest.residual
    z = residual[c.entries.where(kind='burst', station=station)]
    if not z.any() or stats.chi2.sf(z @ z, np.count_nonzero(z)) > SCAN.suspicion:
        return []
    shares, levels, lengths, steady = [], [], [], []
    for features in c.sweeps:
        quiet = features.quiet[:, station]
        # what a burst leaks into other spans of its sweep, from which the line was taken, is no part of its length
        loud = quiet > np.fmax(SPECTRUM.burst * np.median(quiet), SCAN.leaked * quiet.max(axis=1, keepdims=True))
        shares.append(loud.any(axis=1))
        levels.append(quiet[loud] - np.median(quiet))
        lengths.append(loud.sum(axis=1)[loud.any(axis=1)])
        steady.append(np.median(quiet))
    share = float(np.mean(np.concatenate(shares)))
    sweep = c.data.sweeps[0][c.heard[station]]
    bandwidth = 2.0 * SPECTRUM.line / c.measured.lines.shape[-1]  # that the line's neighbourhood leaves out
    full_scale = _full_scale(c, station)

    def level(power: float) -> float:
        return 10.0 * math.log10(2.0 * power / max(1.0 - bandwidth, 0.5) / full_scale**2)

    found: list[tuple[float, ...]] = []
    if share > 0.0:
        power = float(np.mean(np.concatenate(levels)))
        duration = float(np.mean(np.concatenate(lengths))) * SPECTRUM.span / sweep.sample_rate
        found = [
            (min(share * more, 1.0), level(power) + higher, duration)
            for more, higher in ((1.0, 0.0), (1.2, 0.0), (1.5, -2.0))
        ]
    if share < SCAN.loud:
        noise = float(np.mean(steady))
        for window, held in zip(SURGES.windows, _held(c, station), strict=True):
            for beyond in SCAN.surges if held > 0.0 else ():
                power = noise * surge_power(window, beyond)
                found.append((min(held * (1.0 + 1.0 / beyond), 1.0), level(power), window / sweep.sample_rate))
    return found


def _held(c: Comparison, station: int) -> np.ndarray:
    """Return the share of sweeps in which the power rises in windows (W,), beyond that of steady noise."""
    shares = slice(-len(SURGES.windows), None)
    values, std = (x.burst[:, station, shares] for x in (c.measured, c.std))
    over = values - c.plain.burst[:, station, shares]
    weights = 1.0 / std**2
    return np.asarray(np.sum(over * weights, axis=0) / np.maximum(weights.sum(axis=0), np.finfo(float).tiny))


def _free_lines(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return frequencies of lines in a station's IF spectrum that do not begin alike in each sweep [Hz]."""
    return tuple(f for f in _lines(rest, station) if not _begins_alike(rest.comparison, station, f))


def _lines(rest: Rest, station: int) -> tuple[float, ...]:
    """Return frequencies of lines in a station's IF spectrum [Hz]."""
    c, residual = rest.comparison, rest.residual
    z = residual[c.entries.where(kind='lines', station=station)].reshape(len(c.members), -1)
    width = c.data.sweeps[0][0].sample_rate / 2 / (z.shape[1] - 1)
    score = z.sum(axis=0) / np.sqrt(np.maximum(np.count_nonzero(z, axis=0), 1))
    spread = np.array([0.5, 1.0, 0.5])  # a Hann window spreads a line over three bins
    joined = np.convolve(score, spread, 'same')
    least = math.sqrt(SCAN.shown * rest.least * float(spread @ spread))
    found = []
    for k in (k for k in peaks(joined, apart=2) if joined[k] >= least):
        inside = np.maximum(score[max(k - 1, 0) : k + 2], 0.0)
        offset = np.average(np.arange(max(k - 1, 0), max(k - 1, 0) + len(inside)), weights=inside + 1e-12)
        found.append(float(offset * width))
    return tuple(found)


def _leaked_lines(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return the delays of leakage whose lines stand in a station's IF spectrum [ns]."""
    c = rest.comparison
    sweep = c.data.sweeps[0][c.heard[station]]
    slowest = SCAN.hann * sweep_resolution(c)  # slower, it is a constant
    found = (f for f in _lines(rest, station) if f > slowest and _begins_alike(c, station, f))
    return tuple(1e9 * f / abs(sweep.chirp_rate) for f in found)


def _begins_alike(c: Comparison, station: int, frequency: float) -> bool:
    """Return whether a line has the same phase at the start of each sweep, as one has that the chirp makes."""
    return c.recorded.alignment(station, frequency) > SCAN.alike


def _ends(rest: Rest, station: int, recipe: Recipe) -> Values:
    """Return when a station's ramp begins or ends [s], where a receiver's signal does so at another time than expected.

    Both receivers need this ramp: its own has it at once, the other a time of flight later on a clock of its own.
    """
    c, residual = rest.comparison, rest.residual
    last = int(recipe.scanned == 'end')
    found = []
    for receiver in range(len(c.heard)):
        z = residual[c.entries.where(kind='ends', station=receiver)].reshape(len(c.members), 2)[:, last]
        if stats.chi2.sf(z @ z, len(z)) > SCAN.suspicion or (z.sum() > 0.0) == bool(last):
            continue
        sweep = c.data.sweeps[0][c.heard[receiver]]
        time = c.measured.ends[:, receiver, last] / sweep.sample_rate
        if receiver != station:
            later = 1.0 if sweep.role == Role.FIRST else -1.0
            time = time - [s.range.mean() / SPEED_OF_LIGHT for s in c.recorded.sweeps] - later * sweep.start_delay
        clear = np.abs(z) > 0.5 * np.abs(z).max()  # elsewhere the receiver's own ramp may be the shorter one
        straight = c.data.sweeps[0][c.heard[station]].ramp_duration if last else 0.0
        found += [straight + share * (float(time[clear].mean()) - straight) for share in SCAN.shorter]
    return found


SCANNERS: dict[str, Scanner] = {
    'excess delay': Scanner(echoes, resolution=lambda c: sweep_resolution(c) / per_metre(c)),
    'fringes over distance': Scanner(reflections),
    'ripple': Scanner(ripples, resolution=sweep_resolution),
    'rhythm': Scanner(_rhythms, resolution=sweep_resolution),
    'oscillation': Scanner(oscillations),
    'narrow line': Scanner(_free_lines, True, lambda c: SCAN.hann * sweep_resolution(c)),
    'line of the chirp': Scanner(_leaked_lines, True, lambda c: SCAN.hann * sweep_resolution(c)),
    'odd harmonics': Scanner(_odd_harmonics, True),
    'even harmonics': Scanner(_even_harmonics),
    'limit': Scanner(_limits, True),
    'bursts': Scanner(_bursts, True),
    'ends': Scanner(_ends, True),
}
"""By the name that a recipe gives in `scan`."""
