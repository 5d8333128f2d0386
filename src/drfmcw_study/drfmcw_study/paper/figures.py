"""Plots of the reproduction: arrays in SI units in, matplotlib figures out, all in one style."""

import contextlib
import dataclasses
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

PAPER = '#b03030'  # what the paper states
PREDICTED = 'black'
COLORS = {'A': '#1f77b4', 'B': '#e08214'}  # of the noise floors
SECOND = '#2a8a4a'
_STYLE: Any = {
    'font.size': 9.5,
    'axes.titlesize': 10,
    'axes.grid': True,
    'grid.alpha': 0.25,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'legend.fontsize': 8,
    'legend.framealpha': 0.9,
    'lines.linewidth': 1.2,
    'lines.markersize': 4.5,
    'figure.dpi': 100,
    'savefig.dpi': 110,
}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Use the style of these plots inside the block."""
    with matplotlib.rc_context(_STYLE):
        yield


def png(figure: Figure) -> bytes:
    """Return a figure as PNG that holds no date, so that the same numbers give the same file."""
    image = io.BytesIO()
    figure.savefig(image, format='png', metadata={'Software': 'drfmcw'})
    return image.getvalue()


def _axes(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(9.0, height), layout='constrained')
    return figure, np.asarray(figure.subplots(rows, columns, squeeze=False, **options))


def _paper_band(axis: Axes, limit: float, text: str, label: bool = True, below: bool = False) -> None:
    """Mark what the paper states, +-limit, with its text above the upper line or below the lower one."""
    axis.axhspan(-limit, limit, color=PAPER, alpha=0.05, linewidth=0)
    for value in (-limit, limit):
        axis.axhline(value, color=PAPER, linestyle='--', linewidth=1.0)
    if label:
        _note(axis, -limit if below else limit, text, below)


def _paper_line(axis: Axes, value: float, text: str) -> None:
    axis.axhline(value, color=PAPER, linestyle='--', linewidth=1.0)
    _note(axis, value, text)


def _note(axis: Axes, value: float, text: str, below: bool = False) -> None:
    axis.annotate(
        text, (0.01, value), xycoords=('axes fraction', 'data'), xytext=(0, -2 if below else 2),
        textcoords='offset points', color=PAPER, fontsize=8, va='top' if below else 'bottom',
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class SpectrumFloor:
    """Spectra with one noise floor; powers in the resolution bandwidth, arrays (n,)."""

    mean: np.ndarray  # simulated [dBm]
    predicted: np.ndarray  # [dBm]
    level: float  # of the noise floor alone [dBm]


@dataclasses.dataclass(frozen=True)
class SpectrumPanel:
    """IF spectra of one station in one situation."""

    title: str
    count: int  # sweeps in the mean
    frequency: np.ndarray  # (n,) [Hz]
    example: np.ndarray  # of one sweep (n,) [dBm]
    skirt: np.ndarray  # of the phase noise alone (n,) [dBm]
    floors: Mapping[str, SpectrumFloor]
    deviation: float  # largest of the mean from the prediction [dB]


def spectra(panels: Sequence[SpectrumPanel]) -> Figure:
    """Return Fig. 6: IF spectra of one station."""
    with style():
        figure, axes = _axes(1, len(panels), 4.4, sharey=True)
        for axis, panel in zip(axes[0], panels, strict=True):
            f = panel.frequency * 1e-3
            axis.plot(f, panel.example, color='0.72', linewidth=0.5, label='one sweep, floor B')
            for name, floor in panel.floors.items():
                axis.plot(f, floor.mean, color=COLORS[name], label=f'mean of {panel.count} sweeps, floor {name}')
            label: str | None = 'predicted: line, skirts, floor'
            for name, floor in panel.floors.items():
                axis.plot(f, floor.predicted, color=PREDICTED, linestyle=(0, (4, 3)), linewidth=0.9, label=label)
                label = None
                axis.axhline(floor.level, color=COLORS[name], linestyle='-.', linewidth=0.7)
                axis.annotate(
                    f'noise floor {name}', (0.01, floor.level), xycoords=('axes fraction', 'data'), color=COLORS[name],
                    fontsize=8, va='top', xytext=(0, -3), textcoords='offset points',
                    bbox={'facecolor': 'white', 'alpha': 0.7, 'linewidth': 0, 'pad': 0.5},
                )  # fmt: skip
            axis.plot(f, panel.skirt, color=SECOND, linestyle=':', label='phase-noise skirt alone')
            axis.set_title(panel.title)
            axis.set_xlabel('IF frequency [kHz]')
            axis.set_xlim(0.0, f[-1])
        axes[0, 0].set_ylabel('power in 1.5 kHz (Hann, 1 ms) [dBm]')
        axes[0, 0].set_ylim(-135.0, -35.0)
        axes[0, 0].legend(loc='upper left')
    return figure


@dataclasses.dataclass(frozen=True)
class SweptFloor:
    """What was found with one noise floor; arrays (n,) [m]."""

    bias: np.ndarray  # against the reference setting
    bias_error: np.ndarray  # its standard error
    std: np.ndarray
    std_error: np.ndarray
    predicted: np.ndarray  # standard deviation with a Hann window
    bound: np.ndarray  # Cramer-Rao bound


@dataclasses.dataclass(frozen=True)
class SweptPanel:
    """A setting that was varied."""

    title: str
    label: str  # of the abscissa
    x: np.ndarray  # in the unit of the label (n,)
    floors: Mapping[str, SweptFloor]


def offset_sweeps(panels: Sequence[SweptPanel]) -> Figure:
    """Return Fig. 7: bias and standard deviation over T_off and over f_o,off."""
    with style():
        figure, axes = _axes(2, len(panels), 6.0, sharex='col', sharey='row')
        for column, panel in enumerate(panels):
            top, bottom = axes[:, column]
            for name, found in panel.floors.items():
                color = COLORS[name]
                shift = {'A': -0.006, 'B': 0.006}[name] * np.ptp(panel.x)
                top.errorbar(
                    panel.x + shift, found.bias * 1e3, 3e3 * found.bias_error, fmt='o', color=color, capsize=2,
                    label=f'simulated, floor {name}, 3 standard errors',
                )  # fmt: skip
                bottom.errorbar(
                    panel.x, found.std * 1e3, 3e3 * found.std_error, fmt='o', color=color, capsize=2,
                    label=f'simulated, floor {name}',
                )  # fmt: skip
                bottom.plot(panel.x, found.predicted * 1e3, color=color, label=f'Hann predicted, floor {name}')
                bottom.plot(panel.x, found.bound * 1e3, ':', color=color, label=f'Cramér-Rao bound, floor {name}')
            top.set_title(panel.title)
            _paper_band(top, 5.0, 'paper: bias within ±5 mm', column == 0)
            _paper_line(bottom, 1.0, 'paper: below 1 mm' if column == 0 else '')
            bottom.set_xlabel(panel.label)
        axes[0, 0].set_ylim(-6.5, 6.5)
        axes[1, 0].set_ylim(0.0, 1.6)
        axes[0, 0].set_ylabel('bias relative to T_off = 4 µs [mm]')
        axes[1, 0].set_ylabel('standard deviation [mm]')
        axes[0, 1].legend(loc='lower right')
        axes[1, 1].legend(loc='upper left', ncols=2, fontsize=7.5, bbox_to_anchor=(0.0, 0.98))
    return figure


@dataclasses.dataclass(frozen=True)
class ReferencePanel:
    """What an offset of station 1's reference does at one distance; arrays (n,), lengths in m."""

    title: str
    offset: np.ndarray  # [ppm]
    corrected: np.ndarray  # bias with eq. 19
    uncorrected: np.ndarray  # bias of the same sweeps by eqs. 5 and 6
    error: np.ndarray  # standard error of both
    unknown: np.ndarray  # bias with an offset that the calibration lacks
    unknown_error: np.ndarray  # its standard error
    equation: np.ndarray  # bias by eq. 20
    std: np.ndarray  # offset known
    unknown_std: np.ndarray  # offset unknown
    predicted: np.ndarray  # standard deviation, offset known
    stated: float  # the paper's bias at 40 ppm
    statement: str


