"""The report of a proof: figures beside goals, tables in Markdown, plots in PNG, every case that went wrong."""

import collections
import csv
import dataclasses
import io
import itertools
import math
import textwrap
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically

from . import figures
from .cases.plan import GROUPS
from .figures import BINS, Record, by, is_null, is_right, nearest_to_truth, of, outcome, rate
from .judging import OUTCOMES, SEPARABLE, TOLERATED_SHARE
from .plots import PLOTS, draw

_PLOTS = 'proof'  # folder beside the document
_WRONG_SHAPES = ('corner', 'flank', 'bump', 'plateau')  # kinds of nulls
_SMALL = 6.0  # d below which a miss is what theory expects, and listed in short


@dataclasses.dataclass(frozen=True)
class Run:
    """What was run."""

    command: str
    extent: str  # 'quick' or 'full'
    seed: int
    listed: int  # cases in the whole list
    versions: Mapping[str, str]
    quick_share: float
    changed: bool = False  # whether the code was changed while it ran
    times: int = 1  # as many cases of each kind as the full list has


def write_report(folder: Path, run: Run, records: Sequence[Record]) -> None:
    """Write folder/proof.md and its plots.

    Raises:
        ConfigurationError: the folder cannot be written.
    """
    plots = folder / _PLOTS
    try:
        plots.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'{plots}: {error.strerror}') from None
    drawn = draw(records)
    for name in PLOTS:
        if name in drawn:
            write_atomically(plots / f'{name}.png', drawn[name])
        else:  # of another run
            (plots / f'{name}.png').unlink(missing_ok=True)
    write_atomically(plots / 'cases.csv', _csv(records))
    write_atomically(folder / 'proof.md', document(run, records, drawn))


def document(run: Run, records: Sequence[Record], drawn: Collection[str]) -> str:
    """Return the report as Markdown, with the plots that are there."""
    sections: list[tuple[str, str, tuple[tuple[str, str], ...]]] = [
        ('Goals', _goals(records), ()),
        ('By group', _groups(records), ()),
        ('False alarms', _alarms(records), (('nulls', 'Significance of recordings that conceal nothing'),)),
        ('Effects by size', _sizes(records),
         (('power', 'Share detected against d'), ('identification', 'Named, given detection, against d'))),
        ('Confusion', _CONFUSION, (('confusion', 'Effects concealed and effects named'),)),
        ('Parameters', _parameters(records), (('pulls', 'Pulls'),)),
        ('Two effects', _rates_by(records, ('pair', 'strong_pair'), _PAIRS), ()),
        ('Mixtures of any size', _rates_by(records, ('mixture', 'beside_unknown'), _MIXTURES), ()),
        ('Outside the registry', _rates_by(records, ('outside',), _OUTSIDE, _kind), ()),
        ('Left out of the registry', _rates_by(records, ('left_out',), _LEFT_OUT, _kind), ()),
        ('Decoys', _rates_by(records, ('decoy',), _DECOYS), ()),
        ('Ambiguous by construction, and what decides', _ambiguous(records), ()),
        ('Held-out sweeps', _held_out(records), ()),
        ('Time', _time(records), ()),
        ('Not right, one by one', _failures(records), ()),
        ('All cases', f'With their seals: [cases.csv]({_PLOTS}/cases.csv).', ()),
    ]  # fmt: skip
    parts = ['# Proof of the diagnosis', _what(run, records)]
    for title, text, plots in sections:
        if text:
            parts += [f'## {title}', text, *(f'![{words}]({_PLOTS}/{p}.png)' for p, words in plots if p in drawn)]
    blocks = '\n\n'.join(parts).split('\n\n')
    return '\n\n'.join(b if b[0] in '#|!' else _wrapped(b) for b in blocks) + '\n'


def _wrapped(text: str) -> str:
    return textwrap.fill(text, 120, break_long_words=False, break_on_hyphens=False)


