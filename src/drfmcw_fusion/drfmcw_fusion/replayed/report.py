"""What a replay shows: table, JSON, CSV and a plot of its statistics."""

import csv
import dataclasses
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from drfmcw_ros.commands.cli import write_atomically

from ..integrity.checks import Test
from ..offline import Reference
from ..pipeline import Flag, RangeResult
from .statistics import REFUSED, SettingStatistics, counts, reference_at

_TWICE = 2.0  # times what is reported, from which on a spread is stated
_REASONS = {
    Flag.WEAK_SIGNAL: 'whose line does not stand clear of the noise (WEAK_SIGNAL)',
    Flag.MODE_MISMATCH: 'with different settings at both stations (MODE_MISMATCH)',
    Flag.OUT_OF_LIMITS: 'beyond minimum_range ... maximum_range (OUT_OF_LIMITS)',
}


def as_objects(rows: Sequence[SettingStatistics]) -> list[dict[str, Any]]:
    """Return the rows as JSON-ready objects in SI units; what is not known is None."""
    return [
        {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in dataclasses.asdict(row).items()}
        for row in rows
    ]


def write_json(rows: Sequence[SettingStatistics], path: Path | str) -> None:
    """Write a list of objects with reference, n, bias, std, mode and more [m, s]; '-' prints it."""
    _write(json.dumps(as_objects(rows), indent=2) + '\n', path)


def write_csv(rows: Sequence[SettingStatistics], path: Path | str) -> None:
    """Write the rows as CSV with a header line [m, s]; '-' prints it."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [f.name for f in dataclasses.fields(SettingStatistics)], lineterminator='\n')
    writer.writeheader()
    writer.writerows(as_objects(rows))
    _write(text.getvalue(), path)


def write_results(results: Sequence[RangeResult], path: Path | str) -> None:
    """Write every sweep's range with all its corrections as CSV; '-' prints it."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [f.name for f in dataclasses.fields(RangeResult)], lineterminator='\n')
    writer.writeheader()
    writer.writerows(dataclasses.asdict(r) for r in results)
    _write(text.getvalue(), path)


def _write(text: str, path: Path | str) -> None:
    if str(path) == '-':
        print(text, end='')
    else:
        write_atomically(path, text)


def table(rows: Sequence[SettingStatistics], title: str, velocity: bool = False) -> Table:
    """Return the rows as a table for the terminal, in metres and millimetres.

    Args:
        rows: of all settings.
        title: of the table.
        velocity: show the velocities.
    """
    referenced = any(row.reference is not None for row in rows)
    columns: list[tuple[str, Callable[[SettingStatistics], str]]] = []
    if len({row.pair for row in rows}) > 1:
        columns.append(('pair', lambda row: row.pair))
    columns.append(('mode', lambda row: row.mode))
    if any(len(bands) > 1 for bands in _bands(rows).values()):
        columns.append(('band', _band))
    if referenced:
        columns.append(('reference [m]', lambda row: _number(row.reference, 3)))
    else:
        columns.append(('range [m]', lambda row: _number(row.range, 3)))
        columns.append(('path delay [ns]', lambda row: _number(row.delay * 1e9, 2)))
    if velocity:
        columns.append(('velocity [m/s]', lambda row: _number(row.velocity, 3)))
    columns.append(('n', lambda row: str(row.n)))
    if referenced:
        columns.append(('bias [mm]', lambda row: _millimetres(row.bias, sign=True)))
    columns.append(('std [mm]', lambda row: _millimetres(row.std)))
    columns.append(('reported [mm]', lambda row: _millimetres(row.range_std)))
    columns.append(('left out', lambda row: str(row.excluded or '')))
    shown = Table(title=title, title_justify='left', header_style='bold', box=SIMPLE_HEAD, pad_edge=False)
    for name, _ in columns:
        words = name in ('pair', 'mode', 'band')
        whole = words or name in ('reference [m]', 'range [m]')
        shown.add_column(escape(name), justify='left' if words else 'right', no_wrap=whole)
    for row in rows:
        shown.add_row(*(cell(row) for _, cell in columns))
    return shown


def _bands(rows: Sequence[SettingStatistics]) -> dict[str, dict[str, list[SettingStatistics]]]:
    """Return {pair: {band: rows}}."""
    found: dict[str, dict[str, list[SettingStatistics]]] = {}
    for row in rows:
        found.setdefault(row.pair, {}).setdefault(_band(row), []).append(row)
    return found


def _band(row: SettingStatistics) -> str:
    return f'{row.start_frequency / 1e9:.6g} GHz {row.bandwidth / 1e6:+.6g} MHz'


def _number(value: float | None, digits: int) -> str:
    return f'{value:.{digits}f}' if value is not None and math.isfinite(value) else '-'


