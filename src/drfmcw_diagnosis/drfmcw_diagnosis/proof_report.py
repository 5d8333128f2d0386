"""The report of a proof: tables in Markdown, plots in PNG, every case that went wrong."""

import collections
import csv
import dataclasses
import io
import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy import stats

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.cli import write_atomically

from .judging import OUTCOMES, TOLERATED_SHARE, detected, size
from .proof.cases import GROUPS

_PLOTS = 'proof'  # folder beside the document
_STYLE: Any = {'font.size': 9, 'axes.spines.top': False, 'axes.spines.right': False, 'legend.frameon': False}
_BINS = (0.0, 4.0, 5.5, 7.0, 9.0, 14.0, 20.0, math.inf)  # of d in the tables
_THEORY_90 = 5.85  # d of 90 % detection by a matched filter among the places of ../shared/reference/method.md
_FEW = 30  # rates of fewer cases than this are not worth a curve

Record = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Run:
    """What was run."""

    command: str
    extent: str  # 'quick' or 'full'
    seed: int
    listed: int  # cases in the whole list
    versions: Mapping[str, str]
    quick_share: float


def write_report(folder: Path, run: Run, records: Sequence[Record]) -> None:
    """Write folder/proof.md and its plots.

    Raises:
        ConfigurationError: the place cannot be written.
    """
    plots = folder / _PLOTS
    try:
        plots.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'{plots}: {error.strerror}') from None
    for name, draw in (('confusion', _confusion), ('power', _power), ('pulls', _pulls)):
        with matplotlib.rc_context(_STYLE):
            figure = draw(records)
            data = io.BytesIO()
            FigureCanvasAgg(figure)
            figure.savefig(data, format='png', dpi=110, bbox_inches='tight', metadata={'Software': None})
        write_atomically(plots / f'{name}.png', data.getvalue())
    write_atomically(plots / 'cases.csv', _csv(records))
    write_atomically(folder / 'proof.md', document(run, records))


def interval(successes: int, count: int) -> tuple[float, float]:
    """Return the exact 95 % interval of a rate (Clopper and Pearson)."""
    found = stats.binomtest(successes, count).proportion_ci(0.95, 'exact')
    return float(found.low), float(found.high)


def document(run: Run, records: Sequence[Record]) -> str:
    """Return the report as Markdown."""
    parts = [
        '# Proof of the diagnosis',
        _what(run, records),
        '## By group',
        _groups(records),
        '## False alarms',
        _alarms(records),
        '## Single effects by size',
        _sizes(records),
        '![Share detected against d](proof/power.png)',
        '## Confusion',
        'Rows: what was concealed. Columns: the explanation that the finding puts first.',
        '![What was named for what was concealed](proof/confusion.png)',
        '## Parameters',
        _parameters(records),
        '![Pulls](proof/pulls.png)',
        '## Time',
        _time(records),
        '## Not right, one by one',
        _failures(records),
        '## All cases',
        f'With their seals: [cases.csv]({_PLOTS}/cases.csv).',
    ]
    blocks = '\n\n'.join(parts).split('\n\n')
    return '\n\n'.join(b if b[0] in '#|!' else _wrapped(b) for b in blocks) + '\n'


def _wrapped(text: str) -> str:
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


def _what(run: Run, records: Sequence[Record]) -> str:
    text = (
        'Recordings by a generator that shares no forward code with simulator and diagnosis '
        '(`drfmcw_diagnosis.proof`). The truth of each is sealed and its '
        'SHA-256 announced before the diagnosis starts, in a process of its own that is given nothing but the '
        "recording's path; the seal is opened after.\n\n"
        '| | |\n|---|---|\n'
        f'| command | `{run.command}` |\n| list | {run.extent}, {run.listed} cases |\n| cases run | {len(records)} |\n'
        f'| seed | {run.seed} |\n| code | '
        + ', '.join(f'{name} {version}' for name, version in run.versions.items())
        + ' |'
    )
    if run.extent == 'quick':
        text += (
            '\n\n**This is a quick run, of small recordings (14 x 8 sweep pairs). The full proof (`./drfmcw prove`) '
            'has not been made.** So few cases show that the chain works and where it fails; they measure no rate. '
            f'`./drfmcw prove --quick` ends with status 1 where fewer than {run.quick_share:.0%} are right.'
        )
    elif len(records) < run.listed:
        text += (
            f'\n\n**These are {len(records)} of {run.listed} cases. The full proof (`./drfmcw prove`) has not been '
            'made**; the intervals tell how little so few cases measure.'
        )
    return text


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ['| ' + ' | '.join(head) + ' |', '|' + '---|' * len(head)]
    return '\n'.join([*lines, *('| ' + ' | '.join(row) + ' |' for row in rows)])


