"""Terms of a measured remainder that act on line and path: response over the sweep, gain, delay, start delay."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import scipy.fft

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_sim.synthesis.measured import Measured, MeasuredModel, Term

from ..compare.comparison import Comparison
from .evidence import LeftOver
from .limits import LEARNING
from .smoothing import Smooth, points, smooth


@dataclasses.dataclass(frozen=True)
class Curve:
    """One learnt curve: numbers of one kind at one station, channel or the path, and the terms that simulate it."""

    kind: str
    row: int  # station or channel; 0 of the path
    smooth: Smooth | None  # in the kind's own numbers; None of what is added to the IF
    terms: tuple[Term, ...]


def curves(left: LeftOver, wanted: Sequence[tuple[str, int]]) -> list[Curve]:
    """Return the curves that describe what is left, of those kinds and rows that are wanted."""
    found = []
    for kind, row in wanted:
        make = _MAKERS.get(kind)
        if make is None:
            continue
        row = max(row, 0)
        stations = _concerned(left.comparison, kind, row)
        curve = smooth(left.sample(kind, row), left.covariates(stations), kind == 'ramp')
        if curve is not None:
            found.append(Curve(kind, row, curve, make(left.comparison, row, curve)))
    return _corrected(left, found)


def _concerned(comparison: Comparison, kind: str, row: int) -> Sequence[str]:
    """Return the stations whose boards and lines a curve may depend on."""
    if kind == 'amplitude':
        return (comparison.receivers[row],)
    if kind == 'ramp' and (receiver := comparison.channels[row].receiver) >= 0:
        return (comparison.receivers[receiver],)
    return comparison.receivers


def _corrected(left: LeftOver, found: list[Curve]) -> list[Curve]:
    """Return curves whose simulation shows what they are to show."""
    c = left.comparison
    smooths = [curve.smooth for curve in found if curve.smooth is not None]
    target = [curve.values for curve in smooths]
    given = list(target)
    for _ in range(LEARNING.rounds if found else 0):
        measured = Measured(model_of(c, [t for x in found for t in x.terms]), noisy=False)
        changed = c.predict((*left.effects, measured))
        for number, (curve, smoothed) in enumerate(zip(found, smooths, strict=True)):
            after, before = (_rows(g[curve.kind], curve.row) for g in (changed, left.predicted))
            _, point = points(smoothed.covariate)
            shown = np.zeros(target[number].shape)
            np.add.at(shown, point, after - before)
            shown /= np.bincount(point)[:, None]
            given[number] = given[number] + target[number] - shown
            given[number][:, smoothed.terms :] = 0.0
            moved = dataclasses.replace(smoothed, values=given[number])
            found[number] = dataclasses.replace(curve, terms=_MAKERS[curve.kind](c, curve.row, moved))
    return found


def _rows(values: np.ndarray, row: int) -> np.ndarray:
    """Return the numbers of one row of a kind (G, P)."""
    if values.ndim == 1:
        return values[:, None]
    return values[:, row].reshape(len(values), -1)


def model_of(comparison: Comparison, terms: Sequence[Term]) -> MeasuredModel:
    """Return a model of the stations of a comparison."""
    return MeasuredModel(comparison.data.stations, comparison.data.path, tuple(terms))


def _term(quantity: str, station: str, curve: Smooth, values: np.ndarray, grid: np.ndarray | None = None) -> Term:
    axis = curve.covariate
    over = np.zeros(1) if grid is None else grid
    return Term(quantity, station, axis.axis, axis.station, curve.at, over, np.ascontiguousarray(values))


def sweep_time(comparison: Comparison, station: int) -> np.ndarray:
    """Return the times of the ramp's blocks in the sweep of a station with samples (K,) [s]."""
    late = comparison.data.sweeps[0][0].start_delay if comparison.recorded.topology.both_heard and station else 0.0
    time: np.ndarray = np.asarray(comparison.time, float) - late
    return time


def _response(comparison: Comparison, row: int, curve: Smooth) -> tuple[Term, ...]:
    over_time = scipy.fft.idct(curve.values, norm='ortho', axis=1)
    channel = comparison.channels[row]
    if not channel.of_phase:
        time = sweep_time(comparison, channel.receiver)
        return (_term('log_amplitude', comparison.receivers[channel.receiver], curve, over_time, time),)
    mixing = _mixing(comparison)
    number = [i for i, x in enumerate(comparison.channels) if x.of_phase].index(row)
    return tuple(
        _term('phase', name, curve, mixing[i, number] * over_time, sweep_time(comparison, i))
        for i, name in enumerate(comparison.receivers)
    )


def _mixing(comparison: Comparison) -> np.ndarray:
    """Return by what to multiply the phase channels to get the phases of the stations' IF (S, channels).

    How the IF phase of a station shows in the channels depends on the signs of both lines; a small change shows it.
    """
    of_phase = [i for i, x in enumerate(comparison.channels) if x.of_phase]
    shape = np.cos(np.linspace(0.0, 4.0 * np.pi, len(comparison.time)))
    shown = np.empty((len(of_phase), len(comparison.receivers)))
    wanted = scipy.fft.dct(LEARNING.probe * shape, norm='ortho')[2:]
    for i, name in enumerate(comparison.receivers):
        time = sweep_time(comparison, i)
        term = Term('phase', name, '', '', np.zeros(1), time, LEARNING.probe * shape[None])
        probe = Measured(model_of(comparison, [term]), noisy=False)
        change = (comparison.predict((probe,))['ramp'] - comparison.plain['ramp'])[:, of_phase, 2:].mean(axis=0)
        shown[:, i] = change @ wanted / (wanted @ wanted)
    mixing: np.ndarray = np.linalg.pinv(shown)
    return mixing


def _gain(comparison: Comparison, row: int, curve: Smooth) -> tuple[Term, ...]:
    return (_term('gain', comparison.receivers[row], curve, curve.values),)


def _delay(comparison: Comparison, row: int, curve: Smooth) -> tuple[Term, ...]:
    index = float(np.mean(comparison.data.refractive_index))
    return (_term('delay', '', curve, curve.values * index / SPEED_OF_LIGHT),)


def _start_delay(comparison: Comparison, row: int, curve: Smooth) -> tuple[Term, ...]:
    per_delay = comparison.parts[0].extract.beat_per_start_delay
    return (_term('start_delay', '', curve, curve.values / per_delay),)


_MAKERS: dict[str, Callable[[Comparison, int, Smooth], tuple[Term, ...]]] = {
    'ramp': _response,
    'amplitude': _gain,
    'range': _delay,
    'beat': _start_delay,
}