def _millimetres(value: float | None, sign: bool = False) -> str:
    if value is None or not math.isfinite(value):
        return '-'
    return f'{value * 1e3:{"+" if sign else ""}.2f}'


def summary(rows: Sequence[SettingStatistics]) -> str:
    """Return one sentence about the whole recording."""
    known = [
        (row.reference, row.bias, row)
        for row in rows
        if row.reference is not None and row.bias is not None and math.isfinite(row.bias) and row.n > 1
    ]
    if not known:
        return f'{sum(row.n for row in rows)} ranges; no reference to compare with.'
    where, largest, _ = max(known, key=lambda entry: abs(entry[1]))
    total = sum(row.n for _, _, row in known)
    rms = math.sqrt(sum(row.n * (bias**2 + row.std**2) for _, bias, row in known) / total)
    return (
        f'{total} ranges from {min(r for r, _, _ in known):.1f} to {max(r for r, _, _ in known):.1f} m: '
        f'rms error {rms * 1e3:.1f} mm, largest bias {largest * 1e3:+.1f} mm at {where:.0f} m.'
    )


def left_out(results: Sequence[RangeResult]) -> str:
    """Return one sentence about the sweeps that count in no statistics, and why, '' where all count."""
    out = [r for r in results if not counts(r)]
    if not out:
        return ''
    heard = [r for r in out if math.isfinite(r.range)]
    why = {text: sum(bool(r.flags & flag) for r in heard) for flag, text in _REASONS.items()}
    refused = [r for r in out if r.flags & REFUSED == REFUSED]
    tests = sorted({str(test.name) for r in refused for test in Test(r.failed_tests)})
    why[f'refused by the integrity tests ({", ".join(tests)})'] = len(refused)
    why['without any line'] = len(out) - len(heard)
    listed = ', '.join(f'{count} {text}' for text, count in why.items() if count)
    return f'Left out: {len(out)} of {len(results)} sweeps: {listed}.'


def mismatch(results: Sequence[RangeResult]) -> str:
    """Return one sentence about lines that contradict a straight ramp, '' where none does."""
    bent = [r for r in results if r.failed_tests & Test.STRAIGHT]
    if not bent:
        return ''
    std = math.sqrt(sum(r.range_std**2 for r in bent) / len(bent))
    return (
        f'In {len(bent)} of {len(results)} sweeps the samples contradict one line of a straight ramp (MODEL_MISMATCH); '
        f'the reported standard deviation, {std * 1e3:.0f} mm there, includes what that may do. ./drfmcw diagnose says '
        'what it is.'
    )


def hopping(results: Sequence[RangeResult]) -> str:
    """Return one sentence about a station's own ranges that hop between lines, '' where none does."""
    own = [r for r in results if r.first_station == r.second_station and counts(r)]
    off = [r for r in own if r.failed_tests & Test.CONTINUITY]
    if not off:
        return ''
    ranges = [r.range for r in own]
    return (
        f'In {len(off)} of {len(own)} sweeps the range hops, between {min(ranges):.2f} and {max(ranges):.2f} m, '
        'farther than a target moves: several lines take turns as the strongest one (MODEL_MISMATCH). Which one is the '
        "target's is not known, so the reported standard deviation includes their distance; --search-range limits "
        'the search.'
    )


def spread(rows: Sequence[SettingStatistics]) -> list[str]:
    """Return sentences about ranges without a reference that spread more than is reported: in one setting, or over all.

    Over the settings of the sweep, each of which has a band of its own, an unmoved target has one range.
    """
    said = []
    for row in rows:
        if row.reference is None and row.scatter > _TWICE * row.range_std:
            said.append(
                f'{row.pair}: from sweep to sweep the ranges around {row.range:.2f} m scatter by '
                f'{row.scatter * 1e3:.3g} mm, {row.scatter / row.range_std:.1f} times what is reported: other lines or '
                'disturbances act on them.'
            )
    for pair, bands in _bands([r for r in rows if r.reference is None and r.n]).items():
        if len(bands) < 2:
            continue
        each = [(_mean([r.range for r in own]), _mean([r.range_std for r in own])) for own in bands.values()]
        (low, one), (high, other) = min(each), max(each)
        apart, reported = high - low, math.hypot(one, other)
        said.append(
            f'{pair}: between the {len(bands)} settings of the sweep the range differs by {apart * 1e3:.4g} mm, '
            f'{100.0 * apart / max(abs(high), 1e-9):.2g} % of it and {apart / reported:.1f} times what is reported'
            + ('.' if apart < _TWICE * reported else ': a target that stood has one range, so a ramp is not as its '
               'settings say.')
        )  # fmt: skip
    return said


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def unknown_velocity(rows: Sequence[SettingStatistics], scales: Mapping[str, float], maximum_velocity: float) -> str:
    """Return one sentence about what a velocity does to the range of a single ramp, '' where none is in doubt.

    Args:
        rows: of all settings.
        scales: range that a velocity adds, of each station that hears itself [s].
        maximum_velocity: that is taken where the ranges show none [m/s].
    """
    own = [r for r in rows if r.pair.split('/')[0] in scales and r.n and r.doppler_std > 0.0]
    if not own:
        return ''
    largest = max(abs(scales[r.pair.split('/')[0]]) for r in own)
    part = max(r.doppler_std for r in own)
    return (
        f'One ramp cannot separate range and velocity: a path that changes by 1 m/s moves the range by '
        f'{largest * 1e3:.3g} mm. The reported standard deviation includes up to {part * 1e3:.3g} mm for the velocity '
        f'that the ranges show, or {maximum_velocity:g} m/s at most where they show none (fusion: maximum_velocity). '
        '--velocity standing leaves that out, --pair combines rising and falling ramps.'
    )