def reference_offsets(panels: Sequence[ReferencePanel]) -> Figure:
    """Return Fig. 8: bias and standard deviation over the reference frequency offset of station 1."""
    with style():
        figure, axes = _axes(2, len(panels), 6.6, sharex=True)
        for column, panel in enumerate(panels):
            top, bottom = axes[:, column]
            x, limit = panel.offset, panel.stated
            top.plot(x, panel.equation * 1e3, color=PREDICTED, linewidth=1.0, label='eq. 20: R (α² - 1) / 2')
            for bias, error, marker, color, face, label in (
                (panel.unknown, panel.unknown_error, 's', SECOND, 'none', 'α unknown to everything'),
                (panel.uncorrected, panel.error, 'o', COLORS['B'], COLORS['B'], 'eq. 19 left out'),
                (panel.corrected, panel.error, 'o', COLORS['A'], COLORS['A'], 'with α (eq. 19)'),
            ):
                top.errorbar(
                    x, bias * 1e3, 3e3 * error, fmt=marker, color=color, capsize=2, markerfacecolor=face, label=label
                )
            for sign in (-1.0, 1.0):
                top.plot([sign * 40.0], [sign * limit * 1e3], '*', color=PAPER, markersize=10)
            top.annotate(
                panel.statement, (40.0, limit * 1e3), xytext=(-8, 0), textcoords='offset points', color=PAPER,
                fontsize=8, ha='right', va='center',
            )  # fmt: skip
            bottom.semilogy(x, panel.unknown_std * 1e3, 's', mfc='none', color=SECOND, label='α unknown')
            bottom.semilogy(x, panel.std * 1e3, 'o', color=COLORS['A'], label='with α: de-chirped')
            bottom.semilogy(x, panel.predicted * 1e3, color=PREDICTED, linewidth=1.0, label='predicted')
            top.set_title(panel.title)
            top.set_ylim(-1.2e3 * limit, 1.2e3 * limit)
            bottom.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            bottom.yaxis.set_major_formatter('{x:g}')
            bottom.yaxis.set_minor_formatter(NullFormatter())
            bottom.set_xlabel('offset of reference 1 [ppm]')
            carrier = top.secondary_xaxis('top', functions=(lambda p: p * 5.8, lambda k: k / 5.8))
            carrier.set_xlabel('at 5.8 GHz [kHz]', fontsize=8)
            carrier.tick_params(labelsize=8)
        axes[0, 0].set_ylabel('bias [mm]')
        axes[1, 0].set_ylabel('standard deviation [mm]')
        axes[0, 0].legend(loc='lower right')
        axes[1, 0].legend(loc='upper center')
    return figure


