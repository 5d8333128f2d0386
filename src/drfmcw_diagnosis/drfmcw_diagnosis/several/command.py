"""The part of `drfmcw diagnose` that takes several recordings."""

import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn

from drfmcw_ros.commands.cli import write_atomically
from drfmcw_ros.work.progress import Progress

from ..finding import report as single
from .elsewhere import answered, questions
from .joint import Joint, joined, settled
from .report import as_object, render_html, short_names, terminal
from .running import Order, Outcome, Place, diagnose_each, each


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What is asked for."""

    recordings: tuple[str, ...]
    out: Path | None
    json: str | None
    html: str | None
    pair: str | None
    false_alarm_rate: float
    without: tuple[str, ...]
    command: str


def diagnose_several(wanted: Wanted, place: Place) -> int:
    """Diagnose recordings and say what they share; return the exit status: 2 if one could not be read.

    Raises:
        ConfigurationError: the Dask scheduler does not answer, or a file cannot be written.
    """
    paths = tuple(dict.fromkeys(os.path.abspath(p) for p in wanted.recordings))
    names = short_names(paths)
    if wanted.out is not None:
        wanted.out.mkdir(parents=True, exist_ok=True)
    orders = [
        Order(
            path,
            str(wanted.out / names[path]) if wanted.out is not None else None,
            wanted.pair,
            wanted.false_alarm_rate,
            wanted.without,
            wanted.command,
            paths,
        )
        for path in paths
    ]
    outcomes, joint = _work(orders, wanted, place)
    _write(outcomes, joint, names, wanted, place.jobs)
    Console().print(terminal(outcomes, joint, names))
    bad = [o for o in outcomes if o.diagnosis is None]
    for outcome in bad:
        print(f'drfmcw diagnose: {outcome.error}', file=sys.stderr)
    return 2 if bad else 0


def _work(orders: Sequence[Order], wanted: Wanted, place: Place) -> tuple[list[Outcome], Joint]:
    """Return what became of the recordings, and what they say together, showing the progress."""
    console = Console(stderr=True)
    columns = (TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:

        def note(text: str) -> None:
            console.print(f'drfmcw diagnose: {text}', highlight=False)

        task = bar.add_task('recordings', total=len(orders))
        outcomes = diagnose_each(orders, place, lambda n: bar.update(task, completed=n), note)
        diagnoses = {o.path: o.diagnosis for o in outcomes if o.diagnosis is not None}
        joint = joined(diagnoses)
        asked = questions(diagnoses, joint.shared, wanted.pair)
        if not asked:
            return outcomes, settled(joint, [])
        task = bar.add_task('effects of the same hardware', total=len(asked))
        answers = each(answered, asked, place, lambda n: bar.update(task, completed=n), note)
        return outcomes, settled(joint, [x for found in answers if found is not None for x in found])


def _write(outcomes: Sequence[Outcome], joint: Joint, names: dict[str, str], wanted: Wanted, jobs: int) -> None:
    """Write each recording's files and those of all together."""
    reports = {}
    if wanted.out is not None:
        for outcome in outcomes:
            if outcome.diagnosis is None:
                continue
            folder = wanted.out / names[outcome.path]
            folder.mkdir(parents=True, exist_ok=True)
            refined = outcome.diagnosis.refined_config
            configuration = Path(refined).read_text(encoding='utf-8') if refined else ''
            text = json.dumps(outcome.diagnosis.as_object(), indent=2) + '\n'
            write_atomically(folder / 'finding.json', text)
            write_atomically(folder / 'report.html', single.render_html(outcome.diagnosis, configuration, jobs))
            reports[outcome.path] = f'{names[outcome.path]}/report.html'
    finding = wanted.json or (str(wanted.out / 'joint.json') if wanted.out is not None else None)
    page = wanted.html or (str(wanted.out / 'joint.html') if wanted.out is not None else None)
    if finding:
        write_atomically(finding, json.dumps(as_object(outcomes, joint, names), indent=2) + '\n')
    if page:
        if wanted.out is not None:
            start = Path(page).parent
            reports = {path: os.path.relpath(wanted.out / report, start) for path, report in reports.items()}
        write_atomically(page, render_html(outcomes, joint, names, reports, wanted.command))
