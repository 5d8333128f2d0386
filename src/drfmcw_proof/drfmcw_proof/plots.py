"""The plots of a proof: each drawn where the cases run hold something for it."""

import collections
import io
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy import stats

from . import figures
from .figures import BINS, Record

_STYLE: Any = {'font.size': 9, 'axes.spines.top': False, 'axes.spines.right': False, 'legend.frameon': False}
_BLUE, _RED, _GREY = '#2f4b66', '#c8374a', '0.45'
_SHOWN = 30.0  # d to which power is drawn
_CLIP = 10.0  # pull beyond which it is drawn there


def draw(records: Sequence[Record]) -> dict[str, bytes]:
    """Return plots by name, PNG; those without any data are left out."""
    found = {}
    for name, plot in PLOTS.items():
        with matplotlib.rc_context(_STYLE):
            figure = plot(records)
            if figure is None:
                continue
            data = io.BytesIO()
            FigureCanvasAgg(figure)
            figure.savefig(data, format='png', dpi=110, bbox_inches='tight', metadata={'Software': None})
        found[name] = data.getvalue()
    return found


def _axes(width: float = 7.0, height: float = 3.4) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height))
    return figure, figure.add_subplot()


def _first_named(record: Record) -> str:
    if record['finding'] is None:
        return 'failed'
    if not record['judgement']['named']:
        return record['finding']['verdict']
    effects = figures.names(record['finding']['effects'])
    if record['group'] not in ('pair', 'strong_pair'):
        for shown_by in record['truth']['effects'][:-1]:  # what only shows the last one
            if shown_by['effect'] in effects:
                effects.remove(shown_by['effect'])
    return effects[0] if len(effects) == 1 else 'several'


def _true_name(record: Record) -> str:
    if figures.is_null(record):
        return 'nothing'
    if record['group'] in ('pair', 'strong_pair'):
        return 'two effects'
    last = record['truth']['effects'][-1]  # is shown by those before it
    if record['group'] == 'left_out':
        return 'left out of the registry'
    return last['effect'] if last['registered'] else 'outside the registry'


def _confusion(records: Sequence[Record]) -> Figure:
    """Return counts by what is concealed and what is named."""
    pairs = collections.Counter((_true_name(r), _first_named(r)) for r in records)
    special = (
        'nothing', 'two effects', 'outside the registry', 'left out of the registry',
        'consistent', 'several', 'unexplained', 'failed',
    )  # fmt: skip
    rows, columns = (
        sorted({pair[i] for pair in pairs}, key=lambda n: (n in special, special.index(n) if n in special else n))
        for i in (0, 1)
    )
    counts = np.array([[pairs[row, column] for column in columns] for row in rows], float)
    share = counts / counts.sum(axis=1, keepdims=True)
    figure, axes = _axes(2.5 + 0.38 * len(columns), 1.5 + 0.28 * len(rows))
    axes.imshow(share, cmap='Blues', vmin=0.0, vmax=1.0, aspect='auto')
    for (i, j), count in np.ndenumerate(counts):
        if count:
            axes.text(j, i, f'{count:.0f}', ha='center', va='center', color='white' if share[i, j] > 0.6 else 'black')
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha='right')
    axes.set_yticks(range(len(rows)), rows)
    axes.set_xlabel('named')
    axes.set_ylabel('concealed')
    return figure


def _binned(
    axes: Axes, records: Sequence[Record], is_so: Callable[[Record], bool], color: str, label: str, most: float = np.inf
) -> None:
    """Draw rates by d with their intervals."""
    points = []
    for low, high in itertools.pairwise(BINS):
        own = [r for r in records if low <= figures.size(r) < min(high, most)]
        if own:
            rate = figures.rate(own, is_so)
            reach = np.clip([rate.value - rate.interval[0], rate.interval[1] - rate.value], 0.0, None)
            points.append((float(np.median([figures.size(r) for r in own])), rate.value, *reach))
    if points:
        x, y, below, above = np.array(points).T
        axes.errorbar(x, y, (below, above), fmt='o-', lw=0.8, ms=4, color=color, capsize=2, label=label)