@dataclasses.dataclass(frozen=True)
class OscillatorCurve:
    """How the references of both stations drift, and what it does at 1000 m; arrays (n,)."""

    label: str
    deviation: np.ndarray  # [1]
    error: np.ndarray  # of the range [m]


@dataclasses.dataclass(frozen=True)
class Marks:
    """Simulated points of Fig. 9; arrays (n,)."""

    label: str
    temperature: np.ndarray  # [degC]
    bias: np.ndarray  # [m]
    bias_error: np.ndarray  # its standard error [m]
    filled: bool


def temperature(at: np.ndarray, curves: Sequence[OscillatorCurve], limit: float, marks: Sequence[Marks]) -> Figure:
    """Return Fig. 9: drift of the reference oscillators and the range error at 1000 m.

    Args:
        at: temperature (n,) [degC].
        curves: of the oscillators.
        limit: the paper's largest error [m].
        marks: simulated.
    """
    with style():
        figure, axes = _axes(1, 2, 4.2)
        left, right = axes[0]
        for number, curve in enumerate(curves):
            line = {'color': f'C{number}', 'linestyle': '-' if number else '--', 'label': curve.label}
            left.plot(at, curve.deviation * 5.8e9 * 1e-3, **line)
            right.plot(at, curve.error * 1e3, **line)
        for mark in marks:
            right.errorbar(
                mark.temperature, mark.bias * 1e3, 3e3 * mark.bias_error, fmt='o' if mark.filled else 's',
                color='black', capsize=2, markerfacecolor='black' if mark.filled else 'none', label=mark.label,
            )  # fmt: skip
        _paper_band(right, limit * 1e3, 'paper: within ±20 mm')
        left.axvline(25.0, color='0.5', linewidth=0.8)
        left.annotate('calibrated', (25.0, 0.02), xycoords=('data', 'axes fraction'), rotation=90, ha='right',
                      fontsize=8, color='0.4')  # fmt: skip
        left.set_ylabel('offset at 5.8 GHz from 25 °C [kHz]')
        ppm = left.secondary_yaxis('right', functions=(lambda k: k / 5.8, lambda p: p * 5.8))
        ppm.set_ylabel('[ppm]')
        right.set_ylabel('range error at 1000 m [mm]')
        right.set_ylim(-31.0, 45.0)
        for axis in (left, right):
            axis.set_xlabel('temperature of both stations [°C]')
            axis.set_xlim(at[0] - 1, at[-1] + 1)
        right.legend(loc='upper left', fontsize=7.5)
    return figure


