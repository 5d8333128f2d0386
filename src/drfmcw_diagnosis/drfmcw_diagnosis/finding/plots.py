"""Plots of the report: results in, PNG out; the same results give the same bytes."""

import dataclasses
import io
import math
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from PIL import Image

from . import quantities, wording
from .limits import PLOTS
from .result import Fit, Location, MisfitMap, Series

DATA, CURVE, NOISE, SPAN = '#2f4b66', '#c8374a', '#dde5ee', '#e6a817'
_STYLE: Any = {
    'font.size': PLOTS.text,
    'axes.titlesize': PLOTS.text,
    'axes.titlelocation': 'left',
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.grid': True,
    'axes.axisbelow': True,
    'grid.alpha': PLOTS.grid,
    'legend.fontsize': PLOTS.legend_text,
    'legend.frameon': False,
}


def _figure(height: float) -> Figure:
    return Figure(figsize=(PLOTS.width, height), dpi=PLOTS.dpi, layout='constrained')


def _png(figure: Figure) -> bytes:
    """Return a figure as PNG with a palette: a third of the size, and no date in it."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())
    drawn = Image.fromarray(pixels[..., :3])
    image = io.BytesIO()
    drawn.quantize(PLOTS.colors, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(image, 'PNG')
    return image.getvalue()


def misfit_map(shown: MisfitMap, explained: bool) -> bytes:
    """Return the map before and, if there is an explanation, after."""
    panels = [('nominal model', shown.before)]
    if explained:
        panels = [('before: nominal model', shown.before), ('after: explanation in the model', shown.after)]
    values = np.concatenate([np.asarray(v, float).ravel() for _, v in panels])
    values = values[np.isfinite(values) & (values > 0.0)]
    largest = max(PLOTS.deepest, float(values.max(initial=0.0)))
    longest = max(map(len, shown.columns), default=0)
    turned = longest * len(shown.columns) > PLOTS.letters
    below = PLOTS.below + (PLOTS.letter * longest if turned else PLOTS.line)
    height = len(panels) * (PLOTS.title + PLOTS.row * len(shown.rows)) + below
    with matplotlib.rc_context(_STYLE | {'axes.grid': False}):
        figure = _figure(height)
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        norm = LogNorm(1.0 / largest, largest)
        for axis, (title, cells) in zip(axes, panels, strict=True):
            cells = np.asarray(cells, float)
            axis.set_facecolor('#eeeeee')
            image = axis.pcolormesh(
                np.ma.masked_invalid(cells), cmap='RdBu_r', norm=norm, edgecolors='white', linewidth=1.0
            )
            axis.set_title(title)
            axis.invert_yaxis()
            axis.set_yticks(np.arange(len(shown.rows)) + 0.5)
            axis.set_yticklabels(shown.rows, parse_math=False)
            axis.tick_params(length=0)
            axis.spines[:].set_visible(False)
            if len(shown.columns) <= PLOTS.cells:
                _write_cells(axis, cells, largest)
        axes[-1].set_xticks(np.arange(len(shown.columns)) + 0.5)
        options = {'rotation': 35, 'ha': 'right', 'rotation_mode': 'anchor'} if turned else {}
        axes[-1].set_xticklabels(shown.columns, parse_math=False, **options)
        bar = figure.colorbar(image, ax=axes, pad=0.01, aspect=5.0 * height)
        begin = max(1.0 / largest, PLOTS.palest)
        ticks = [m * 10.0**e for e in range(-6, 7) for m in (1, 2, 5) if begin <= m * 10.0**e <= largest]
        if largest > PLOTS.decades:
            ticks = [t for t in ticks if math.isclose(math.log10(t), round(math.log10(t)))]
        bar.set_ticks(FixedLocator(ticks))
        bar.ax.yaxis.set_minor_locator(NullLocator())
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f'{v:g}'))
        bar.ax.set_ylim(begin, largest)
        bar.set_label('misfit per degree\nof freedom, 1 = noise')
        return _png(figure)


def _write_cells(axis: Axes, cells: np.ndarray, largest: float) -> None:
    for row, column in np.argwhere(np.isfinite(cells)):
        value = cells[row, column]
        dark = value > 0.0 and abs(math.log(value)) > PLOTS.dark * math.log(largest)
        axis.text(
            column + 0.5, row + 0.5, _cell(value), ha='center', va='center',
            fontsize=PLOTS.cell_text, color='white' if dark else '#333333',
        )  # fmt: skip


def _cell(value: float) -> str:
    """Return a misfit in four characters, up to 10 000."""
    if value < 0.095:
        return f'{value:.2f}'
    return quantities.plain(value, 2 if value < 100.0 else 3)


@dataclasses.dataclass(frozen=True)
class PanelWords:
    """What panels and curves are called."""

    alone: str = 'data minus nominal model'
    before: str = 'before: data minus nominal model'
    after: str = 'after: explanation in the model'
    curve: str = 'explanation'


LEARNT = PanelWords(
    before='before: data minus model with effects', after='after: measured curve in the model', curve='measured curve'
)
"""Of a measured remainder."""


def series_panels(
    series: Series, locations: Sequence[Location], explained: bool, words: PanelWords | None = None
) -> bytes:
    """Return the residual against its axis before, with the effect's curve, and after if there is an explanation."""
    words = words or PanelWords()
    known = np.isfinite(series.x) & np.isfinite(series.residual)
    series = dataclasses.replace(
        series,
        **{field: np.asarray(getattr(series, field), float)[known] for field in ('x', 'residual', 'std', 'curve')},
    )
    name, axis_unit = wording.axis(series.axis)
    x_factor, x_unit = quantities.scaled(_largest(series.x), axis_unit)
    y_factor, y_unit = quantities.scaled(_largest(series.residual), series.unit)
    x = series.x * x_factor
    std = series.std * y_factor
    curve = series.curve * y_factor
    before = series.residual * y_factor
    noise = np.where(np.isfinite(std), std, 0.0)
    scale = _limits(before - noise, before + noise, -2.0 * noise, 2.0 * noise, curve if explained else before)
    panels = [(before, words.before if explained else words.alone, scale)]
    if explained:
        after = before - curve
        narrow = _limits(after - noise, after + noise, -2.0 * noise, 2.0 * noise)
        panels.append((after, words.after, scale))
        if scale[1] - scale[0] > PLOTS.enlarged * (narrow[1] - narrow[0]):
            panels.append((after, 'after, enlarged', narrow))
    spans = [
        (x.start * x_factor, x.end * x_factor)
        for x in locations
        if (x.level, x.station or None, x.axis) == (series.level, series.station or None, series.axis)
    ]
    with matplotlib.rc_context(_STYLE):
        figure = _figure(PLOTS.series_height)
        grid = figure.add_gridspec(2, len(panels), height_ratios=(1.0, PLOTS.legend_share))
        axes = [figure.add_subplot(grid[0, i]) for i in range(len(panels))]
        lower = figure.add_subplot(grid[1, :])
        lower.set_axis_off()
        for number, (axis, (values, title, limits)) in enumerate(zip(axes, panels, strict=True)):
            _points(axis, x, values, std)
            if explained and number == 0:
                at, of = _means(x, curve)
                marker = 'o' if len(at) <= PLOTS.bars and len(at) < len(x) else None
                axis.plot(at, of, color=CURVE, linewidth=1.6, marker=marker, markersize=4, zorder=4, label=words.curve)
            axis.axhline(0.0, color='black', linewidth=0.6)
            axis.set_ylim(limits)
            for span in spans if number == 0 else ():
                axis.plot(
                    span, (0.0, 0.0), color=SPAN, linewidth=9, solid_capstyle='butt', zorder=5,
                    transform=axis.get_xaxis_transform(), label='location of the misfit' if span is spans[0] else None,
                )  # fmt: skip
            axis.set_title(title)
            axis.set_xlabel(_label(name, x_unit))
        axes[0].set_ylabel(_label('residual', y_unit))
        handles, labels = axes[0].get_legend_handles_labels()
        # matplotlib 3.6 has no legend outside of the axes, so it takes the lower row of a grid
        lower.legend(handles, labels, loc='center', ncols=len(labels), borderaxespad=0.0)
        return _png(figure)


