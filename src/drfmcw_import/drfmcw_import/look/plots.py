"""Pictures of the page: measures in, PNG out; the same measures give the same bytes."""

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from ..formats.base import Numbers
from .measures import Mark, RampCourse, Spectrum
from .sweeps import StationSweeps

DATA, CURVE, PALE, SPAN = '#2f4b66', '#c8374a', '#9fb3c6', '#e6a817'
_STYLE: Any = {
    'font.size': 10,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.grid': True,
    'axes.axisbelow': True,
    'grid.alpha': 0.25,
    'legend.fontsize': 9,
    'legend.frameon': False,
}
_WIDTH, _DPI, _COLORS = 11.0, 150, 192
_ROWS = 900  # of an image at most
_DENSE, _CLOSE = 150, 24  # turns of the line: more than an image of the whole ramp resolves; of the part enlarged
_LEVELS = 128  # instants at which their level is shown instead
_LOW = 16.0  # a line this many times below the highest frequency is shown enlarged too


def _png(figure: Figure, colors: int = _COLORS) -> bytes:
    """Return a figure as PNG: curves with a palette, a third of the size; images (colors = 0) with all colours."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    image = io.BytesIO()
    if colors:
        drawn = drawn.quantize(colors, dither=Image.Dither.NONE)
    drawn.save(image, 'PNG', optimize=True)
    return image.getvalue()


def _axes(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(_WIDTH, height), dpi=_DPI, layout='constrained')
    return figure, figure.subplots()


def scale(largest: float, units: tuple[tuple[float, str], ...]) -> tuple[float, str]:
    """Return the (factor, unit) that suits the largest value."""
    for factor, unit in units:
        if abs(largest) >= factor:
            return factor, unit
    return units[-1]


def time_unit(largest: float) -> tuple[float, str]:
    """Return the (factor, unit) for a time [s]."""
    return scale(largest, ((1.0, 's'), (1e-3, 'ms'), (1e-6, 'µs')))


def frequency_unit(largest: float) -> tuple[float, str]:
    """Return the (factor, unit) for a frequency [Hz]."""
    return scale(largest, ((1e6, 'MHz'), (1e3, 'kHz'), (1.0, 'Hz')))


def samples(data: StationSweeps, line: float) -> bytes:
    """Return the IF over ramp time and sweep: an image, or curves for one or two sweeps.

    A line [Hz] of many turns is shown enlarged beside it; sweeps of very different power are scaled to their rms.
    """
    codes = data.samples[..., 0].astype(float)
    factor, unit = time_unit(data.sweep.record_duration)
    end = data.sweep.record_duration / factor
    part = ' (I)' if data.iq else ''
    if len(codes) < 3:
        with matplotlib.rc_context(_STYLE):
            figure, axis = _axes(3.4)
            at = np.arange(codes.shape[1]) / data.sweep.sample_rate / factor
            for row, color in zip(codes, (DATA, CURVE), strict=False):
                axis.plot(at, row, color=color, lw=0.9)
            axis.set_xlim(0.0, end)
            axis.set_xlabel(f'ramp time [{unit}]')
            axis.set_ylabel(f'code{part} [LSB]')
            return _png(figure)
    uneven = codes - codes.mean(axis=1, keepdims=True)
    rms = np.sqrt(np.mean(uneven**2, axis=1, keepdims=True))
    label = f'code{part} [LSB]'
    if rms.max() > 2.0 * rms.min() > 0.0:
        codes, label = uneven / rms, f'code{part} over the rms of the sweep'
    step = max(1, len(codes) // _ROWS)
    limit = float(np.percentile(np.abs(codes), 99.5)) or 1.0
    turns = abs(line) * data.sweep.record_duration
    extent = (0.0, end, len(codes) - 0.5, -0.5)
    with matplotlib.rc_context(_STYLE | {'axes.grid': False}):
        figure = Figure(figsize=(_WIDTH, 4.4), dpi=_DPI, layout='constrained')
        axes = figure.subplots(1, 2 if turns > _DENSE else 1, sharey=True, squeeze=False)[0]
        image = axes[-1].imshow(
            codes[::step], cmap='RdBu_r', vmin=-limit, vmax=limit, aspect='auto', interpolation='nearest', extent=extent
        )
        if turns > _DENSE:
            _levels(axes[0], codes[::step], extent, figure)
            half = _CLOSE / 2 * end / turns
            axes[1].set_xlim(end / 2 - half, end / 2 + half)
            axes[1].set_title(f'{_CLOSE} turns of the line', loc='left', fontsize=10)
        for axis in axes:
            axis.set_xlabel(f'ramp time [{unit}]')
            axis.yaxis.set_major_locator(MaxNLocator(integer=True))
            axis.xaxis.set_major_locator(MaxNLocator(6))
        axes[0].set_ylabel('sweep')
        figure.colorbar(image, ax=axes[-1], label=label, pad=0.01)
        return _png(figure, 0)


def _levels(axis: Axes, codes: Numbers, extent: tuple[float, float, float, float], figure: Figure) -> None:
    """Show the level over ramp time: too many turns for the curve itself."""
    length = max(1, codes.shape[1] // _LEVELS)
    whole = codes[:, : codes.shape[1] // length * length].reshape(len(codes), -1, length)
    level = 10.0 * np.log10(np.maximum(np.mean(whole**2, axis=2), 1e-12))
    level -= np.median(level)
    image = axis.imshow(
        level, cmap='viridis', vmin=-12.0, vmax=12.0, aspect='auto', interpolation='nearest', extent=extent
    )
    axis.set_title('level, too many turns for the curve', loc='left', fontsize=10)
    figure.colorbar(image, ax=axis, label='dB about the median', pad=0.01)


def is_low(line: float, highest: float) -> bool:
    """Return True for a line that a picture of all frequencies hides beside 0 Hz; 0: there is no line."""
    return 0.0 < abs(line) < highest / _LOW


def _near(line: float, iq: bool) -> tuple[float, float]:
    """Return the frequencies between which a low line is shown enlarged [Hz]."""
    return (-8.0 * abs(line) if iq else 0.0), 8.0 * abs(line)


def spectrogram(parts: list[tuple[Numbers, Numbers, Numbers]], end: float, line: float) -> bytes:
    """Return the mean short-time spectrum.

    Args:
        parts: (times, frequencies, levels) of all frequencies, and of those near a low line.
        end: of the record [s].
        line: frequency of the line [Hz].
    """
    factor, unit = time_unit(end)
    with matplotlib.rc_context(_STYLE | {'axes.grid': False}):
        figure = Figure(figsize=(_WIDTH, 4.2), dpi=_DPI, layout='constrained')
        axes = figure.subplots(1, len(parts), squeeze=False)[0]
        for number, (axis, (times, frequencies, level)) in enumerate(zip(axes, parts, strict=True)):
            low, high = (frequencies[0], frequencies[-1]) if number == 0 else _near(line, frequencies[0] < 0.0)
            by, hertz = frequency_unit(high)
            shown = (frequencies >= low) & (frequencies <= high)
            top = float(np.percentile(level[shown], 99.9))
            image = axis.pcolormesh(
                times / factor,
                frequencies[shown] / by,
                level[shown],
                cmap='viridis',
                vmin=top - 70.0,
                vmax=top,
                shading='nearest',
                rasterized=True,
            )
            axis.set_facecolor('#eeeeee')
            axis.set_xlim(0.0, end / factor)
            axis.set_ylim(low / by, high / by)
            axis.set_xlabel(f'ramp time [{unit}]')
            axis.set_ylabel(f'IF frequency [{hertz}]')
            figure.colorbar(image, ax=axis, label='level [dBFS]' if axis is axes[-1] else None, pad=0.01)
        return _png(figure, 0)


def spectrum(measured: Spectrum, marked: list[Mark], several: bool) -> bytes:
    """Return the averaged spectrum with what stands where; `several`: the mean of all sweeps differs from the run's."""
    iq = bool(measured.frequency[0] < 0.0)
    spans = [(float(measured.frequency[0]), float(measured.frequency[-1]))]
    if is_low(measured.line, spans[0][1]):
        spans.append(_near(measured.line, iq))
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH, 4.6), dpi=_DPI, layout='constrained')
        axes = figure.subplots(1, len(spans), sharey=True, squeeze=False)[0]
        bottom = float(np.percentile(measured.run, 1)) - 8.0
        peak = max(float(measured.run.max()), measured.level)
        axes[0].set_ylim(bottom, peak + 22.0)
        axes[0].set_ylabel('level [dBFS]')
        for axis, (low, high) in zip(axes, spans, strict=True):
            by, hertz = frequency_unit(high)
            if several:
                axis.plot(measured.frequency / by, measured.all, color=PALE, lw=0.9, label='all sweeps')
            axis.plot(measured.frequency / by, measured.run, color=DATA, lw=0.9, label='line at rest')
            axis.axhline(measured.floor, color=PALE, lw=0.8, ls=':')
            axis.set_xlim(low / by, high / by)
            # beside the enlarged picture the first one names only what it can separate
            few = [m for m in marked if m.name in ('0 Hz', 'Nyquist')] if axis is not axes[-1] else marked
            _label(axis, [m for m in few if low <= m.frequency <= high], by, peak, len(spans))
            axis.set_xlabel(f'IF frequency [{hertz}]')
        if several:
            axes[-1].legend(loc='lower right', frameon=True, framealpha=0.9, edgecolor='none')
        return _png(figure)


