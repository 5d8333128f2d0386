"""Where a misfit sits and what it looks like: locations, the map over levels and groups, residuals along their axes."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import scipy.fft

from ..compare.comparison import Comparison
from ..features import coherence
from ..search.fitting import Fitted, Fitting
from .result import Location, MisfitMap, Separability, Series

_CENTRAL = 0.9  # of an excess, which a location's span holds
_SHOWN = 0.01  # share of the excess below which a location is not named
_BY_CHANCE = 1e-4  # chance below which uneven codes are a mismatch that has a place
_TOLD = 3.0  # times its noise, to which a number must be predicted for a misfit

_LEVELS = {
    'ramp': ('if_samples', 'ramp_time'),
    'flutter': ('noise', 'if_frequency'),
    'lines': ('if_spectrum', 'if_frequency'),
    'mean': ('if_spectrum', 'if_frequency'),
    'harmonic': ('if_spectrum', 'range'),
    'piled': ('if_samples', 'range'),
    'burst': ('noise', 'range'),
    'coherence': ('noise', 'if_frequency'),
    'noise': ('noise', 'if_frequency'),
    'beat': ('beat_frequency', 'range'),
    'amplitude': ('amplitude', 'range'),
    'range': ('range', 'range'),
    'velocity': ('range', 'velocity'),
    'movement': ('range', 'time'),
}
"""Level and axis of the interface by kind of number."""


def remainder(comparison: Comparison, chosen: Fitted | None) -> np.ndarray:
    """Return whitened residuals beside an explanation (n,), NaN where nothing is compared.

    What the forward models may be off by counts as noise, see `Fitting.doubt`; numbers of which they tell next to
    nothing are NaN.
    """
    used = comparison.residual != 0.0
    if chosen is None:
        return np.where(used, comparison.residual, np.nan)
    beside = dataclasses.replace(chosen, template=comparison.template([e.build() for e in chosen.effects]))
    doubt = Fitting(comparison).doubt(beside)
    rest = (comparison.residual - beside.template) / np.sqrt(1.0 + doubt**2)
    return np.where(used & (doubt < _TOLD), rest, np.nan)


def _name(comparison: Comparison, kind: str, station: int) -> str | None:
    """Return the station's name, None where the numbers are the path's."""
    if kind in ('ramp', 'flutter'):
        station = comparison.channels[station].receiver
    return None if station < 0 else comparison.receivers[station]


def _axis(comparison: Comparison, kind: str, station: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (x, squared whitened residuals) of one kind of number at one station, along its axis."""
    c = comparison
    chosen = c.entries.where(kind=kind, station=station)
    z = c.residual[chosen]
    groups = len(c.members)
    distance = np.array([c.data.distance[m].mean() for m in c.members])
    rate = c.data.sweeps[0][0].sample_rate
    if kind == 'ramp':
        over_time = scipy.fft.idct(z.reshape(groups, -1), norm='ortho', axis=1)
        return c.time, np.mean(over_time**2, axis=0) * groups
    if kind == 'lines':
        bins = z.reshape(groups, -1)
        return np.arange(bins.shape[1]) * (rate / 2 / (bins.shape[1] - 1)), np.sum(bins**2, axis=0)
    if kind == 'flutter':
        terms = z.reshape(groups, -1)
        return _modulation(c, terms.shape[1]), np.sum(terms**2, axis=0)
    if kind == 'mean':
        return np.zeros(1), np.array([float(z @ z)])
    if kind in ('noise', 'coherence'):
        bands = z.reshape(groups, -1)
        widest = rate / 2 if kind == 'noise' else rate * coherence.FARTHEST
        return (np.arange(bands.shape[1]) + 0.5) * (widest / bands.shape[1]), np.sum(bands**2, axis=0)
    if kind == 'movement':
        return c.data.time[c.entries.position[chosen]], z**2
    if kind == 'velocity':
        return c.slope, z**2
    return distance, z**2


def _modulation(comparison: Comparison, terms: int) -> np.ndarray:
    """Return the frequencies of the terms of a cosine series over the sweep (terms,) [Hz]."""
    step = float(comparison.time[1] - comparison.time[0])
    return np.arange(terms) / (2.0 * terms * step)