def _what(run: Run, records: Sequence[Record]) -> str:
    text = (
        'An independent generator (`drfmcw_proof`) makes the recordings; it shares no forward code with simulator and '
        'diagnosis. The truth of each recording is sealed, and its SHA-256 is published before the diagnosis starts. '
        "The diagnosis runs in a process of its own that gets only the recording's path (and `--without` if effects "
        'are left out of the search). The seal is opened afterwards.\n\n'
        '| | |\n|---|---|\n'
        f'| command | `{run.command}` |\n| list | {_list(run)}, {run.listed} cases |\n| cases run | {len(records)} |\n'
        f'| seed | {run.seed} |\n| code | '
        + ', '.join(f'{name} {version}' for name, version in run.versions.items())
        + ' |'
    )
    if run.changed:
        text += '\n\n**The code was changed while this ran**: cases were diagnosed by different versions.'
    if run.extent == 'quick':
        text += (
            '\n\n**This is a quick run, of small recordings (10 x 8 sweep pairs). The full proof (`./drfmcw prove`) '
            'has not been run.** So few cases show that the chain works and where it fails; they measure no rate. '
            f'`./drfmcw prove --quick` ends with status 1 if fewer than {run.quick_share:.0%} are right.'
        )
    elif len(records) < run.listed:
        text += (
            f'\n\n**These are {len(records)} of the {run.listed} cases of the list ({_list(run)}), '
            f'{len(records) / run.listed:.1%}; the others have not been run.** The intervals show how little so few '
            'cases measure. The seed decides the order of the cases: groups take turns, and so do the effects in each '
            'group.'
        )
    else:
        text += f'\n\nThese are all {run.listed} cases of the list ({_list(run)}).'
    return text


def _list(run: Run) -> str:
    return run.extent if run.times == 1 else f'{run.times} times the {run.extent} one'


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ['| ' + ' | '.join(head) + ' |', '|' + '---|' * len(head)]
    return '\n'.join([*lines, *('| ' + ' | '.join(c.replace('|', '/') for c in row) + ' |' for row in rows)])


def _goals(records: Sequence[Record]) -> str:
    head = ('what', 'goal', 'measured', '95 % interval', 'met')
    return (
        _table(head, (goal.row for goal in figures.goals(records)))
        + '\n\nmet: "yes" or "no" if the whole interval lies on that side of the goal, "open" if more cases are needed.'
    )


def _groups(records: Sequence[Record]) -> str:
    rows = []
    for group in (*GROUPS, 'all'):
        own = [r for r in records if group in (r['group'], 'all')]
        if own:
            counts = collections.Counter(map(outcome, own))
            right = str(rate(figures.judged(own), is_right)).partition(': ')[2]
            rows.append((group, str(len(own)), *(str(counts[o]) for o in OUTCOMES), right))
    text = _table(('group', 'n', *OUTCOMES, 'share right (95 % interval)'), rows)
    return text + (
        '\n\nright: verdict, every effect and its station are right, or the finding is ambiguous among explanations '
        'that the data cannot separate. undecided: called ambiguous with the truth among the explanations, although '
        'the recording separates them. unnamed: an effect of the registry called unexplained. imitated: an '
        'unregistered effect that is indistinguishable from a registered one, so "unexplained" is impossible (neither '
        'right nor wrong, and not in the share right). wrong: a name that is not the truth, or a mismatch where there '
        'is none. missed: a mismatch called consistent. failed: no finding. The generator decides what the data can '
        f'separate: explanations whose recordings differ by at least {SEPARABLE:g} sigma.'
    )


def _alarms(records: Sequence[Record]) -> str:
    nulls = [r for r in records if is_null(r)]
    if not nulls:
        return ''

    def is_alarm(record: Record) -> bool:
        return not is_right(record)

    own = of(records, 'null')
    shapes = [r for r in own if r['kind'] in _WRONG_SHAPES]
    rows = [
        (f'{group}: {kind}', cases) for (group, kind), cases in by(nulls, lambda r: (r['group'], r['kind'])).items()
    ]
    rows += [('**wrong noise shapes together**', shapes)] * bool(shapes) + [('**all of group null**', own)] * bool(own)
    cells = [(name, str(rate(cases, is_alarm)), str(rate(cases, figures.detected))) for name, cases in rows]
    return _table(('recordings without an effect', 'false alarms', 'any mismatch'), cells) + (
        '\n\nA wrong noise shape, outliers and drift are mismatches themselves. Naming or locating just them is no '
        f'false alarm if other levels hold no more than {1.0 - TOLERATED_SHARE:.0%} of the excess. Significances '
        'of recordings with the right noise should follow the straight line; above it alarms are too frequent, below '
        'it too rare. The other recordings hold a significant mismatch.'
    )


def _sizes(records: Sequence[Record]) -> str:
    singles = of(records, 'single', 'strong')
    if not singles:
        return ''
    edges = list(itertools.pairwise(BINS))

    def column(record: Record) -> int:
        return next(i for i, (low, high) in enumerate(edges) if low <= figures.size(record) < high)

    def head(index: int) -> str:
        low, high = edges[index]
        return f'd {low:g} to {high:g}' if math.isfinite(high) else f'd from {low:g}'

    used = sorted({column(r) for r in singles})

    def cells(own: Sequence[Record], is_so: Callable[[Record], bool]) -> list[str]:
        columns = by(own, column)
        found = (rate(columns.get(c, []), is_so) for c in used)
        return [f'{r.successes} of {r.count}' if r.count else '' for r in found]

    rows = [(kind, *cells(own, is_right)) for kind, own in by(singles, lambda r: r['kind']).items()]
    rows.append(('**all: right**', *cells(singles, is_right)))
    rows.append(('**all: detected**', *cells(singles, figures.detected)))
    words = 'd is the matched signal-to-noise of the concealed effect. Cells: right findings of the cases run.\n\n'
    return words + _table(('effect', *map(head, used)), rows)