def figure(results: Sequence[RangeResult], reference: Reference, rows: Sequence[SettingStatistics], title: str) -> Any:
    """Return a matplotlib figure: range over time, error against the reference, standard deviation over distance."""
    import matplotlib  # here: it takes a third of a second to import, and only plots need it

    matplotlib.use('Agg')
    from matplotlib import pyplot

    shown, (over_time, error_axis, std_axis) = pyplot.subplots(3, 1, figsize=(10, 11), layout='constrained')
    shown.suptitle(title, fontsize=14)
    start = min(r.stamp for r in results)
    for number, pair in enumerate(sorted({(r.first_station, r.second_station) for r in results})):
        own = [r for r in results if (r.first_station, r.second_station) == pair]
        name, color = '/'.join(pair), f'C{number}'
        stamps = np.array([r.stamp for r in own], dtype=np.int64)
        own_reference = reference.of(name)
        truth = reference_at(own_reference, stamps)
        ranges = np.array([r.range for r in own])
        over_time.plot((stamps - start) * 1e-9, ranges, '.', markersize=2, color=color, label=name)
        if len(own_reference.stamps):
            seconds = (own_reference.stamps - start) * 1e-9
            over_time.plot(seconds, own_reference.ranges, '-', color='0.5', linewidth=0.8, label=f'{name}: reference')
        distance = np.where(np.isfinite(truth), truth, ranges)
        error_axis.plot(distance, (ranges - truth) * 1e3, '.', markersize=2, alpha=0.4, color=color)
        stats = sorted((row for row in rows if row.pair == name and row.n > 1), key=_distance)
        at = [_distance(row) for row in stats]
        if any(row.bias is not None for row in stats):
            error_axis.errorbar(
                at,
                [row.bias * 1e3 if row.bias is not None else math.nan for row in stats],
                [3e3 * row.std / math.sqrt(row.n) for row in stats],
                fmt='o',
                color='black',
                markersize=4,
                capsize=3,
                label=None if number else 'mean of a setting, with 3 standard errors',
            )
        std_axis.plot(at, [row.std * 1e3 for row in stats], 'o', color=color, label=f'{name}: measured')
        expected = [math.hypot(row.range_std, row.reference_std or 0.0) * 1e3 for row in stats]
        instrument = " with the reference's own" if any(row.reference_std for row in stats) else ''
        std_axis.plot(at, expected, '-', linewidth=1, color=color, label=f'{name}: reported{instrument}')
    for axis, x, y in (
        (over_time, 'time [s]', 'range [m]'),
        (error_axis, 'distance [m]', 'error against reference [mm]'),
        (std_axis, 'distance [m]', 'standard deviation [mm]'),
    ):
        axis.set_xlabel(x)
        axis.set_ylabel(y)
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc='best', fontsize=9)
    error_axis.axhline(0.0, color='black', linewidth=0.6)
    errors = [abs(row.bias) + 4 * row.std for row in rows if row.bias is not None and row.n > 1]
    if errors:
        error_axis.set_ylim(-1e3 * max(errors), 1e3 * max(errors))
    else:
        error_axis.text(0.5, 0.5, 'no reference in this recording', ha='center', transform=error_axis.transAxes)
    std_axis.set_ylim(bottom=0.0)
    return shown


def _distance(row: SettingStatistics) -> float:
    return row.range if row.reference is None else row.reference


def write_plot(
    results: Sequence[RangeResult],
    reference: Reference,
    rows: Sequence[SettingStatistics],
    title: str,
    path: Path | str,
) -> None:
    """Write the figure as PNG, SVG or PDF, by the name's ending (PNG where it has none)."""
    kind = Path(path).suffix.lstrip('.').lower()
    image = io.BytesIO()
    figure(results, reference, rows, title).savefig(image, format=kind if kind in ('svg', 'pdf') else 'png', dpi=120)
    write_atomically(path, image.getvalue())