def _outcome(record: Record) -> str:
    return record['judgement']['outcome']


def _rate(records: Sequence[Record], is_success: Callable[[Record], bool]) -> str:
    """Return 'k of n, rate (interval)'."""
    if not records:
        return 'none run'
    count = sum(map(is_success, records))
    low, high = interval(count, len(records))
    return f'{count} of {len(records)}: {count / len(records):.0%} ({low:.0%} to {high:.0%})'


def _groups(records: Sequence[Record]) -> str:
    rows = []
    for group in (*GROUPS, 'all'):
        own = [r for r in records if group in (r['group'], 'all')]
        if own:
            counts = collections.Counter(map(_outcome, own))
            right = _rate(own, lambda r: _outcome(r) == 'right').partition(': ')[2]
            rows.append((group, str(len(own)), *(str(counts[o]) for o in OUTCOMES), right))
    text = _table(('group', 'n', *OUTCOMES, 'share right (95 % interval)'), rows)
    return text + (
        '\n\nright: verdict, every effect and its station; undecided: called ambiguous, the truth among the '
        'explanations, where one recording tells; unnamed: an effect of the registry called unexplained; wrong: a name '
        'that is not the truth, or a mismatch where there is none; missed: a mismatch called consistent; failed: no '
        'finding.'
    )


def _is_null(record: Record) -> bool:
    return not record['truth']['effects']


def _alarms(records: Sequence[Record]) -> str:
    nulls = [r for r in records if _is_null(r)]
    kinds = sorted({(r['group'], r['kind']) for r in nulls})

    def is_alarm(record: Record) -> bool:
        return _outcome(record) != 'right'

    rows = [(f'{g}: {k}', _rate([r for r in nulls if (r['group'], r['kind']) == (g, k)], is_alarm)) for g, k in kinds]
    text = _table(('recordings without an effect', 'false alarms'), [*rows, ('all', _rate(nulls, is_alarm))])
    return text + (
        '\n\nA wrong noise shape, outliers and drift are mismatches themselves: naming or locating just them is no '
        f'false alarm, if other levels hold no more than {1.0 - TOLERATED_SHARE:.0%} of the excess.'
    )


def _singles(records: Sequence[Record]) -> list[Record]:
    return [r for r in records if r['group'] == 'single']


def _sizes(records: Sequence[Record]) -> str:
    singles = _singles(records)
    edges = list(itertools.pairwise(_BINS))
    cells: dict[str, dict[int, list[Record]]] = collections.defaultdict(lambda: collections.defaultdict(list))
    for record in singles:
        column = next(i for i, (low, high) in enumerate(edges) if low <= size(record['truth']) < high)
        cells[record['kind']][column].append(record)
    used = sorted({column for by_size in cells.values() for column in by_size})

    def cell(own: Sequence[Record]) -> str:
        return f'{sum(_outcome(r) == "right" for r in own)} of {len(own)}' if own else ''

    def head(column: int) -> str:
        low, high = edges[column]
        return f'd {low:g} to {high:g}' if math.isfinite(high) else f'd from {low:g}'

    rows = [(kind, *(cell(cells[kind][c]) for c in used)) for kind in sorted(cells)]
    found = [r for r in singles if detected(r)]
    return (
        'd is the matched signal-to-noise of what is concealed. Cells: right of those run.\n\n'
        + _table(('effect', *map(head, used)), rows)
        + f'\n\nDetected at all: {_rate(singles, detected)}. Named rightly among the detected: '
        + _rate(found, lambda r: _outcome(r) == 'right')
        + '.'
    )


