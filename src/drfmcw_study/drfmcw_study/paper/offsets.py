"""Figs. 7 and 8: start delay, frequency offset, and offset of a reference oscillator."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drfmcw_physics.oscillators import range_bias
from drfmcw_physics.sweep import Mode

from . import figures
from .claims import Claim, millimetres
from .experiments import (
    IF_BAND,
    NOISE_FLOORS,
    Outcome,
    Point,
    Run,
    predict,
    site,
)
from .figures import (
    ReferencePanel,
    SweptFloor,
    SweptPanel,
)
from .section import CHANCE, LABORATORY_DELAY, LABORATORY_PATH, NO_DELAY, NOMINAL, Finished, Section, column, worst

_START_DELAYS = np.arange(0.5e-6, 6.6e-6, 0.5e-6)
_FREQUENCY_OFFSETS = np.arange(0.0, 351e3, 50e3)
_CLEAR = 100e3  # lines nearer to 0 Hz or the Nyquist frequency see their mirror line [Hz]


def fig7() -> Section:
    """Return the section on Fig. 7."""

    def laboratory(floor: str, delay: float, offset: float) -> Point:
        pair = {'frequency_offset': float(offset)}
        scenario = site('cable', LABORATORY_PATH, floor=floor, alphas=NOMINAL, station=NO_DELAY, pair=pair)
        label = f'fig7 {floor} T_off {delay * 1e6:.2f} us, f_o,off {offset / 1e3:.0f} kHz'
        return Point(label, scenario, Mode.SHORT_DISTANCE, float(delay))

    start_delays = {f: [laboratory(f, delay, 0.0) for delay in _START_DELAYS] for f in NOISE_FLOORS}
    offsets = {f: [laboratory(f, LABORATORY_DELAY, offset) for offset in _FREQUENCY_OFFSETS] for f in NOISE_FLOORS}
    sweeps = (start_delays, offsets)
    # f_o,off = 0 is the reference itself: simulated once
    points = {p.label: p for sweep in sweeps for part in sweep.values() for p in part}

    def finish(outcomes: Sequence[Outcome], run: Run) -> Finished:
        by_label = dict(zip(points, outcomes, strict=True))
        titles = (
            ('start delay', 'T_off [µs]', _START_DELAYS * 1e6),
            ('station 2 starts at f_0 - f_o,off', 'f_o,off [kHz]', _FREQUENCY_OFFSETS * 1e-3),
        )
        panels, biases, clear, ratios = [], [], [], []
        for title, sweep in zip(titles, sweeps, strict=True):
            floors = {}
            for floor, part in sweep.items():
                own = [by_label[p.label] for p in part]
                reference = by_label[laboratory(floor, LABORATORY_DELAY, 0.0).label]
                predictions = [predict(p) for p in part]
                error = [np.hypot(o.bias_error, reference.bias_error) if o is not reference else 0.0 for o in own]
                floors[floor] = found = SweptFloor(
                    bias=column(own, 'bias') - reference.bias,
                    bias_error=np.array(error),
                    std=column(own, 'std'),
                    std_error=column(own, 'std_error'),
                    predicted=column(predictions, 'windowed'),
                    bound=column(predictions, 'bound'),
                )
                biases += [(b, e) for b, e in zip(found.bias, found.bias_error, strict=True) if e > 0.0]
                distances = [min(*p.frequencies, IF_BAND - max(p.frequencies)) for p in predictions]
                clear += [o.std for o, d in zip(own, distances, strict=True) if d >= _CLEAR]
                ratios += [o.std / run.expected(p) for o, p in zip(own, predictions, strict=True)]
            panels.append(SweptPanel(*title, floors))
        bias, error = np.array(biases).T
        highest = max(o.std for o in outcomes)
        text = f"""Cable set-up with -40 dBm, references nominal, {LABORATORY_PATH:.0f} m of path. Bias against
