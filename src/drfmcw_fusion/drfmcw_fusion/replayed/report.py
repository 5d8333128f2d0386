"""What a replay shows: table, JSON, CSV and a plot of its statistics."""

import csv
import dataclasses
import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from drfmcw_ros.cli import write_atomically

from ..integrity.checks import Test
from ..offline import Reference
from ..pipeline import Flag, RangeResult
from .statistics import REFUSED, SettingStatistics, counts, reference_at

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


def table(rows: Sequence[SettingStatistics], title: str) -> Table:
    """Return the rows as a table for the terminal, in metres and millimetres."""
    several = len({row.pair for row in rows}) > 1
    referenced = any(row.reference is not None for row in rows)
    shown = Table(title=title, title_justify='left', header_style='bold', box=SIMPLE_HEAD, pad_edge=False)
    for name, wanted in (
        ('pair', several),
        ('mode', True),
        ('reference [m]', referenced),
        ('range [m]', not referenced),
    ):
        if wanted:
            shown.add_column(escape(name), justify='left' if name in ('pair', 'mode') else 'right', no_wrap=True)
    if not referenced:
        shown.add_column(escape('path delay [ns]'), justify='right')
    for name in ('n', *(('bias [mm]',) if referenced else ()), 'std [mm]', 'reported [mm]', 'left out'):
        shown.add_column(escape(name), justify='right')
    for row in rows:
        cells = [row.pair] if several else []
        cells += [row.mode, _number(row.reference if referenced else row.range, 3)]
        if not referenced:
            cells.append(_number(row.delay * 1e9, 2))
        cells.append(str(row.n))
        if referenced:
            cells.append(_millimetres(row.bias, sign=True))
        shown.add_row(*cells, _millimetres(row.std), _millimetres(row.range_std), str(row.excluded or ''))
    return shown


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