def _all_pulls(records: Sequence[Record]) -> list[Mapping[str, Any]]:
    return [pull for r in records for pull in r['judgement']['pulls']]


def _parameters(records: Sequence[Record]) -> str:
    pulls = _all_pulls(records)
    if not pulls:
        return 'No effect was named rightly, so that there is nothing to compare.'
    by_name = collections.defaultdict(list)
    for p in pulls:
        by_name[p['effect'], p['parameter']].append(p['pull'])
    rows = []
    for (effect, parameter), values in sorted(by_name.items()):
        spread = f'{np.std(values, ddof=1):.2f}' if len(values) > 2 else ''
        inside = f'{sum(abs(v) < 3.0 for v in values)} of {len(values)}'
        rows.append((effect, parameter, f'{np.mean(values):+.2f}', spread, inside))
    every = [p['pull'] for p in pulls]
    middle = 1.4826 * float(np.median(np.abs(every)))
    return (
        'Pull: error in stated standard deviations, where the explanation put first is the truth; without phases.\n\n'
        + _table(('effect', 'parameter', 'mean pull', 'std of pull', 'within 3'), rows)
        + f'\n\nAll {len(every)}: root mean square {math.sqrt(np.mean(np.square(every))):.2f}, 1.48 times the median '
        f'of the magnitudes {middle:.2f} (1 if the stated deviations are true), within 3: '
        f'{np.mean(np.abs(every) < 3.0):.0%}.'
    )


def _time(records: Sequence[Record]) -> str:
    seconds = np.array([r['seconds'] for r in records])
    return (
        f'Of one diagnosis, the start of its process included: median {np.median(seconds):.1f} s, longest '
        f'{seconds.max():.1f} s, with as many at once as the command says and whatever else the machine did.'
    )


def _said(record: Record) -> str:
    if record['finding'] is None:
        return 'nothing: ' + record['judgement']['reason'].replace('|', '/')
    named = record['judgement']['named']
    if not named:
        levels = ', '.join(
            f'{x["level"]} {x["station"] or ""} {x["share"]:.0%}'.replace('  ', ' ')
            for x in record['finding']['locations'][:3]
        )
        return record['finding']['verdict'] + (f' ({levels})' if levels else '')
    more = f' and {len(named) - 4} more' if len(named) > 4 else ''
    return f'{record["finding"]["verdict"]}: ' + '; or '.join(named[:4]) + more


def _concealed(record: Record) -> str:
    def parameters(effect: Mapping[str, Any]) -> str:
        return ', '.join(
            f'{n} {v:.4g} {effect["units"].get(n, "")}'.rstrip() if isinstance(v, int | float) else f'{n} per setting'
            for n, v in effect['parameters'].items()
        )

    if _is_null(record):
        return f'nothing ({record["kind"]})'
    return ' + '.join(
        e['effect'] + (f' ({e["station"]})' if e['station'] else '') + f' [{parameters(e)}; d {e["d"]["total"]:.1f}]'
        for e in record['truth']['effects']
    )


def _failures(records: Sequence[Record]) -> str:
    bad = [r for r in records if _outcome(r) != 'right']
    if not bad:
        return 'None.'
    rows = [(r['name'], _concealed(r), _said(r), f'{_outcome(r)}: {r["judgement"]["reason"]}') for r in bad]
    return _table(('recording', 'truth', 'finding', 'judgement'), [[c.replace('|', '/') for c in row] for row in rows])


