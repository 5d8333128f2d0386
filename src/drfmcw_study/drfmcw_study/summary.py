"""What a Monte Carlo study found: statistics per point, as table, CSV, JSON and plot."""

import csv
import dataclasses
import io
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.sweep import Mode
from drfmcw_ros.commands.cli import write_atomically

from .points import distance_and_mode, settings
from .trials.moments import Moments
from .trials.results import ResultDirectory


@dataclasses.dataclass(frozen=True)
class PointStatistics:
    """Statistics of the trials at one point; outliers are left out of all but their own number, flagged ones are not.

    An outlier is a range further than one range cell, c / (2 B), from the middle one of the point's first batch: not
    the line was found but something else. A systematic error, however large, makes no outliers.
    """

    varied: Mapping[str, str]  # key: value, as given
    mode: Mode
    true_range: float  # [m]
    n: int
    bias: float  # mean range minus true range [m]
    bias_error: float  # its standard error [m]
    std: float  # [m]
    predicted_std: float  # root mean square of what was reported with the ranges [m]
    chi_square: float  # mean of (error / reported standard deviation)^2: 1 where the reported ones are true [1]
    outliers: int
    flagged: int  # trials with any flag

    def as_object(self) -> dict[str, Any]:
        """Return it JSON-ready, in SI units; what is not known is None."""
        values = dataclasses.asdict(self) | {'mode': self.mode.short_name}
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}


def summarise(results: ResultDirectory) -> list[PointStatistics]:
    """Return the statistics of a finished study, one batch in memory at a time.

    Raises:
        StudyStopped: the study is not finished.
    """
    return [_point(results, index) for index in range(len(results.study.points))]


def _point(results: ResultDirectory, index: int) -> PointStatistics:
    point = results.study.points[index]
    scenario, _, _ = settings(point)
    true_range, mode = distance_and_mode(scenario)
    cell = SPEED_OF_LIGHT / (2.0 * abs(scenario.waveform.bandwidth))
    error, variance, chi_square = Moments(), Moments(), Moments()
    outliers, flagged, middle = 0, 0, None
    for arrays in results.batches(index):
        errors = arrays['range'] - arrays['true_range']
        if middle is None:
            finite = errors[np.isfinite(errors)]
            middle = float(np.median(finite)) if len(finite) else 0.0
        near = np.abs(errors - middle) <= cell  # NaN is not
        outliers += int(np.count_nonzero(~near))
        flagged += int(np.count_nonzero(arrays['flags']))
        errors, reported = errors[near], arrays['range_std'][near] ** 2
        error = error.merge(Moments.of(errors))
        variance = variance.merge(Moments.of(reported))
        chi_square = chi_square.merge(Moments.of(errors**2 / reported))
    known = error.n > 0
    return PointStatistics(
        varied=point['varied'],
        mode=mode,
        true_range=true_range,
        n=error.n,
        bias=error.mean if known else math.nan,
        bias_error=error.standard_error,
        std=error.std,
        predicted_std=math.sqrt(variance.mean) if known else math.nan,
        chi_square=chi_square.mean if known else math.nan,
        outliers=outliers,
        flagged=flagged,
    )


def table(rows: Sequence[PointStatistics], title: str) -> Table:
    """Return the rows as a table for the terminal, in metres and millimetres."""
    shown = Table(
        title=f'{escape(title)}: ranges in m, errors in mm',
        title_justify='left',
        header_style='bold',
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    columns: dict[str, list[str]] = {
        key: [escape(row.varied[key]) for row in rows] for key in rows[0].varied if key != 'distance'
    }
    columns |= {
        'mode': [row.mode.short_name for row in rows],
        'true range': [f'{row.true_range:.3f}' for row in rows],
        'n': [str(row.n) for row in rows],
        'bias': [_number(row.bias * 1e3, '+.3f') for row in rows],
        '±': [_number(row.bias_error * 1e3, '.3f') for row in rows],
        'std': [_number(row.std * 1e3, '.3f') for row in rows],
        'predicted': [_number(row.predicted_std * 1e3, '.3f') for row in rows],
        'chi²/n': [_number(row.chi_square, '.3f') for row in rows],
        'outliers': [str(row.outliers) for row in rows],
        'flagged': [str(row.flagged) for row in rows],
    }
    for name in columns:
        shown.add_column(escape(name), justify='left' if name == 'mode' else 'right', no_wrap=True)
    for cells in zip(*columns.values(), strict=True):
        shown.add_row(*cells)
    return shown


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else '-'


def json_text(rows: Sequence[PointStatistics]) -> str:
    """Return the rows as a JSON list of objects, in SI units."""
    return json.dumps([row.as_object() for row in rows], indent=2) + '\n'


def csv_text(rows: Sequence[PointStatistics]) -> str:
    """Return the rows as CSV with a header line, the varied keys first, in SI units."""
    objects = [row.as_object() for row in rows]
    flat = [{**{f'set:{k}': v for k, v in o.pop('varied').items()}, **o} for o in objects]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(flat[0]), lineterminator='\n')
    writer.writeheader()
    writer.writerows(flat)
    return text.getvalue()


def figure(rows: Sequence[PointStatistics], title: str) -> Any:
    """Return a matplotlib figure: bias with two standard errors, and both standard deviations.

    The horizontal axis is the first varied key whose values are numbers, else the true range; every combination of
    the others is a curve.
    """
    import matplotlib  # here: it takes a third of a second to import, and only plots need it

    matplotlib.use('Agg')
    from matplotlib import pyplot

    numbers = [key for key in rows[0].varied if all(_is_number(row.varied[key]) for row in rows)]
    across = numbers[0] if numbers else 'distance'
    curves: dict[str, list[PointStatistics]] = {}
    for row in rows:
        label = ', '.join(f'{k}={v}' for k, v in row.varied.items() if k != across)
        curves.setdefault(label, []).append(row)
    shown, (bias_axis, std_axis) = pyplot.subplots(2, 1, figsize=(10, 8), layout='constrained', sharex=True)
    shown.suptitle(title, fontsize=14)
    for number, (label, members) in enumerate(curves.items()):
        x = [row.true_range if across == 'distance' else float(row.varied[across]) for row in members]
        color = f'C{number % 10}'
        bias = [row.bias * 1e3 for row in members]
        bias_axis.errorbar(x, bias, [2e3 * row.bias_error for row in members], fmt='o-', ms=4, capsize=3, color=color)
        std_axis.plot(x, [row.std * 1e3 for row in members], 'o', ms=4, color=color, label=f'{label} found'.strip())
        predicted = [row.predicted_std * 1e3 for row in members]
        std_axis.plot(x, predicted, '-', color=color, label=f'{label} reported'.strip())
    bias_axis.axhline(0.0, color='0.5', linewidth=0.8)
    bias_axis.set_ylabel('bias, two standard errors [mm]')
    std_axis.set_ylabel('standard deviation [mm]')
    std_axis.set_xlabel('distance [m]' if across == 'distance' else across)
    std_axis.set_ylim(bottom=0.0)
    std_axis.legend(fontsize='small', ncols=2)
    for axis in (bias_axis, std_axis):
        axis.grid(alpha=0.3)
    return shown


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def write_plot(rows: Sequence[PointStatistics], title: str, path: Path | str) -> None:
    """Write the figure as PNG, SVG or PDF, by the name's ending (PNG where it has none)."""
    kind = Path(path).suffix.lstrip('.').lower()
    image = io.BytesIO()
    figure(rows, title).savefig(image, format=kind if kind in ('svg', 'pdf') else 'png', dpi=120)
    write_atomically(path, image.getvalue())