_CONFUSION = 'Rows: the concealed effects. Columns: the first explanation of the finding.'


def _parameters(records: Sequence[Record]) -> str:
    pulls = figures.pulls(records)
    if not pulls:
        return 'No effect was named correctly, so there is nothing to compare.'
    by_name = collections.defaultdict(list)
    for p in pulls:
        by_name[p['effect'], p['parameter']].append(p['pull'])
    rows = []
    for (effect, parameter), values in sorted(by_name.items()):
        spread = f'{np.std(values, ddof=1):.2f}' if len(values) > 2 else ''
        inside = f'{sum(abs(v) < 3.0 for v in values)} of {len(values)}'
        rows.append((effect, parameter, f'{np.mean(values):+.2f}', spread, inside))
    every = np.abs([p['pull'] for p in pulls])
    coverage = [
        (f'{k:g}', f'{1.0 - 2.0 * stats.norm.sf(k):.1%}', str(figures.Rate(int(np.sum(every < k)), len(every))))
        for k in (1.0, 2.0, 3.0)
    ]
    return (
        'Pull: error over its stated standard deviation, if the first explanation is the truth; without phases.\n\n'
        + _table(('effect', 'parameter', 'mean pull', 'std of pull', 'within 3'), rows)
        + f'\n\nAll {len(every)}: root mean square {math.sqrt(np.mean(every**2)):.2f}; 1.48 times the median '
        f'magnitude is {1.4826 * float(np.median(every)):.2f}. Both are 1 for correct standard deviations.\n\n'
        + _table(('within (standard deviations)', 'normal errors', 'these errors'), coverage)
    )


_PAIRS = (
    'Right: both effects named with their stations, or ambiguous among explanations that the data cannot separate. d '
    'is that of the smaller effect.'
)
_MIXTURES = (
    'Two to four effects of d from 8 to 3000 (uniform logarithm); and one or two beside something outside the '
    'registry. Right: all effects of the registry named with their stations, and none besides. d is that of the '
    'smallest effect, with the others in place.'
)
_IMITATED = (
    f' Imitated: every explanation named changes the data as the truth does, to within {SEPARABLE:g} sigma, so '
    '"unexplained" is impossible. Such cases are not in the rate.'
)
_OUTSIDE = 'Right is "unexplained": no effect of the registry does this.' + _IMITATED
_LEFT_OUT = (
    'Effects of the registry, left out of the search. Right is "unexplained", or an effect that changes the data '
    'equally.' + _IMITATED
)
_DECOYS = 'Conditions that look like a cause but are none, and true causes beside unrelated conditions.'


def _group(record: Record) -> str:
    low, high = {'pair': (12, 25), 'strong_pair': (50, 500)}.get(record['group'], (0, 0))
    if record['group'] in ('mixture', 'beside_unknown'):
        known = [e for e in record['truth']['effects'] if e['registered']]
        return f'{len(known)} effects' + (' and one unknown' if record['group'] == 'beside_unknown' else '')
    return f'd {low} to {high}' if high else record['kind']


def _kind(record: Record) -> str:
    return record['kind']


def _rates_by(
    records: Sequence[Record],
    groups: Sequence[str],
    words: str,
    key: Callable[[Record], str] = _group,
) -> str:
    own = of(records, *groups)
    if not own:
        return ''
    rows = []
    for name, cases in by(own, key).items():
        d = [figures.size(r) for r in cases]
        counts = collections.Counter(map(outcome, cases))
        other = ', '.join(f'{counts[o]} {o}' for o in OUTCOMES[1:] if counts[o])
        span = f'{min(d):.0f}' if max(d) - min(d) < 1.0 else f'{min(d):.0f} to {max(d):.0f}'
        rows.append((name, span, str(rate(figures.judged(cases), is_right)), other))
    return words + '\n\n' + _table(('what', 'd', 'right', 'else'), rows)