T_off = 4 µs: {worst(bias, error)} over {len(bias)} points. Simulated standard deviation over predicted:
{min(ratios):.2f} to {max(ratios):.2f}. Towards 0 Hz and the Nyquist frequency (both ends on the left, the right end
on the right) a line comes near its mirror line, whose phase noise then counts as additive noise: an I/Q receiver
would not show it."""
        agreement = (
            Claim(
                'V-B-1, Fig. 7',
                'bias below ±5 mm with approximately zero mean over T_off and f_o,off',
                worst(bias, error),
                bool(np.abs(bias).max() < 5e-3),
                'T_off and f_o,off cancel as in eqs. 5 and 6; what the paper measured beyond is its hardware',
            ),
            Claim(
                'V-B-1, Fig. 7',
                'standard deviation in the sub-millimetre range',
                f'{millimetres(min(clear), 2)} to {millimetres(max(clear), 2)}, both noise floors, lines at least '
                f'{_CLEAR / 1e3:.0f} kHz off 0 Hz and the Nyquist frequency',
                max(clear) < 1e-3,
                f'nearer than that up to {millimetres(highest, 2)}, from the mirror line',
            ),
        )
        return Finished(figures.offset_sweeps(panels), text, agreement)

    return Section('fig7', 'Start delay and frequency offset', tuple(points.values()), finish)


_OFFSETS = np.arange(-40.0, 41.0, 10.0)  # [ppm]


def fig8() -> Section:
    """Return the section on Fig. 8."""
    paths = (
        ('cable', LABORATORY_PATH, Mode.SHORT_DISTANCE, LABORATORY_DELAY),
        ('gantry', 1000.0, Mode.LONG_DISTANCE, None),
    )
    points = []
    for name, distance, mode, delay in paths:
        for offset in _OFFSETS:
            known = site(name, distance, alphas=(1.0 + 1e-6 * float(offset), 1.0), station=NO_DELAY)
            effects = _reference_only(float(offset), 'master')
            unknown = site(name, distance, alphas=NOMINAL, station=NO_DELAY, effects=effects)
            points.append(Point(f'fig8 {name} {offset:.0f} known', known, mode, delay))
            points.append(Point(f'fig8 {name} {offset:.0f} unknown', unknown, mode, delay))

    def finish(outcomes: Sequence[Outcome], run: Run) -> Finished:
        panels = []
        each = len(points) // len(paths)
        papers = ((2e-3, 'paper: about ±2 mm'), (100e-3, 'paper: more than 100 mm'))
        for number, (path, (stated, statement)) in enumerate(zip(paths, papers, strict=True)):
            part = outcomes[number * each : (number + 1) * each]
            known, unknown = part[::2], part[1::2]
            panels.append(
                ReferencePanel(
                    title=f'{path[1]:.0f} m, {"cable" if number == 0 else "crane, long distance"}',
                    offset=_OFFSETS,
                    corrected=column(known, 'bias'),
                    uncorrected=column(known, 'uncorrected_bias'),
                    error=column(known, 'bias_error'),
                    unknown=column(unknown, 'bias'),
                    unknown_error=column(unknown, 'bias_error'),
                    equation=np.array([range_bias(path[1], 1.0 + 1e-6 * o, 1.0) for o in _OFFSETS]),
                    std=column(known, 'std'),
                    unknown_std=column(unknown, 'std'),
                    predicted=np.array([run.expected(predict(p)) for p in points[number * each :: 2][: each // 2]]),
                    stated=stated,
                    statement=statement,
                )
            )
        corrected = np.concatenate([p.corrected for p in panels])
        error = np.concatenate([p.error for p in panels])
        against = np.concatenate([(p.uncorrected - p.equation) / p.error for p in panels])
        far = panels[1]
        text = f"""Reference of station 1 off by up to 40 ppm, ADC clock nominal, floor B. "Eq. 19 left out": the
stations know α and take the residual chirp k (α1² - α2²) t²/2 off their line, only the range is computed with the
nominal k. That is eq. 20, and the simulation agrees with it within {np.abs(against).max():.1f} standard errors. "α
unknown": the stations use the nominal value, and the residual chirp smears the line over 12 bins at 40 ppm. The
bias is the same, but at 1000 m the standard deviation rises from {millimetres(far.std[-1])} to
{millimetres(far.unknown_std[-1], 0)}. Corrected: {worst(corrected, error)}. Both lines move by 5.8 kHz per ppm,
towards or away from their mirror lines, which causes the slope of the standard deviation at 15 m."""
        found = (
            Claim(
                'V-B-2, Fig. 8',
                'with the individual α the bias is reduced significantly, as eq. 19 says',
                f'corrected: {worst(corrected, error)}; eq. 19 left out: '
                f'{millimetres(far.uncorrected[-1], sign=True)} at 1000 m and +40 ppm',
                bool(np.max(np.abs(corrected) / error) < CHANCE),
                f'without it eq. 20 holds: at most {np.abs(against).max():.1f} standard errors away',
            ),
        )
        return Finished(figures.reference_offsets(panels), text, found)

    return Section('fig8', 'Offset of a reference oscillator', tuple(points), finish)


def _reference_only(deviation: float, station: str = '') -> list[dict[str, Any]]:
    """Return effects that move a reference by `deviation` [ppm], unknown to the calibration, and keep the ADC clock."""
    where = {'station': station} if station else {}
    return [
        {'effect': 'reference_clock_offset', 'deviation': deviation} | where,
        {'effect': 'sample_clock_offset', 'deviation': (1.0 / (1.0 + 1e-6 * deviation) - 1.0) * 1e6} | where,
    ]