def locations(comparison: Comparison) -> tuple[Location, ...]:
    """Return where the excess over the nominal model sits, largest share first."""
    c = comparison
    excess = {}
    for kind, station in c.entries.kinds():
        z = c.residual[c.entries.where(kind=kind, station=station)]
        used = np.count_nonzero(z)
        if used:
            excess[kind, station] = max(float(z @ z) - used - 4.0 * math.sqrt(2.0 * used), 0.0)
    uneven = {i: codes for i, codes in enumerate(c.codes) if codes is not None and codes.probability < _BY_CHANCE}
    excess |= {('codes', station): codes.excess for station, codes in uneven.items()}
    total = sum(excess.values())
    found = []
    for (kind, station), amount in sorted(excess.items(), key=lambda item: -item[1]):
        if total <= 0.0 or amount < _SHOWN * total:
            continue
        if kind == 'codes':
            low, high = uneven[station].low, uneven[station].high
            found.append(Location('if_samples', c.receivers[station], 'adc_code', low, high, amount / total))
            continue
        level, axis = _LEVELS[kind]
        x, squares = _axis(comparison, kind, station)
        order = np.argsort(x)
        weight = np.cumsum(np.maximum(squares[order] - np.median(squares), 0.0))
        low, high = x[order][0], x[order][-1]
        if weight[-1] > 0.0:
            low, high = (
                x[order][np.searchsorted(weight, q * weight[-1]).clip(0, len(x) - 1)]
                for q in ((1 - _CENTRAL) / 2, (1 + _CENTRAL) / 2)
            )
        found.append(Location(level, _name(c, kind, station), axis, float(low), float(high), amount / total))
    return tuple(found)


_WORDS = {
    'lines': 'narrow lines in the IF spectrum',
    'mean': 'mean of the samples',
    'harmonic': 'harmonics of the line',
    'piled': 'samples at the outermost codes',
    'burst': 'bursts of noise',
    'coherence': 'noise that both lines share',
    'noise': 'noise',
    'beat': 'common part of both beat frequencies',
    'amplitude': 'received power',
    'range': 'range beyond the reference',
    'velocity': 'slope of the reference',
    'movement': 'movement within a place',
}


_UNITS = {
    'mean': 'LSB',
    'harmonic': '1',
    'piled': '1',
    'burst': '1',
    'beat': 'Hz',
    'amplitude': 'dB',
    'range': 'm',
    'velocity': 'm/s',
}
"""Of kinds with few numbers at each place."""


def _row_name(comparison: Comparison, kind: str, station: int) -> str:
    name = _name(comparison, kind, station)
    if kind in ('ramp', 'flutter'):
        words = comparison.channels[station].words
        if kind == 'flutter':
            words = words.replace('over the sweep', 'from sweep to sweep')
        return f'{words}, {name}' if name else words
    words = _WORDS[kind]
    return words + (f', {name}' if name else '')


def _rows(comparison: Comparison) -> list[tuple[str, int]]:
    """Return kinds and stations that hold numbers."""
    c = comparison
    return [(k, s) for k, s in c.entries.kinds() if np.any(c.residual[c.entries.where(kind=k, station=s)] != 0.0)]


def misfit_map(comparison: Comparison, chosen: Fitted | None) -> MisfitMap:
    """Return mean squared whitened residuals by kind and group."""
    c = comparison
    rest = remainder(c, chosen)
    rows = _rows(c)
    before = np.full((len(rows), len(c.members)), np.nan)
    after = before.copy()
    for i, (kind, station) in enumerate(rows):
        for g in range(len(c.members)):
            inside = c.entries.where(kind=kind, station=station, group=g) & (c.residual != 0.0)
            if inside.any():
                before[i, g] = np.mean(c.residual[inside] ** 2)
                told = rest[inside][np.isfinite(rest[inside])]
                after[i, g] = np.mean(told**2) if len(told) else np.nan
    columns = tuple(f'{c.data.distance[m].mean():.0f} m' for m in c.members)
    return MisfitMap(tuple(_row_name(c, *row) for row in rows), columns, before, after)


@dataclasses.dataclass(frozen=True)
class _Plotted:
    """Numbers of one kind along their axis, (n,) each."""

    x: np.ndarray
    residual: np.ndarray
    std: np.ndarray
    curve: np.ndarray
    unit: str
    where: str = ''  # at which place, of the many