@dataclasses.dataclass(frozen=True)
class WeatherBand:
    """Bounds of the range offset; arrays (n,) [m]."""

    label: str
    lower: np.ndarray
    upper: np.ndarray
    color: str
    filled: bool = False


@dataclasses.dataclass(frozen=True)
class WeatherPanel:
    """Bounds by one version of eq. 23."""

    title: str
    limits: tuple[float, float]  # of the ordinate [mm]
    legend: str  # where it stands
    bands: Sequence[WeatherBand]


def weather(at: np.ndarray, panels: Sequence[WeatherPanel], span: tuple[float, float]) -> Figure:
    """Return Fig. 10: bounds of the range offset at 1000 m over the air temperature.

    Args:
        at: temperature (n,) [degC].
        panels: side by side.
        span: lowest and highest temperature measured [degC].
    """
    with style():
        figure, axes = _axes(1, len(panels), 4.4)
        for axis, panel in zip(axes[0], panels, strict=True):
            for band in panel.bands:
                lower, upper = band.lower * 1e3, band.upper * 1e3
                if band.filled:
                    axis.fill_between(at, lower, upper, color=band.color, alpha=0.25, linewidth=0, label=band.label)
                axis.plot(
                    at, np.column_stack([lower, upper]), color=band.color, linestyle='-' if band.filled else '--',
                    label=None if band.filled else [band.label, '_'],
                )  # fmt: skip
            for value in span:
                axis.axvline(value, color='0.45', linestyle=':', linewidth=1.0)
            _paper_band(axis, 28.0, 'paper: within ±28 mm', below=True)
            axis.set_title(panel.title)
            axis.set_xlabel('air temperature [°C]')
            axis.set_xlim(at[0], at[-1])
            axis.set_ylim(*panel.limits)
            axis.legend(loc=panel.legend)
        axes[0, 0].set_ylabel('range offset at 1000 m [mm]')
        axes[0, 0].annotate(
            'lowest and highest\nmeasured', (span[0], 0.02), xycoords=('data', 'axes fraction'), xytext=(3, 0),
            textcoords='offset points', fontsize=8, color='0.35',
        )  # fmt: skip
    return figure


@dataclasses.dataclass(frozen=True)
class DistanceFloor:
    """What was found over the distance with one noise floor; arrays (n,) [m]."""

    bias: np.ndarray  # mean range error
    bias_error: np.ndarray  # its standard error
    std: np.ndarray
    std_error: np.ndarray
    predicted: np.ndarray  # standard deviation with a Hann window
    bound: np.ndarray  # Cramer-Rao bound
    synchronised: np.ndarray  # standard deviation of a perfectly synchronised station alone
    synchronised_predicted: np.ndarray  # with a Hann window


