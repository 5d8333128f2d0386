"""Pictures of the page: measures in, PNG out; the same measures give the same bytes."""

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
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


def _png(figure: Figure) -> bytes:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])
    image = io.BytesIO()
    drawn.quantize(_COLORS, dither=Image.Dither.NONE).save(image, 'PNG', optimize=True)
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


def samples(data: StationSweeps) -> bytes:
    """Return the IF over ramp time and sweep: an image, or curves for one or two sweeps."""
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
    step = max(1, len(codes) // _ROWS)
    limit = float(np.percentile(np.abs(codes), 99.5)) or 1.0
    with matplotlib.rc_context(_STYLE | {'axes.grid': False}):
        figure, axis = _axes(4.4)
        image = axis.imshow(
            codes[::step], cmap='RdBu_r', vmin=-limit, vmax=limit, aspect='auto', interpolation='antialiased',
            extent=(0.0, end, len(codes) - 0.5, -0.5),
        )  # fmt: skip
        axis.set_xlabel(f'ramp time [{unit}]')
        axis.set_ylabel('sweep')
        figure.colorbar(image, ax=axis, label=f'code{part} [LSB]', pad=0.01)
        return _png(figure)


def spectrogram(times: Numbers, frequencies: Numbers, level: Numbers, end: float) -> bytes:
    """Return the mean short-time spectrum; `end` is that of the record [s]."""
    factor, unit = time_unit(end)
    by, hertz = frequency_unit(float(np.abs(frequencies).max()))
    top = float(np.percentile(level, 99.9))
    with matplotlib.rc_context(_STYLE | {'axes.grid': False}):
        figure, axis = _axes(4.2)
        image = axis.pcolormesh(
            times / factor, frequencies / by, level, cmap='viridis', vmin=top - 70.0, vmax=top, shading='nearest',
            rasterized=True,
        )  # fmt: skip
        axis.set_xlim(0.0, end / factor)
        axis.set_xlabel(f'ramp time [{unit}]')
        axis.set_ylabel(f'IF frequency [{hertz}]')
        figure.colorbar(image, ax=axis, label='level [dBFS]', pad=0.01)
        return _png(figure)


def spectrum(measured: Spectrum, marked: list[Mark], several: bool) -> bytes:
    """Return the averaged spectrum with what stands where; `several`: the mean of all sweeps differs from the run's."""
    by, hertz = frequency_unit(float(np.abs(measured.frequency).max()))
    with matplotlib.rc_context(_STYLE):
        figure, axis = _axes(4.6)
        if several:
            axis.plot(measured.frequency / by, measured.all, color=PALE, lw=0.9, label='all sweeps')
        axis.plot(measured.frequency / by, measured.run, color=DATA, lw=0.9, label='sweeps with the line at rest')
        bottom = float(np.percentile(measured.run, 1)) - 8.0
        peak = max(float(measured.run.max()), measured.level)
        axis.set_ylim(bottom, peak + 22.0)
        axis.set_xlim(measured.frequency[0] / by, measured.frequency[-1] / by)
        axis.axhline(measured.floor, color=PALE, lw=0.8, ls=':')
        _label(axis, marked, by, peak)
        if several:
            axis.legend(loc='lower right')
        axis.set_xlabel(f'IF frequency [{hertz}]')
        axis.set_ylabel('level [dBFS]')
        return _png(figure)


def _label(axis: Axes, marked: list[Mark], by: float, peak: float) -> None:
    """Name frequencies above the curve, on as many lines as neighbours need."""
    left, right = axis.get_xlim()
    ends: list[float] = []  # of the text on each line
    for mark in sorted(marked, key=lambda m: m.frequency):
        x = mark.frequency / by
        axis.axvline(x, color=CURVE if mark.name == 'line' else SPAN, lw=1.0, ls='-' if mark.name == 'line' else '--')
        width = (right - left) * (0.012 * len(mark.name) + 0.012)
        begin = x if x < right - width else x - width
        row = next((i for i, end in enumerate(ends) if begin > end), len(ends))
        ends[row : row + 1] = [begin + width]
        side = 'left' if begin == x else 'right'
        axis.annotate(
            mark.name, (x, peak + 17.0 - 5.0 * (row % 4)), xytext=(3 if side == 'left' else -3, 0),
            textcoords='offset points', ha=side, va='center', fontsize=9,
            bbox={'facecolor': 'white', 'edgecolor': 'none', 'pad': 1.0, 'alpha': 0.85},
        )  # fmt: skip


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
        reach = max(1.3 * float(np.percentile(excess, 97)), 0.002 * abs(middle))
        axis.set_ylim(middle - reach, middle + 1.25 * reach)
        axis.set_xlim(0.0, end / factor)
        axis.set_xlabel(f'ramp time [{unit}]')
        axis.set_ylabel(f'beat frequency [{hertz}]')
        axis.legend(loc='upper right', ncol=3)
        return _png(figure)


def histogram(data: StationSweeps) -> bytes:
    """Return how often each code occurs, one panel for I and one for Q, full scale marked."""
    names = ('I', 'Q') if data.iq else ('',)
    low, high = int(data.samples.min()), int(data.samples.max())
    width = max(1, (high - low + 1) // 1024)
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
        style = {'marker': 'o', 'ms': 4.0} if len(total) < 60 else {'marker': '.', 'ms': 2.5}
        axis.plot(number, total, color=PALE, lw=0.8, label='total, without the mean', **style)
        axis.plot(number, line, color=DATA, lw=0.8, label='strongest line', **style)
        low, high = min(total.min(), line.min()), max(total.max(), line.max())
        axis.set_ylim(low - 1.0 - 0.05 * (high - low), high + 1.5 + 0.25 * (high - low))
        axis.set_xlabel('sweep')
        axis.set_ylabel('power [dBFS]')
        axis.legend(loc='upper right', ncol=2)
        return _png(figure)


def ranges(time: Numbers, distance: Numbers, std: Numbers, reference: tuple[Numbers, Numbers]) -> bytes:
    """Return ranges with their standard deviations over time [s], and the reference's (times, ranges)."""
    factor, unit = time_unit(max(float(time.max(initial=0.0)), 1e-6))
    with matplotlib.rc_context(_STYLE):
        figure, axis = _axes(3.6)
        if len(time) <= 300:
            axis.errorbar(time / factor, distance, std, fmt='.', color=DATA, ecolor=PALE, ms=4.0, lw=0.8, label='measured')
        else:
            axis.plot(time / factor, distance, '.', color=DATA, ms=2.0, label='measured')
        if len(reference[0]):
            axis.plot(reference[0] / factor, reference[1], color=CURVE, lw=1.0, label='reference')
            axis.legend(loc='upper right')
        axis.ticklabel_format(useOffset=False)
        axis.set_xlabel(f'time since the first sweep [{unit}]')
        axis.set_ylabel('range [m]')
        return _png(figure)