def _power(records: Sequence[Record]) -> Figure | None:
    """Return the share detected against d, beside theory."""
    singles = figures.of_power(records)
    if not singles:
        return None
    figure, axes = _axes()
    d = np.linspace(0.0, _SHOWN, 301)
    positions = figures.positions_searched(records)
    theory = figures.theoretical_power(d, figures.threshold(positions))
    axes.plot(d, theory, color=_GREY, label=f'matched filter, 1 % over {positions} positions')
    measured = figures.measured_threshold(records)
    if measured is not None:
        axes.plot(d, figures.theoretical_power(d, measured[0]), '--', color=_BLUE, label='fitted to all cases')
    for is_so, color, label in ((True, _BLUE, 'detected'), (False, _RED, 'missed')):
        own = [figures.size(r) for r in singles if figures.detected(r) == is_so]
        axes.plot(own, [1.04 if is_so else -0.04] * len(own), '|', ms=6, color=color, alpha=0.6, label=label)
    _binned(axes, singles, figures.detected, _BLUE, 'by size, 95 % intervals', _SHOWN)
    axes.set_xlim(0.0, _SHOWN)
    axes.set_xlabel('matched signal-to-noise d')
    axes.set_ylabel('share detected')
    axes.legend(loc='center right', fontsize=8)
    return figure


def _identification(records: Sequence[Record]) -> Figure | None:
    """Return what is named of what is detected, against d."""
    found = [r for r in figures.of(records, 'single', 'strong') if figures.detected(r)]
    if not found:
        return None
    figure, axes = _axes()
    separable = [r for r in found if figures.is_separable(r)]
    with_station = [
        r for r in separable if r['truth']['effects'][-1]['station'] is not None and figures.is_named(r)
    ]  # fmt: skip
    _binned(axes, separable, figures.is_named, _BLUE, 'name right, given detection')
    _binned(axes, with_station, figures.is_right, '#5b9a68', 'station right, given the name')
    _binned(axes, found, figures.is_wrong_name, _RED, 'one name alone, and wrong')
    axes.set_xscale('log')
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlabel('matched signal-to-noise d')
    axes.set_ylabel('share')
    axes.legend(loc='center right', fontsize=8)
    return figure


def _pulls(records: Sequence[Record]) -> Figure | None:
    """Return every pull, by effect and parameter, and the histogram of all."""
    pulls = figures.pulls(records)
    if not pulls:
        return None
    names = sorted({f'{p["effect"]}: {p["parameter"]}' for p in pulls})
    height = max(3.0, 1.2 + 0.2 * len(names))
    figure = Figure(figsize=(9.5, height))
    grid = figure.add_gridspec(2, 2, width_ratios=(3, 2), height_ratios=(3.0, height - 2.99))
    each, every = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    clipped = np.clip([p['pull'] for p in pulls], -_CLIP, _CLIP)
    each.axvspan(-3.0, 3.0, color='#dde5ee')
    each.plot(clipped, [names.index(f'{p["effect"]}: {p["parameter"]}') for p in pulls], 'o', ms=3, color=_BLUE)
    each.set_yticks(range(len(names)), names)
    each.set_xlim(-_CLIP - 0.5, _CLIP + 0.5)
    edges = np.arange(-_CLIP, _CLIP + 0.1, 0.5)
    every.hist(clipped, edges.tolist(), color='#9db4cb', density=True)
    x = np.linspace(-_CLIP, _CLIP, 201)
    every.plot(x, stats.norm.pdf(x), color=_GREY, label='normal, as stated')
    every.set_yticks([])
    every.legend(loc='upper right', fontsize=8)
    for axes in (each, every):
        axes.set_xlabel(f'error over its standard deviation (beyond {_CLIP:g} drawn there)', fontsize=8)
    figure.tight_layout()
    return figure


def _significance(records: Sequence[Record]) -> Figure | None:
    """Return how significances of nulls are distributed, by kind of noise."""
    nulls = [r for r in figures.of(records, 'null') if r['finding'] is not None]
    if not nulls:
        return None
    figure, axes = _axes(5.2, 4.0)
    lowest = 1e-4
    axes.plot([lowest, 1.0], [lowest, 1.0], color=_GREY, label='uniform: calibrated')
    axes.axvline(0.01, color=_GREY, lw=0.6, ls=':')
    for kind, own in figures.by(nulls, lambda r: r['kind']).items():
        values = np.sort(np.clip([r['finding']['significance'] for r in own], lowest, 1.0))
        share = np.arange(1, len(values) + 1) / len(values)
        axes.step(values, share, where='post', lw=2.0 if kind == 'right' else 1.0, label=f'{kind} ({len(own)})')
    axes.set_xscale('log')
    axes.set_yscale('log')
    axes.set_xlabel('stated significance')
    axes.set_ylabel('share of nulls with at most this')
    axes.legend(loc='lower right', fontsize=8)
    return figure


PLOTS: dict[str, Callable[[Sequence[Record]], Figure | None]] = {
    'nulls': _significance,
    'power': _power,
    'identification': _identification,
    'confusion': _confusion,
    'pulls': _pulls,
}
"""All plots by name."""