def _label(axis: Axes, marked: list[Mark], by: float, peak: float, columns: int) -> None:
    """Name frequencies above the curve, on as many lines as neighbours need."""
    left, right = axis.get_xlim()
    ends: list[float] = []  # of the text on each line
    for mark in sorted(marked, key=lambda m: m.frequency):
        x = mark.frequency / by
        axis.axvline(x, color=CURVE if mark.name == 'line' else SPAN, lw=1.0, ls='-' if mark.name == 'line' else '--')
        width = (right - left) * (0.012 * len(mark.name) + 0.012) * columns
        begin = x if x < right - width else x - width
        row = next((i for i, end in enumerate(ends) if begin > end), len(ends))
        ends[row : row + 1] = [begin + width]
        side = 'left' if begin == x else 'right'
        axis.annotate(
            mark.name,
            (x, peak + 17.0 - 5.0 * (row % 4)),
            xytext=(3 if side == 'left' else -3, 0),
            textcoords='offset points',
            ha=side,
            va='center',
            fontsize=9,
            bbox={'facecolor': 'white', 'edgecolor': 'none', 'pad': 1.0, 'alpha': 0.85},
        )


def course(measured: RampCourse, end: float) -> bytes:
    """Return the beat frequency over ramp time beside what a straight ramp predicts; `end` of the record [s]."""
    factor, unit = time_unit(end)
    by, hertz = frequency_unit(abs(measured.straight))
    at = measured.time / factor
    with matplotlib.rc_context(_STYLE):
        figure, axis = _axes(3.8)
        if np.isfinite(measured.scatter).any():
            low, high = measured.frequency - measured.scatter, measured.frequency + measured.scatter
            axis.fill_between(at, low / by, high / by, color=PALE, alpha=0.6, lw=0, label='scatter from sweep to sweep')
        axis.plot(at, measured.frequency / by, color=DATA, lw=1.3, label='measured')
        axis.axhline(measured.straight / by, color=CURVE, lw=1.2, label='straight ramp, one delay')
        middle = measured.straight / by
        excess = np.abs(measured.frequency / by - middle)
        spread = float(np.nanmedian(measured.scatter)) / by if np.isfinite(measured.scatter).any() else 0.0
        reach = max(1.3 * float(np.percentile(excess, 97)), 1.5 * spread, 0.0005 * abs(middle))
        axis.set_ylim(middle - reach, middle + 1.25 * reach)
        axis.set_xlim(0.0, end / factor)
        axis.set_xlabel(f'ramp time [{unit}]')
        axis.set_ylabel(f'beat frequency [{hertz}]')
        axis.legend(loc='upper right', ncol=3, frameon=True, framealpha=0.9, edgecolor='none')
        return _png(figure)