def _limits(*shown: np.ndarray) -> tuple[float, float]:
    """Return limits of an axis that hold all that is shown, and zero."""
    values = np.concatenate([np.append(v[np.isfinite(v)], 0.0) for v in shown])
    margin = PLOTS.margin * float(np.ptp(values)) or 1.0
    return float(values.min()) - margin, float(values.max()) + margin


def _points(axis: Axes, x: np.ndarray, values: np.ndarray, std: np.ndarray) -> None:
    at, mean = _means(x, values)
    repeated = len(at) <= len(x) / 3
    if len(x) <= PLOTS.bars and not repeated:
        axis.errorbar(
            x, values, std, fmt='o', markersize=3.5, color=DATA, elinewidth=0.9, zorder=3, label='data, ± 1 std'
        )
        return
    _, variance = _means(x, std**2)
    width = 2.0 * np.sqrt(variance)
    axis.fill_between(at, -width, width, color=NOISE, linewidth=0, zorder=1, label='noise, ± 2 std')
    axis.plot(
        x, values, '.', color=DATA, markersize=2.5, alpha=0.5 if repeated else 0.7, zorder=2,
        label='data',
    )  # fmt: skip
    if repeated and len(at) <= PLOTS.bars:
        _, weight = _means(x, np.ones_like(x), total=True)
        axis.errorbar(
            at, mean, np.sqrt(variance / weight), fmt='D', markersize=4, color='black', zorder=3,
            label='mean, ± 1 std of the mean',
        )  # fmt: skip