def _ambiguous(records: Sequence[Record]) -> str:
    following = {r['truth']['follows']: r for r in of(records, 'decided')}
    rows = []
    for record in of(records, 'ambiguous'):
        after = following.get(record['name'])
        follow_up = (f'{after["kind"]}: {_said(after)}', 'yes' if is_right(after) else 'no') if after else ('', '')
        rows.append((record['name'], _concealed(record), _said(record), *_recommended(record), *follow_up))
    if not rows:
        return ''
    head = ('recording', 'truth', 'finding', 'recommended', 'carried out', 'follow-up and its finding', 'decides')
    return (
        'The generator carries out the recommended measurement and determines by how much its result under the truth '
        f'differs from its result under each rival named. It decides from {SEPARABLE:g} sigma on. A second recording '
        'that must decide follows each case, with the same effects concealed under a new seal. A reference instrument '
        'that has been checked is correct: that follow-up is searched without its effects, and conceals nothing if '
        'the instrument was at fault.\n\n' + _table(head, rows)
    )


def _recommended(record: Record) -> tuple[str, str]:
    """Return what was recommended, and in words by how much it separates the truth from its rivals."""
    measurement = (record['finding'] or {}).get('next_measurement')
    if not measurement:
        return '-', ''
    distances = figures.separated(record)
    if distances is None:
        return measurement, 'not carried out'
    ruled_out = sum(d >= SEPARABLE for d in distances)
    return measurement, f'{ruled_out} of {len(distances)}, by {min(distances):.1f} sigma at least'


def _held_out(records: Sequence[Record]) -> str:
    misfits = figures.held_out(records)
    if not misfits:
        return ''
    low, median, high = np.quantile(misfits, (0.05, 0.5, 0.95))
    return (
        f'Misfit per degree of freedom on held-out sweeps, of {len(misfits)} findings "explained": median '
        f'{median:.3f}, from {low:.3f} to {high:.3f} in nine of ten, from {min(misfits):.3f} to {max(misfits):.3f} in '
        'all. A correct model gives 1.'
    )


def _time(records: Sequence[Record]) -> str:
    seconds = np.array([r['seconds'] for r in records])
    return (
        f'Of one diagnosis, including the start of its process: median {np.median(seconds):.1f} s, longest '
        f'{seconds.max():.1f} s, with as many processes at once as the command states, on a machine that also did '
        'other work.'
    )


def _said(record: Record) -> str:
    if record['finding'] is None:
        return 'nothing: ' + record['judgement']['reason']
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
    def parameter(name: str, value: Any, unit: str) -> str:
        if not isinstance(value, int | float):
            return f'{name} per setting'
        return f'{name} {value:.4g}' + (f' {unit}' if unit != '1' else '')

    def parameters(effect: Mapping[str, Any]) -> str:
        return ', '.join(parameter(n, v, effect['units'].get(n, '1')) for n, v in effect['parameters'].items())

    def size(effect: Mapping[str, Any]) -> str:
        d = effect['d']
        if len(record['truth']['effects']) == 1:
            return f'd {d["total"]:.1f}'
        return f'd {d["alone"]:.1f} alone, {d["beside"]:.1f} beside the others'

    if is_null(record):
        return f'nothing ({record["kind"]})'
    text = ' + '.join(
        e['effect'] + (f' ({e["station"]})' if e['station'] else '') + f' [{parameters(e)}; {size(e)}]'
        for e in record['truth']['effects']
    )
    return text + ''.join(f', searched without {name}' for name in record['truth']['without'])


def _failures(records: Sequence[Record]) -> str:
    bad = [r for r in records if not is_right(r)]
    if not bad:
        return 'None.'
    small = [r for r in bad if outcome(r) == 'missed' and figures.size(r) < _SMALL]
    listed = [r for r in bad if r not in small]
    rows = [
        (r['name'], _concealed(r), _said(r), f'{outcome(r)}: {r["judgement"]["reason"]}{nearest_to_truth(r)}')
        for r in listed
    ]
    text = _table(('recording', 'truth', 'finding', 'judgement'), rows) if rows else ''
    if small:
        short = ', '.join(f'{r["name"]} ({r["judgement"]["truth"]}, d {figures.size(r):.1f})' for r in small)
        text += f'\n\nMissed at d below {_SMALL:g}, where even a matched filter misses some: {short}.'
    return text.strip()


def _csv(records: Sequence[Record]) -> str:
    """Return every case as a line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    head = (
        'recording',
        'group',
        'kind',
        'sha256',
        'concealed',
        'finding',
        'outcome',
        'reason',
        'significance',
        'time_s',
    )
    writer.writerow(head)
    for r in records:
        judged = r['judgement']
        significance = f'{r["finding"]["significance"]:.3g}' if r['finding'] else ''
        row = (r['name'], r['group'], r['kind'], r['sha256'], _concealed(r), _said(r), judged['outcome'])
        writer.writerow((*row, judged['reason'], significance, f'{r["seconds"]:.1f}'))
    return text.getvalue()
