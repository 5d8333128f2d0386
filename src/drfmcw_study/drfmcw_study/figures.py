"""Plots of the reproduction: arrays in SI units in, matplotlib figures out, all in one style."""

import contextlib
import io
from collections.abc import Iterator, Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

PAPER = '#b03030'  # what the paper states
PREDICTED = 'black'
COLORS = {'A': '#1f77b4', 'B': '#e08214'}  # of the noise floors
SECOND = '#2a8a4a'
_STYLE = {
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


def _axes(rows: int, columns: int, height: float, **options) -> tuple[Figure, np.ndarray]:
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


def spectra(panels: Sequence[dict]) -> Figure:
    """Return Fig. 6: IF spectra of one station.

    Args:
        panels: one per situation: `title`, `frequency` [Hz], `example` [dBm] of one sweep, and for each noise floor in
            `mean` and `predicted` an array [dBm]; `skirt` [dBm] of the phase noise alone; `floors` {name: level [dBm]}.
    """
    with style():
        figure, axes = _axes(1, len(panels), 4.4, sharey=True)
        for axis, panel in zip(axes[0], panels, strict=True):
            f = panel['frequency'] * 1e-3
            axis.plot(f, panel['example'], color='0.72', linewidth=0.5, label='one sweep, floor B')
            for name, values in panel['mean'].items():
                axis.plot(f, values, color=COLORS[name], label=f'mean of {panel["count"]} sweeps, floor {name}')
            for number, values in enumerate(panel['predicted'].values()):
                label = 'predicted: line, skirts, floor' if not number else None
                axis.plot(f, values, color=PREDICTED, linestyle=(0, (4, 3)), linewidth=0.9, label=label)
            axis.plot(f, panel['skirt'], color=SECOND, linestyle=':', label='phase-noise skirt alone')
            for name, level in panel['floors'].items():
                axis.axhline(level, color=COLORS[name], linestyle='-.', linewidth=0.7)
                axis.annotate(
                    f'noise floor {name}', (0.01, level), xycoords=('axes fraction', 'data'), color=COLORS[name],
                    fontsize=8, va='top', xytext=(0, -3), textcoords='offset points',
                    bbox={'facecolor': 'white', 'alpha': 0.7, 'linewidth': 0, 'pad': 0.5},
                )  # fmt: skip
            axis.set_title(panel['title'])
            axis.set_xlabel('IF frequency [kHz]')
            axis.set_xlim(0.0, f[-1])
        axes[0, 0].set_ylabel('power in 1.5 kHz (Hann, 1 ms) [dBm]')
        axes[0, 0].set_ylim(-135.0, -35.0)
        axes[0, 0].legend(loc='upper left')
    return figure


def offset_sweeps(panels: Sequence[dict]) -> Figure:
    """Return Fig. 7: bias and standard deviation over T_off and over f_o,off.

    Args:
        panels: one per swept quantity: `label` of the abscissa, `x`, and for each noise floor in `bias`, `bias_error`,
            `std`, `std_error` and `predicted` an array [m]; `bound` {floor: array [m]}.
    """
    with style():
        figure, axes = _axes(2, len(panels), 6.0, sharex='col', sharey='row')
        for column, panel in enumerate(panels):
            top, bottom = axes[:, column]
            for name in panel['bias']:
                color = COLORS[name]
                shift = {'A': -0.006, 'B': 0.006}[name] * np.ptp(panel['x'])
                top.errorbar(
                    panel['x'] + shift, panel['bias'][name] * 1e3, 3e3 * panel['bias_error'][name], fmt='o',
                    color=color, capsize=2, label=f'simulated, floor {name}, 3 standard errors',
                )  # fmt: skip
                bottom.errorbar(
                    panel['x'], panel['std'][name] * 1e3, 3e3 * panel['std_error'][name], fmt='o', color=color,
                    capsize=2, label=f'simulated, floor {name}',
                )  # fmt: skip
                bottom.plot(
                    panel['x'], panel['predicted'][name] * 1e3, '-', color=color, label=f'predicted, floor {name}'
                )
                bottom.plot(
                    panel['x'], panel['bound'][name] * 1e3, ':', color=color, label=f'Cramér-Rao bound, floor {name}'
                )
            top.set_title(panel['title'])
            _paper_band(top, 5.0, 'paper: bias within ±5 mm', column == 0)
            _paper_line(bottom, 1.0, 'paper: below 1 mm' if column == 0 else '')
            bottom.set_xlabel(panel['label'])
        axes[0, 0].set_ylim(-6.5, 6.5)
        axes[1, 0].set_ylim(0.0, 1.6)
        axes[0, 0].set_ylabel('bias relative to T_off = 4 µs [mm]')
        axes[1, 0].set_ylabel('standard deviation [mm]')
        axes[0, 1].legend(loc='lower right')
        axes[1, 1].legend(loc='upper left', ncols=2, fontsize=7.5, bbox_to_anchor=(0.0, 0.98))
    return figure


def reference_offsets(panels: Sequence[dict]) -> Figure:
    """Return Fig. 8: bias and standard deviation over the reference frequency offset of station 1.

    Args:
        panels: one per distance: `title`, `offset` [ppm], `corrected`, `uncorrected`, `unknown` (bias [m]) and their
            `..._error`, `equation` (eq. 20 [m]), `std`, `unknown_std` [m]; `paper` (bias at 40 ppm [m], text).
    """
    with style():
        figure, axes = _axes(2, len(panels), 6.6, sharex=True)
        for column, panel in enumerate(panels):
            top, bottom = axes[:, column]
            x = panel['offset']
            top.plot(x, panel['equation'] * 1e3, color=PREDICTED, linewidth=1.0, label='eq. 20: R (α² - 1) / 2')
            for key, color, marker, label in (
                ('unknown', SECOND, 's', 'α unknown to everything'),
                ('uncorrected', COLORS['B'], 'o', 'eq. 19 left out'),
                ('corrected', COLORS['A'], 'o', 'with α (eq. 19)'),
            ):
                top.errorbar(
                    x, panel[key] * 1e3, 3e3 * panel[key + '_error'], fmt=marker, color=color, capsize=2, label=label,
                    markerfacecolor='none' if key == 'unknown' else color,
                )  # fmt: skip
            limit, text = panel['paper']
            for sign in (-1.0, 1.0):
                top.plot([sign * 40.0], [sign * limit * 1e3], '*', color=PAPER, markersize=10)
            top.annotate(
                text, (40.0, limit * 1e3), xytext=(-8, 0), textcoords='offset points', color=PAPER, fontsize=8,
                ha='right', va='center',
            )  # fmt: skip
            bottom.semilogy(x, panel['unknown_std'] * 1e3, 's', mfc='none', color=SECOND, label='α unknown')
            bottom.semilogy(x, panel['std'] * 1e3, 'o', color=COLORS['A'], label='with α: de-chirped')
            bottom.semilogy(x, panel['predicted'] * 1e3, color=PREDICTED, linewidth=1.0, label='predicted')
            top.set_title(panel['title'])
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


def temperature(
    at: np.ndarray, curves: Sequence[tuple[str, np.ndarray, np.ndarray]], limit: float, points: Sequence[dict]
) -> Figure:
    """Return Fig. 9: drift of the reference oscillators and the range error at 1000 m.

    Args:
        at: temperature (n,) [degC].
        curves: (label, deviation (n,) [1], range error (n,) [m]) of each oscillator model.
        limit: the paper's largest error [m].
        points: simulated, each `temperature`, `bias`, `error` [m], `label`.
    """
    with style():
        figure, axes = _axes(1, 2, 4.2)
        left, right = axes[0]
        for number, (label, deviation, error) in enumerate(curves):
            line = {'color': f'C{number}', 'linestyle': '-' if number else '--', 'label': label}
            left.plot(at, deviation * 5.8e9 * 1e-3, **line)
            right.plot(at, error * 1e3, **line)
        for p in points:
            right.errorbar(
                p['temperature'], p['bias'] * 1e3, 3e3 * p['error'], fmt=p['marker'], color='black', capsize=2,
                markerfacecolor=p['face'], label=p['label'],
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


def weather(at: np.ndarray, panels: Sequence[dict], span: tuple[float, float]) -> Figure:
    """Return Fig. 10: bounds of the range offset at 1000 m over the air temperature.

    Args:
        at: temperature (n,) [degC].
        panels: each `title`, `limits` [mm], and `bounds`: (label, lower (n,), upper (n,) [m], color, filled).
        span: lowest and highest temperature measured [degC].
    """
    with style():
        figure, axes = _axes(1, len(panels), 4.4)
        for axis, panel in zip(axes[0], panels, strict=True):
            for label, lower, upper, color, filled in panel['bounds']:
                if filled:
                    axis.fill_between(at, lower * 1e3, upper * 1e3, color=color, alpha=0.25, linewidth=0, label=label)
                axis.plot(
                    at, np.column_stack([lower, upper]) * 1e3, color=color, linestyle='-' if filled else '--',
                    label=None if filled else [label, '_'],
                )  # fmt: skip
            for value in span:
                axis.axvline(value, color='0.45', linestyle=':', linewidth=1.0)
            _paper_band(axis, 28.0, 'paper: within ±28 mm', below=True)
            axis.set_title(panel['title'])
            axis.set_xlabel('air temperature [°C]')
            axis.set_xlim(at[0], at[-1])
            axis.set_ylim(*panel['limits'])
            axis.legend(loc=panel['legend'])
        axes[0, 0].set_ylabel('range offset at 1000 m [mm]')
        axes[0, 0].annotate(
            'lowest and highest\nmeasured', (span[0], 0.02), xycoords=('data', 'axes fraction'), xytext=(3, 0),
            textcoords='offset points', fontsize=8, color='0.35',
        )  # fmt: skip
    return figure


def distance_sweep(
    distance: np.ndarray, floors: dict[str, dict], change: float, bias: np.ndarray, bias_error: np.ndarray
) -> Figure:
    """Return Fig. 11: standard deviation over distance, and the range error of the calibrated chain.

    Args:
        distance: (n,) [m].
        floors: per noise floor `std`, `std_error`, `predicted`, `bound`, `synchronised`, `synchronised_predicted` [m].
        change: distance beyond which the long-distance mode is used [m].
        bias: mean range error with floor B [m].
        bias_error: its standard error [m].
    """
    with style():
        figure, axes = _axes(2, 1, 8.0, sharex=True, height_ratios=(2, 1))
        top, bottom = axes[:, 0]
        for name, values in floors.items():
            color = COLORS[name]
            top.errorbar(
                distance, values['std'] * 1e3, 3e3 * values['std_error'], fmt='o', color=color, capsize=2,
                label=f'DR-FMCW simulated, floor {name}',
            )  # fmt: skip
            top.plot(distance, values['predicted'] * 1e3, color=color, label=f'DR-FMCW predicted, floor {name}')
            top.plot(distance, values['bound'] * 1e3, ':', color=color, label=f'Cramér-Rao bound, floor {name}')
            top.plot(
                distance, values['synchronised'] * 1e3, 'x', color=color,
                label=f'synchronised station alone, simulated, floor {name}',
            )  # fmt: skip
            top.plot(
                distance, values['synchronised_predicted'] * 1e3, '--', linewidth=0.9, color=color,
                label=f'synchronised, predicted, floor {name}',
            )  # fmt: skip
        top.set_yscale('log')
        top.set_ylim(0.06, 40.0)
        top.set_yticks([0.1, 0.2, 0.5, 1, 2, 5, 10, 20], ['0.1', '0.2', '0.5', '1', '2', '5', '10', '20'])
        _paper_line(top, 12.0, 'paper: never above 12 mm')
        top.set_ylabel('standard deviation of one sweep pair [mm]')
        top.legend(loc='lower right', ncols=2)
        bottom.errorbar(
            distance, bias * 1e3, 3e3 * bias_error, fmt='o', color=COLORS['B'], capsize=2,
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
    distance: np.ndarray, received: np.ndarray, simulated: Sequence[np.ndarray], floors: dict, limits: Sequence[tuple]
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