def _csv(records: Sequence[Record]) -> str:
    """Return every case as a line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(('recording', 'group', 'kind', 'sha256', 'concealed', 'finding', 'outcome', 'reason', 'time_s'))
    for r in records:
        judged = r['judgement']
        row = (r['name'], r['group'], r['kind'], r['sha256'], _concealed(r), _said(r), judged['outcome'])
        writer.writerow((*row, judged['reason'], f'{r["seconds"]:.1f}'))
    return text.getvalue()


# --- plots ---


def _first_named(record: Record) -> str:
    if record['finding'] is None:
        return 'failed'
    if not record['judgement']['named']:
        return record['finding']['verdict']
    effects = [e['effect'] for e in record['finding']['effects']]
    return effects[0] if len(effects) == 1 else 'several'


def _true_name(record: Record) -> str:
    if _is_null(record):
        return 'nothing'
    if record['group'] == 'pair':
        return 'two effects'
    if not record['truth']['effects'][-1]['registered']:
        return 'outside the registry'
    return record['truth']['effects'][-1]['effect']  # the last one is shown by those before it


def _confusion(records: Sequence[Record]) -> Figure:
    """Return counts by what is concealed and what is named."""
    pairs = collections.Counter((_true_name(r), _first_named(r)) for r in records)
    special = ('nothing', 'two effects', 'outside the registry', 'consistent', 'several', 'unexplained', 'failed')
    rows, columns = (
        sorted({pair[i] for pair in pairs}, key=lambda n: (n in special, special.index(n) if n in special else n))
        for i in (0, 1)
    )
    counts = np.array([[pairs[row, column] for column in columns] for row in rows], float)
    share = counts / counts.sum(axis=1, keepdims=True)
    figure = Figure(figsize=(2.5 + 0.38 * len(columns), 1.5 + 0.28 * len(rows)))
    axes = figure.add_subplot()
    axes.imshow(share, cmap='Blues', vmin=0.0, vmax=1.0, aspect='auto')
    for (i, j), count in np.ndenumerate(counts):
        if count:
            axes.text(j, i, f'{count:.0f}', ha='center', va='center', color='white' if share[i, j] > 0.6 else 'black')
    axes.set_xticks(range(len(columns)), columns, rotation=60, ha='right')
    axes.set_yticks(range(len(rows)), rows)
    axes.set_xlabel('named')
    axes.set_ylabel('concealed')
    return figure


def theoretical_power(d: np.ndarray) -> np.ndarray:
    """Return the chance to detect a known shape of matched signal-to-noise d at that look-elsewhere level."""
    threshold = _THEORY_90 - stats.norm.ppf(0.9)
    return stats.norm.sf(threshold - d) + stats.norm.cdf(-threshold - d)


def _power(records: Sequence[Record]) -> Figure:
    """Return the share detected against d, beside theory."""
    singles = _singles(records)
    figure = Figure(figsize=(7.0, 3.4))
    axes = figure.add_subplot()
    d = np.linspace(0.0, 30.0, 301)
    axes.plot(d, theoretical_power(d), color='0.4', label=f'matched filter, 90 % at d = {_THEORY_90}')
    for right, color, label in ((True, '#2f4b66', 'named rightly'), (False, '#c8374a', 'not named rightly')):
        own = [r for r in singles if (_outcome(r) == 'right') == right]
        axes.plot([size(r['truth']) for r in own], [detected(r) for r in own], '|', ms=9, color=color, label=label)
    if len(singles) >= _FEW:
        for low, high in itertools.pairwise(_BINS):
            own = [r for r in singles if low <= size(r['truth']) < high]
            if own:
                rate = float(np.mean([detected(r) for r in own]))
                reach = np.abs(np.array(interval(sum(map(detected, own)), len(own))) - rate)[:, None]
                middle = float(np.mean([size(r['truth']) for r in own]))
                axes.errorbar(middle, rate, reach, fmt='o', color='#2f4b66', capsize=2)
    axes.set_xlim(0.0, 30.0)
    axes.set_xlabel('matched signal-to-noise d')
    axes.set_ylabel('detected')
    axes.legend(loc='center right')
    return figure


def _pulls(records: Sequence[Record]) -> Figure:
    """Return every pull, by effect and parameter."""
    pulls = _all_pulls(records)
    names = sorted({f'{p["effect"]}: {p["parameter"]}' for p in pulls})
    figure = Figure(figsize=(7.0, 1.2 + 0.24 * max(len(names), 1)))
    axes = figure.add_subplot()
    axes.axvspan(-3.0, 3.0, color='#dde5ee')
    at = [names.index(f'{p["effect"]}: {p["parameter"]}') for p in pulls]
    axes.plot(np.clip([p['pull'] for p in pulls], -10.0, 10.0), at, 'o', ms=3, color='#2f4b66')
    axes.set_yticks(range(len(names)), names)
    axes.set_xlim(-10.5, 10.5)
    axes.set_xlabel('error in stated standard deviations (beyond 10 drawn at 10)')
    return figure