class _Plotter:
    """Takes what is plotted of each kind of number from a comparison, and from predictions with an explanation."""

    def __init__(self, comparison: Comparison, chosen: Fitted | None) -> None:
        c = comparison
        self._c, self._chosen = c, chosen
        self._added = c.predict(tuple(e.build() for e in chosen.effects)) if chosen else c.plain
        self._distance = np.array([c.data.distance[m].mean() for m in c.members])
        self._rate = c.data.sweeps[0][0].sample_rate

    def of(self, kind: str, station: int) -> _Plotted:
        """Return the numbers of a kind at a station, of the group with the largest misfit where each has several."""
        c = self._c
        rows = c.entries.where(kind=kind, station=station)
        worst = int(np.bincount(c.entries.group[rows], c.residual[rows] ** 2).argmax())
        if kind == 'ramp':
            return self._over_sweep(station, worst)
        if kind in ('lines', 'flutter'):
            return self._whitened(kind, station, worst)
        if kind in ('noise', 'coherence'):
            return self._in_bands(kind, station, worst)
        if kind == 'movement':
            return self._over_time()
        return self._over_places(kind, station)

    def _values(self, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return measured residuals, deviations, and what the explanation adds."""
        measured, plain, std, added = (
            getattr(v, kind) for v in (self._c.measured, self._c.plain, self._c.std, self._added)
        )
        return measured - plain, std, added - plain

    def _at(self, group: int) -> str:
        return f' at {self._distance[group]:.0f} m'

    def _over_sweep(self, channel: int, group: int) -> _Plotted:
        residual, std, curve = (v[group, channel] for v in self._values('ramp'))
        scale, unit = (1.0, 'rad') if self._c.channels[channel].of_phase else (20.0 / math.log(10.0), 'dB')
        known = np.isfinite(std)
        residual, curve = (scipy.fft.idct(np.where(known, v, 0.0), norm='ortho') * scale for v in (residual, curve))
        deviation = np.full(len(residual), math.sqrt(np.mean(std[known] ** 2)) * scale)
        return _Plotted(self._c.time, residual, deviation, curve, unit, self._at(group))

    def _whitened(self, kind: str, station: int, group: int) -> _Plotted:
        inside = self._c.entries.where(kind=kind, station=station, group=group)
        residual = self._c.residual[inside]
        count = len(residual)
        x = np.arange(count) * (self._rate / 2 / (count - 1)) if kind == 'lines' else _modulation(self._c, count)
        curve = self._chosen.template[inside] if self._chosen else np.zeros(count)
        return _Plotted(x, residual, np.ones(count), curve, 'σ', self._at(group))

    def _in_bands(self, kind: str, station: int, group: int) -> _Plotted:
        residual, std, curve = (v[group] if station < 0 else v[group, station] for v in self._values(kind))
        widest = self._rate / 2 if kind == 'noise' else self._rate * coherence.FARTHEST
        x = (np.arange(len(residual)) + 0.5) * (widest / len(residual))
        known = np.isfinite(residual) & np.isfinite(std)
        unit = 'dB' if kind == 'noise' else '1'
        return _Plotted(x[known], residual[known], std[known], curve[known], unit, self._at(group))

    def _over_time(self) -> _Plotted:
        residual, std, curve = self._values('movement')
        known = np.isfinite(std)
        rows = np.concatenate(self._c.members)
        return _Plotted(self._c.data.time[rows][known], residual[known], std[known], curve[known], 'm')

    def _over_places(self, kind: str, station: int) -> _Plotted:
        residual, std, curve = (
            v.reshape(len(v), -1) if station < 0 else v[:, station].reshape(len(v), -1) for v in self._values(kind)
        )
        # of several numbers, parts of a harmonic for instance, that with the largest misfit
        largest = int(np.nansum((residual / std) ** 2, axis=0).argmax())
        x = self._c.slope if kind == 'velocity' else self._distance
        return _Plotted(x, residual[:, largest], std[:, largest], curve[:, largest], _UNITS[kind])


def series(comparison: Comparison, chosen: Fitted | None) -> tuple[Series, ...]:
    """Return residuals along their axes, of the group with the largest misfit where there is one for each."""
    plotter = _Plotter(comparison, chosen)
    told = np.isfinite(remainder(comparison, chosen))
    found = []
    for kind, station in _rows(comparison):
        if not told[comparison.entries.where(kind=kind, station=station)].any():
            continue  # the explanation does not say what to expect
        plotted = plotter.of(kind, station)
        level, axis = _LEVELS[kind]
        values = plotted.x, plotted.residual, plotted.std, plotted.curve, plotted.unit
        label = _row_name(comparison, kind, station) + plotted.where
        found.append(Series(level, _name(comparison, kind, station), axis, *values, label))
    return tuple(found)


def separability(rounds: Sequence[Sequence[Fitted]]) -> Separability | None:
    """Return how far the best explanations with one effect lie from each other."""
    ranked = rounds[0][:6] if rounds else []
    if len(ranked) < 2:
        return None
    names = []
    for fitted in ranked:
        effect = fitted.effects[0]
        names.append(effect.candidate.effect + (f' ({effect.candidate.station})' if effect.candidate.station else ''))
    templates = np.array([f.template for f in ranked])
    distance = np.sqrt(np.sum((templates[:, None] - templates[None]) ** 2, axis=-1))
    return Separability(tuple(names), distance)