def histogram(data: StationSweeps) -> bytes:
    """Return how often each code occurs, one panel for I and one for Q, full scale marked."""
    names = ('I', 'Q') if data.iq else ('',)
    low, high = int(data.samples.min()), int(data.samples.max())
    width = max(1, (high - low + 1) // 1024, 4 * (high - low + 1) // len(data.samples[..., 0].ravel()))
    edges = np.arange(low, high + width + 1, width) - 0.5
    with matplotlib.rc_context(_STYLE):
        figure, axis = _axes(3.4)
        for name, part, color in zip(names, np.moveaxis(data.samples, 2, 0), (DATA, CURVE), strict=False):
            counts = np.histogram(part, edges)[0] / width
            axis.stairs(counts, edges, color=color, fill=not data.iq, lw=0.9, label=name or None)
        axis.set_yscale('log')
        axis.set_ylim(bottom=0.5 / width)
        margin = 0.03 * (high - low + 1)
        axis.set_xlim(low - margin, high + margin)
        for rail in (-data.full_scale, data.full_scale - 1):
            axis.axvline(rail, color=SPAN, lw=1.2, ls='--')
        axis.set_xlabel('code [LSB]')
        axis.set_ylabel('samples per code')
        if data.iq:
            axis.legend(loc='upper right')
        return _png(figure)


def power(data: StationSweeps, total: Numbers, line: Numbers) -> bytes:
    """Return total power and that of the strongest line over the sweeps."""
    with matplotlib.rc_context(_STYLE):
        figure, axis = _axes(3.2)
        number = np.arange(len(total))
        style: Any = {'marker': 'o', 'ms': 4.0} if len(total) < 60 else {'marker': '.', 'ms': 2.5}
        axis.plot(number, total, color=PALE, lw=0.8, label='total, without the mean', **style)
        axis.plot(number, line, color=DATA, lw=0.8, label='strongest line', **style)
        low, high = min(total.min(), line.min()), max(total.max(), line.max())
        axis.set_ylim(low - 1.0 - 0.05 * (high - low), high + 1.5 + 0.25 * (high - low))
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
        axis.set_xlabel('sweep')
        axis.set_ylabel('power [dBFS]')
        axis.legend(loc='upper right', ncol=2)
        return _png(figure)


def ranges(time: Numbers, distance: Numbers, std: Numbers, reference: Numbers) -> bytes:
    """Return ranges with their standard deviations over time [s]; below, their errors where a reference is known."""
    factor, unit = time_unit(max(float(time.max(initial=0.0)), 1e-6))
    known = np.isfinite(reference)
    with matplotlib.rc_context(_STYLE):
        rows = 2 if known.any() else 1
        figure = Figure(figsize=(_WIDTH, 3.4 * rows), dpi=_DPI, layout='constrained')
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        _dots(axes[0], time / factor, distance, std, 'measured')
        axes[0].ticklabel_format(useOffset=False)
        axes[0].set_ylabel('range [m]')
        if rows == 2:
            axes[0].plot(time[known] / factor, reference[known], color=CURVE, lw=1.0, label='reference')
            axes[0].legend(loc='best')
            _dots(axes[1], time[known] / factor, (distance - reference)[known] * 1e3, std[known] * 1e3, 'error')
            axes[1].axhline(0.0, color=CURVE, lw=1.0)
            axes[1].set_ylabel('range less reference [mm]')
        axes[-1].set_xlabel(f'time since the first sweep [{unit}]')
        return _png(figure)


def _dots(axis: Axes, x: Numbers, y: Numbers, std: Numbers, label: str) -> None:
    if len(x) <= 400:
        axis.errorbar(x, y, std, fmt='.', color=DATA, ecolor=PALE, ms=4.0, lw=0.8, label=label)
    else:
        axis.plot(x, y, '.', color=DATA, ms=2.0, label=label)