def distance_sweep(distance: np.ndarray, floors: Mapping[str, DistanceFloor], change: float) -> Figure:
    """Return Fig. 11: standard deviation over distance, and the range error of the calibrated chain.

    Args:
        distance: (n,) [m].
        floors: by name of the noise floor.
        change: distance beyond which the long-distance mode is used [m].
    """
    with style():
        figure, axes = _axes(2, 1, 8.0, sharex=True, height_ratios=(2, 1))
        top, bottom = axes[:, 0]
        for name, values in floors.items():
            color = COLORS[name]
            top.errorbar(
                distance, values.std * 1e3, 3e3 * values.std_error, fmt='o', color=color, capsize=2,
                label=f'DR-FMCW simulated, floor {name}',
            )  # fmt: skip
            top.plot(distance, values.predicted * 1e3, color=color, label=f'Hann window predicted, floor {name}')
            top.plot(distance, values.bound * 1e3, ':', color=color, label=f'Cramér-Rao bound, floor {name}')
            top.plot(
                distance, values.synchronised * 1e3, 'x', color=color,
                label=f'synchronised station alone, simulated, floor {name}',
            )  # fmt: skip
            top.plot(
                distance, values.synchronised_predicted * 1e3, '--', linewidth=0.9, color=color,
                label=f'synchronised, Hann predicted, floor {name}',
            )  # fmt: skip
        top.set_yscale('log')
        top.set_ylim(0.06, 40.0)
        top.set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10, 20], ['0.1', '0.2', '0.5', '1', '2', '5', '10', '20'])
        _paper_line(top, 12.0, 'paper: never above 12 mm')
        top.set_ylabel('standard deviation of one sweep pair [mm]')
        top.legend(loc='lower right', ncols=2)
        bottom.errorbar(
            distance, floors['B'].bias * 1e3, 3e3 * floors['B'].bias_error, fmt='o', color=COLORS['B'], capsize=2,
            label='mean error, floor B, 3 standard errors',
        )  # fmt: skip
        _paper_band(bottom, 20.0, 'paper: within ±20 mm')
        bottom.set_ylim(-26.0, 26.0)
        bottom.set_ylabel('range error [mm]')
        bottom.set_xlabel('distance [m]')
        bottom.legend(loc='lower left')
        for axis in (top, bottom):
            axis.axvline(change, color='0.45', linestyle=':', linewidth=1.0)
        bottom.annotate('short distance ', (change, 0.9), xycoords=('data', 'axes fraction'), ha='right', fontsize=8)
        bottom.annotate(' long distance', (change, 0.9), xycoords=('data', 'axes fraction'), fontsize=8)
    return figure


def power(
    distance: np.ndarray,
    received: np.ndarray,
    simulated: tuple[np.ndarray, np.ndarray],
    floors: Mapping[str, tuple[float, float]],
    limits: Sequence[tuple[float, str]],
) -> Figure:
    """Return Fig. 12: received power over distance.

    Args:
        distance: (n,) [m].
        received: predicted power (n,) [dBm].
        simulated: distances [m] and powers as the stations estimated them [dBm].
        floors: {name: (power in the IF band, power in one FFT bin) [dBm]}.
        limits: (range [m], text) at which the waveform ends.
    """
    with style():
        figure, axes = _axes(1, 1, 5.2)
        axis = axes[0, 0]
        axis.semilogx(distance, received, color=PREDICTED, label='link budget of Table 1')
        axis.plot(*simulated, 'o', color=COLORS['B'], label='simulated, as estimated by station 1')
        for name, (band, single) in floors.items():
            axis.axhline(band, color=COLORS[name], label=f'floor {name} in the IF band, 1.024 MHz')
            axis.axhline(single, color=COLORS[name], linestyle=':', label=f'floor {name} in one bin, 1 kHz')
        for at, text in limits:
            axis.axvline(at, color=SECOND, linestyle='-.', linewidth=1.0)
            axis.annotate(
                text, (at, 0.97), xycoords=('data', 'axes fraction'), rotation=90, ha='right', va='top', fontsize=8,
                color=SECOND, bbox={'facecolor': 'white', 'alpha': 0.8, 'linewidth': 0, 'pad': 0.5},
            )  # fmt: skip
        at_end = received[-1]
        axis.plot(distance[-1], at_end, '*', color=PAPER, markersize=10)
        arrow = {'arrowstyle': '<->', 'color': PAPER}
        axis.annotate('', (distance[-1], at_end), (distance[-1], floors['A'][0]), arrowprops=arrow)
        axis.annotate(
            f'paper: 5000 m, margin 10 dB\nfloor A: {at_end - floors["A"][0]:.1f} dB in the IF band\n'
            f'floor B: {at_end - floors["B"][1]:.1f} dB in a bin,\n{at_end - floors["B"][1] - 13.0:.1f} dB above 13 dB',
            (distance[-1], at_end), xytext=(6, -6), textcoords='offset points', color=PAPER, fontsize=8, va='center',
            annotation_clip=False,
        )  # fmt: skip
        axis.set_xlim(10.0, distance[-1])
        axis.set_ylim(-135.0, -20.0)
        ticks = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000]
        axis.set_xticks(ticks, [str(t) for t in ticks])
        axis.minorticks_off()
        axis.set_xlabel('distance [m]')
        axis.set_ylabel('power at the antenna port [dBm]')
        axis.legend(loc='lower left')
    return figure