def _means(x: np.ndarray, values: np.ndarray, total: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return the distinct x in order, (n,), and the mean (or sum) of the values at each, (n,)."""
    at, index = np.unique(x, return_inverse=True)
    summed = np.bincount(index, values, len(at))
    return at, summed if total else summed / np.bincount(index, minlength=len(at))


def _largest(values: np.ndarray) -> float:
    finite = np.abs(values)[np.isfinite(values)]
    return float(finite.max()) if len(finite) else 0.0


def _label(words: str, unit: str) -> str:
    return f'{words} [{unit}]' if unit else words


def held_out(fit: Fit) -> bytes:
    """Return misfit per degree of freedom before and after, on the fitted and on the held-out sweeps."""
    rows = (('fitted sweeps', fit.fitted), ('held-out sweeps', fit.held_out))
    with matplotlib.rc_context(_STYLE):
        figure = _figure(PLOTS.held_out_height)
        axis = figure.subplots()
        axis.axvline(1.0, color='black', linewidth=1.0)
        for height, (_, figures) in enumerate(rows):
            before, after = figures.before, figures.after
            axis.plot([before, after], [height, height], color='#999999', linewidth=2.0, zorder=1)
            first = height == 0
            axis.plot(before, height, 'o', color=CURVE, markersize=9, label='before' if first else None)
            axis.plot(after, height, 'o', color=DATA, markersize=9, label='after' if first else None)
        values = [v for _, f in rows for v in (f.before, f.after) if math.isfinite(v) and v > 0.0]
        axis.set_xscale('log')
        axis.set_xlim(min([0.8, *(0.9 * v for v in values)]), max([1.5, *(1.3 * v for v in values)]))
        _plain_ticks(axis)
        axis.set_yticks(range(len(rows)), [name for name, _ in rows])
        axis.set_ylim(len(rows) - 0.5, -0.5)
        axis.set_xlabel('misfit per degree of freedom, 1 = noise')
        axis.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
        return _png(figure)


def _plain_ticks(axis: Axes) -> None:
    low, high = axis.get_xlim()
    steps = (1.0, 2.0, 5.0) if high / low > 4.0 else (0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5, 1.7, 2.0, 2.5, 3.0)
    ticks = sorted({s * 10.0**e for e in range(-3, 8) for s in steps if low <= s * 10.0**e <= high})
    axis.xaxis.set_major_locator(FixedLocator(ticks))
    axis.xaxis.set_minor_locator(NullLocator())
    axis.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f'{v:g}'))
