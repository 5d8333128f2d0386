"""Pictures of a survey: arrays in, PNG files out."""

import io
import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .evidence import PairEvidence
from .findings import DETECTION, PairFinding
from .requirements import Requirements

_COLOURS = '#1d5f8a', '#c2571a'  # of the two stations; distinguishable without colour vision
_LIMIT = '#a62b3c'
_SIZE = 9.6, 3.6  # [in]
_MOST_POINTS = 20_000  # drawn per curve


def _figure(rows: int = 1) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(_SIZE[0], _SIZE[1] * (0.4 + 0.6 * rows)), layout='constrained')
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for each in axes:
        each.grid(alpha=0.3)
        each.spines[['top', 'right']].set_visible(False)
    return figure, list(axes)


def _png(figure: Figure) -> bytes:
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format='png', dpi=130)
    return buffer.getvalue()


def _thinned(count: int) -> slice:
    return slice(None, None, max(1, math.ceil(count / _MOST_POINTS)))


def link_plot(pair: PairEvidence, finding: PairFinding) -> bytes:
    """Return the received power beside free space, and the signal-to-noise ratio beside detection, over distance."""
    figure, (power, ratio) = _figure(2)
    thin = _thinned(len(pair.stamps))
    order = np.argsort(pair.distance)
    for station, colour in zip(pair.stations, _COLOURS, strict=False):
        power.plot(pair.distance[thin], station.power[thin], '.', ms=2, color=colour, label=f'{station.name}, received')
        ratio.plot(pair.distance[thin], station.snr[thin], '.', ms=2, color=colour, label=station.name)
        expected = (station.power - station.excess)[order]
        power.plot(pair.distance[order], expected, '-', lw=1, color=colour, label=f'{station.name}, free space')
    ratio.axhline(DETECTION, color=_LIMIT, ls='--', lw=1, label='detection')
    middles = [b.middle for b in finding.bins]
    ratio.plot(middles, [b.margin + DETECTION for b in finding.bins], '_', ms=12, color='k', label='99 % of the sweeps')
    power.set_ylabel('power [dBm]')
    ratio.set_ylabel('signal to noise [dB]')
    ratio.set_xlabel('distance [m]')
    for axes in (power, ratio):
        axes.legend(fontsize=8, loc='best', markerscale=3)
    return _png(figure)


def error_plot(pair: PairEvidence, finding: PairFinding, requirements: Requirements) -> bytes:
    """Return the error against the reference over distance, with bins and the required accuracy."""
    figure, (axes,) = _figure()
    thin = _thinned(len(pair.stamps))
    usable = pair.usable[thin]
    distance, error = pair.distance[thin], 1e3 * pair.error[thin]
    axes.plot(distance[usable], error[usable], '.', ms=2, color=_COLOURS[0], label='usable ranges')
    axes.plot(
        [b.middle for b in finding.bins], [1e3 * b.bias for b in finding.bins], 'o', ms=5, mfc='w', color='k',
        label='mean of a bin',
    )  # fmt: skip
    if math.isfinite(requirements.accuracy):
        for k, side in enumerate((-1e3, 1e3)):
            label = None if k else 'required accuracy'
            axes.axhline(side * requirements.accuracy, color=_LIMIT, ls='--', lw=1, label=label)
    axes.set_xlabel('distance [m]')
    axes.set_ylabel('error [mm]')
    axes.legend(fontsize=8, loc='best', markerscale=2)
    return _png(figure)


def quality_plot(finding: PairFinding) -> bytes:
    """Return the shares of usable and of disturbed sweeps per distance bin."""
    figure, (axes,) = _figure()
    middles = np.array([b.middle for b in finding.bins])
    width = min((b.end - b.begin for b in finding.bins), default=1.0)
    lost = 100.0 * np.array([1.0 - b.usable for b in finding.bins])
    disturbed = 100.0 * np.array([b.disturbed for b in finding.bins])
    axes.bar(middles - 0.2 * width, lost, 0.38 * width, color=_LIMIT, label='no usable range')
    axes.bar(middles + 0.2 * width, disturbed, 0.38 * width, color=_COLOURS[1], label='bursts or a second line')
    axes.set_ylim(0.0, max(1.0, 1.1 * float(max(lost.max(initial=0.0), disturbed.max(initial=0.0)))))
    axes.set_xlabel('distance [m]')
    axes.set_ylabel('share of sweeps [%]')
    axes.legend(fontsize=8, loc='best')
    return _png(figure)


def conditions_plot(pair: PairEvidence) -> bytes:
    """Return clock difference and board temperatures over time."""
    figure, (clocks, boards) = _figure(2)
    thin = _thinned(len(pair.stamps))
    minutes = (pair.stamps - pair.stamps[0]) * 1e-9 / 60.0
    clocks.plot(minutes[thin], pair.clock_difference[thin], '.', ms=2, color=_COLOURS[0])
    clocks.set_ylabel('clock difference [ppm]')
    for station, colour in zip(pair.stations, _COLOURS, strict=False):
        boards.plot(minutes[thin], station.temperatures[thin], '-', color=colour, label=station.name)
        if station.states_range:
            for bound in station.calibrated_within:
                boards.axhline(bound, color=colour, ls=':', lw=1)
        elif math.isfinite(station.calibrated_at):
            boards.axhline(station.calibrated_at, color=colour, ls=':', lw=1, label=f'{station.name}, calibration')
    boards.set_ylabel('board [degC]')
    boards.set_xlabel('time [min]')
    boards.legend(fontsize=8, loc='best')
    return _png(figure)
