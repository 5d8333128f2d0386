"""What a station's calibration says, in sentences and as a plot."""

import io
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_ros.commands.cli import write_atomically

from .curve import Curve
from .noise import ReceiverNoise
from .oscillator import OscillatorNoise
from .path import PathCalibration
from .response import LineResponse

NAMES = {'reference': 'reference clock', 'adc': 'ADC clock'}
_START_DELAY = 3.41e-6  # T_off of the paper, for what an ADC clock does to the range [s]
_DISTANCE = 1000.0  # [m]


def clock_sentence(clock: str, curve: Curve) -> str:
    """Return what readings say of a clock: value, shape, 'good to', and what they leave open."""
    at = f'{curve.temperature:.4g} degC'
    good = 1e6 * curve.largest_std
    text = f'{NAMES[clock]}: {1e6 * float(curve.coefficients[0]):+.4f} ppm at {at}'
    if curve.high > curve.low:
        span = np.ptp(curve.at(np.linspace(curve.low, curve.high, 200)))
        text += f', {curve.shape} from {curve.low:.4g} to {curve.high:.4g} degC (varies by {1e6 * float(span):.3g} ppm)'
    text += f'; good to +- {good:.2g} ppm, +- {1e3 * range_std(clock, curve.largest_std):.2g} mm at 1 km'
    if not np.isnan(curve.misfit):
        worst = int(np.argmax(np.abs(curve.residuals)))
        rms = float(np.sqrt(np.mean(curve.residuals**2)))
        text += (
            f'; residuals {1e9 * rms:.2g} ppb rms, the largest {1e9 * float(curve.residuals[worst]):+.2g} ppb '
            f'at {curve.temperatures[worst]:.4g} degC'
        )
    if curve.high == curve.low:
        text += '; at other temperatures unknown: a crystal drifts by some tenths of a ppm per kelvin'
    if curve.widened > 1.0:
        text += f'; the readings scatter {curve.widened:.1f} times as much as the counter should'
    return text + '.'


def range_std(clock: str, std: float) -> float:
    """Return the standard deviation of a range of 1 km by that of one station's clock [1], T_off 3.41 us [m]."""
    if clock == 'reference':
        return std * _DISTANCE
    return std * (_DISTANCE + SPEED_OF_LIGHT * _START_DELAY) / 2.0


def path_sentences(station: str, peer: str, found: PathCalibration) -> list[str]:
    """Return what a known path says of the delay and of T_off, and what it cannot separate."""
    curve = found.delay
    text = f'hardware delay: {1e9 * float(curve.coefficients[0]):.4f} +- {1e9 * curve.largest_std:.2g} ns'
    if curve.shape == 'linear':
        slope, std = 1e12 * curve.coefficients[1], 1e12 * float(curve.covariance[1, 1]) ** 0.5
        text += f' at {curve.temperature:.4g} degC, {slope:+.3f} +- {std:.1g} ps/K'
    else:
        text += f' at {curve.temperature:.4g} degC'
    lines = [f'{text} ({1e3 * curve.largest_std * SPEED_OF_LIGHT:.2g} mm, from {found.sweeps} sweeps).']
    if peer == station:
        return [*lines, f"The delay holds where '{station}' hears itself. In a pair only a path to the peer shows it."]
    lines.append(
        f"The path determines the sum of both stations' delays. How it divides between '{station}' and '{peer}' it "
        f"does not show: '{station}' gets what the calibration of '{peer}' does not state, and the value holds with "
        f"'{peer}' only. Paths between three stations, two at a time, would separate them."
    )
    if curve.shape == 'linear':
        lines.append(
            f"The slope is over the board temperature of '{station}': it holds the peer's, and the cable's, if these "
            'warmed up as well.'
        )
    lines.append(
        f'T_off: {1e9 * found.excess:+.2f} +- {1e9 * found.excess_std:.1g} ns beyond nominal, '
        f'{1e9 * found.jitter:.2g} ns from sweep to sweep (references 1 ppm apart would show as 39 ns).'
    )
    return lines


def noise_sentence(found: ReceiverNoise) -> str:
    """Return what terminated antennas say of the receiver."""
    spread = float(np.ptp(found.gain))
    return (
        f'noise floor: {found.floor:.2f} +- {found.floor_std:.2g} dBm/Hz from {found.sweeps} sweeps; '
        f'response over the IF within {spread:.2g} dB.'
    )


def response_sentence(found: LineResponse) -> str:
    """Return what lines at several T_off say of the receiver, and what they rest on."""
    low, high = (1e-3 * float(found.frequency[i]) for i in (0, -1))
    return (
        f'IF response: the line varies by {float(np.ptp(found.gain)):.2g} +- {float(found.gain_std.max()):.1g} dB at '
        f'{len(found.frequency)} frequencies from {low:.0f} to {high:.0f} kHz (from {found.sweeps} sweeps); it passes '
        "what lies before the receiver's noise too."
    )


def oscillator_sentence(found: OscillatorNoise) -> str:
    """Return what a line says of the oscillators, and what it cannot separate."""
    return (
        f'phase noise: {found.level:.1f} +- {found.level_std:.1g} dBc/Hz at 100 kHz, corner '
        f'{1e-3 * found.corner:.0f} +- {1e-3 * found.corner_std:.1g} kHz, both oscillators taken as equal: '
        'the line shows their sum only.'
    )


def write_plot(curves: dict[str, Curve], title: str, path: Path | str) -> None:
    """Write readings, curves with their standard deviations and residuals as PNG, SVG or PDF, by the name's ending."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, len(curves), figsize=(6 * len(curves), 7), layout='constrained', squeeze=False)
    figure.suptitle(title)
    for column, (clock, curve) in enumerate(curves.items()):
        _plot(axes[0, column], axes[1, column], clock, curve)
    kind = Path(path).suffix.lstrip('.').lower()
    image = io.BytesIO()
    figure.savefig(image, format=kind if kind in ('svg', 'pdf') else 'png', dpi=120)
    pyplot.close(figure)
    write_atomically(path, image.getvalue())


def _plot(above: Any, below: Any, clock: str, curve: Curve) -> None:
    margin = 1.0 if curve.high == curve.low else 0.0
    grid = np.linspace(curve.low - margin, curve.high + margin, 200)
    values, std = curve.at(grid), curve.std(grid)
    above.plot(grid, 1e6 * values, label=f'{curve.shape}')
    above.plot(curve.temperatures, 1e6 * (curve.at(curve.temperatures) + curve.residuals), 'o', label='readings')
    above.set(title=NAMES[clock], xlabel='board temperature [degC]', ylabel='deviation [ppm]')
    above.legend()
    below.fill_between(grid, -1e9 * std, 1e9 * std, alpha=0.3, label='one standard deviation of the curve')
    below.plot(curve.temperatures, 1e9 * curve.residuals, 'o', label='reading minus curve')
    below.set(xlabel='board temperature [degC]', ylabel='residual [ppb]')
    below.legend()
    for axis in (above, below):
        axis.grid(alpha=0.3)
