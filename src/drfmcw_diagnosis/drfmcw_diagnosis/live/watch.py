"""Whether the nominal model explains the newest sweeps of a running graph: when to look, how thoroughly, what to say.

A quick check of what the model leaves over comes at every look. A full search takes a hundred times as long: it comes
where the check's outcome changes, and from time to time, since it also sees what stands out by its shape alone.
"""

import dataclasses
import datetime
import json
import math
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError, nearest, parameter
from drfmcw_ros.commands.cli import write_atomically
from drfmcw_sim.effects import Effect, Motion

from ..engine import check, compared, diagnose_dataset
from ..finding import wording
from ..finding.result import BeforeAfter, Diagnosis
from ..judging.verdict import LIMITS
from .driving import drives
from .limits import NODE
from .window import Snapshot, Window

OK, WARN, STALE = 'ok', 'warn', 'stale'
"""How a statement is to be taken."""


def _driving() -> list[str]:
    """Return the effects by which a crane drives, which is no reason to warn."""
    return [name for name, cls in sorted(Effect.registry.items()) if cls.motion is Motion.DRIVE]


@dataclasses.dataclass(frozen=True)
class WatchSettings:
    """When the window is looked at, and what is worth a warning."""

    period: float = parameter(30.0, unit='s', bounds=(0.5, 3600.0), description='between two looks at the window')
    fewest: int = parameter(96, bounds=(12, 5000), description='sweep pairs below which nothing is judged')
    false_alarm_rate: float = parameter(
        1e-4, bounds=(1e-9, 0.1), description='accepted chance, at each look, of a mismatch where there is none'
    )
    search_interval: float = parameter(
        300.0, unit='s', bounds=(0.0, 1e6), description='after which a full search comes whatever the quick check says'
    )
    hold: float = parameter(
        60.0, unit='s', bounds=(0.0, 1e6), description='how long a finding stays a warning after it has gone'
    )
    expected: list[str] = parameter(
        _driving(), description='effects that are no reason to warn; an empty name stands for none'
    )

    def __post_init__(self) -> None:
        """Refuse effects that are not in the registry."""
        for name in self.expected:
            if name and name not in Effect.registry:
                raise ConfigurationError(f"expected: no effect '{name}'{nearest(name, sorted(Effect.registry))}")


@dataclasses.dataclass(frozen=True)
class Order:
    """One look at the window, for another process."""

    snapshot: Snapshot
    false_alarm_rate: float
    failed: bool  # the check before this one
    search: bool  # whatever the check says
    findings: Path | None  # directory for what is found
    expected: tuple[str, ...] = ()  # effects that are no reason to warn or write


@dataclasses.dataclass(frozen=True)
class Judgement:
    """What a look at the window said."""

    problem: str = ''  # why it could not be judged; then nothing else is said
    sweeps: int = 0
    start: int = 0  # stamp of the first sweep [ns]
    end: int = 0  # of the last [ns]
    chance: float = math.nan  # of what the nominal model leaves over
    misfit: float = math.nan  # of the nominal model per degree of freedom
    failed: bool = False  # the quick check
    driving: bool = False  # as is expected: what the model leaves over is its motion, first of all
    searching: bool = False  # a search is under way, another judgement follows
    diagnosis: Diagnosis | None = None  # of the search
    written: str = ''  # directory with the finding

    @property
    def found(self) -> Diagnosis:
        """The diagnosis.

        Raises:
            ValueError: no search was made.
        """
        if self.diagnosis is None:
            raise ValueError('this judgement comes from the quick check alone')
        return self.diagnosis


def judge(order: Order) -> Iterator[Judgement]:
    """Yield what the check says, then, where a search is due, what that says."""
    try:
        data = order.snapshot.dataset()
        comparison = compared(data)
        chance, misfit = check(comparison)
        driving = bool(set(_driving()) & set(order.expected)) and drives(comparison)
        failed = chance < order.false_alarm_rate and not driving
        search = order.search or failed != order.failed
        start, end = int(data.stamp[0]), int(data.stamp[-1])
        checked = Judgement('', len(data), start, end, chance, misfit, failed, driving, search)
        yield checked
        if search:
            pair = order.snapshot.pair
            name = '-'.join((utc(end).replace(':', '').replace('-', ''), *pair))  # others may keep theirs there, too
            out = order.findings / name if order.findings else None
            found = diagnose_dataset(data, order.false_alarm_rate, out, command='./drfmcw watch')
            written = ''
            if out is not None and is_expected(found, order.expected, driving):
                shutil.rmtree(out, ignore_errors=True)  # its refined model
            elif out is not None and found.verdict != 'consistent':
                _write(found, checked, out, '/'.join(pair))
                written = str(out)
            yield dataclasses.replace(checked, searching=False, diagnosis=found, written=written)
    except (ConfigurationError, OSError) as error:
        yield Judgement(str(error))


def is_expected(diagnosis: Diagnosis, expected: Collection[str], driving: bool = False) -> bool:
    """Return True where one of the explanations consists of expected effects only and nothing else is left.

    Of a crane that drives, what no effect explains is expected, too: acceleration within a group is in no model.
    """
    if not driving and _leaves_something(diagnosis):
        return False
    explanations = [e for e in (diagnosis.explanation, *diagnosis.alternatives) if e is not None]
    if driving and not explanations:
        return diagnosis.verdict != 'consistent'
    return any({f.effect for f in e.effects} <= set(expected) for e in explanations)


def _leaves_something(diagnosis: Diagnosis) -> bool:
    """Return True where the effects leave more than their forward models may be off."""
    rest = diagnosis.remainder
    ambiguous = diagnosis.verdict == 'ambiguous' and rest is not None and rest.share >= LIMITS.adequate
    return diagnosis.verdict == 'partial' or ambiguous


def _write(diagnosis: Diagnosis, checked: Judgement, out: Path, pair: str) -> None:
    """Write a finding and its report into a directory, where its refined model may stand already.

    Raises:
        ConfigurationError, OSError: the directory cannot be written.
    """
    from ..finding.report import (
        render_html,  # only here, because importing matplotlib takes half a second at every look
    )

    out.mkdir(parents=True, exist_ok=True)
    window = {'pair': pair, 'sweeps': checked.sweeps, 'from': utc(checked.start), 'to': utc(checked.end)}
    write_atomically(out / 'finding.json', json.dumps(diagnosis.as_object() | {'window': window}, indent=2) + '\n')
    refined = Path(diagnosis.refined_config).read_text(encoding='utf-8') if diagnosis.refined_config else ''
    write_atomically(out / 'report.html', render_html(diagnosis, refined))


@dataclasses.dataclass(frozen=True)
class Statement:
    """What is to be said now."""

    level: str  # OK, WARN or STALE
    message: str
    values: dict[str, str | float | int]


class Watch:
    """Decides when to look at a window and keeps what was found."""

    def __init__(self, window: Window, settings: WatchSettings | None = None, findings: Path | None = None) -> None:
        """Start without having looked; `findings` is a directory for what will be found."""
        self.window = window
        self.settings = settings or WatchSettings()
        self.finding: Judgement | None = None
        """What is worth a warning now."""
        self._findings = findings
        self._problem = ''
        self._judged: Judgement | None = None  # the newest look
        self._explained: Diagnosis | None = None  # of the newest search, by expected effects
        self._gone: tuple[Judgement, float] | None = None  # finding, and when it was last found to have gone [s]
        self._failed = False
        self._due = -math.inf  # next look [s]
        self._search_due: float | None = None  # [s]
        self._searched = 0  # newest sweep of the last search [ns]
        self._received, self._heard = 0, -math.inf  # sweeps, and when the last one came [s]
        self._looked_at = 0  # newest sweep of the last look [ns]

    def order(self, now: float) -> Order | None:
        """Return a look at the window that is due, None where none is.

        Args:
            now: on any clock that runs on [s].
        """
        newest = self.window.newest
        if now < self._due or newest == self._looked_at or self._lacking():
            return None
        if self._search_due is None:
            self._search_due = now + self.settings.search_interval
        self._due, self._looked_at = now + self.settings.period, newest
        search = now >= self._search_due
        expected = tuple(name for name in self.settings.expected if name)
        rate = self.settings.false_alarm_rate
        return Order(self.window.snapshot(), rate, self._failed, search, self._findings, expected)

    def _lacking(self) -> str:
        """Return why nothing can be judged, '' where it can."""
        if not len(self.window):
            return f'no sweep of {"/".join(self.window.pair)} yet'
        if unknown := self.window.unknown():
            return f'waiting for {", ".join(unknown)}'
        needed = min(self.settings.fewest, self.window.settings.sweeps)
        if (count := self.window.complete) < needed:
            return f'too few sweeps to judge: {count} of {needed} complete'
        return ''

    def take(self, judgement: Judgement, now: float) -> None:
        """Take in what a look said."""
        self._problem = judgement.problem
        if judgement.problem:
            if self._judged is not None and self._judged.searching:  # it failed: not again at once
                self._failed, self._search_due = self._judged.failed, now + self.settings.search_interval
            return
        self._judged = judgement
        if judgement.searching:
            return
        self._failed = judgement.failed
        diagnosis = judgement.diagnosis
        if diagnosis is None:
            return
        self._search_due, self._searched = now + self.settings.search_interval, judgement.end
        worth = diagnosis.verdict != 'consistent' and not is_expected(
            diagnosis, self.settings.expected, judgement.driving
        )
        self._explained = None if worth or diagnosis.verdict == 'consistent' else diagnosis
        if worth:
            self.finding, self._gone = judgement, None
        elif self.finding is not None:
            self._gone = self.finding, now
            self.finding = None

    def statement(self, now: float) -> Statement:
        """Return what is to be said."""
        if self.window.received != self._received:
            self._received, self._heard = self.window.received, now
        level, message = self._said(now)
        values: dict[str, str | float | int] = {
            'records received': self.window.received,
            'stations heard': ', '.join(self.window.heard),
            'sweeps in the window': len(self.window),
            'with the records of all stations heard': self.window.complete,
            'samples in the window [MB]': self.window.size / 1e6,
        }
        if (judged := self._judged) is not None:
            values |= {
                'sweeps judged': judged.sweeps,
                'from': utc(judged.start),
                'to': utc(judged.end),
                'span [s]': (judged.end - judged.start) * 1e-9,
                'chance of what the model leaves over': judged.chance,
                'misfit per degree of freedom': judged.misfit,
                'last full search': utc(self._searched) if self._searched else 'none yet',
            }
        if self.finding is not None:
            values |= _values(self.finding)
        else:
            values['verdict'] = self._verdict()
        return Statement(level, message, values)

    def _verdict(self) -> str:
        if self._judged is None:
            return 'not judged'
        if self._explained is not None:
            return 'explained'
        if self._judged.driving:
            return 'driving'
        if self._judged.failed:
            return 'being searched' if self._judged.searching else 'not judged'
        return 'consistent'

    def _said(self, now: float) -> tuple[str, str]:
        if (judged := self._judged) is None:
            reason = self._problem or self._lacking() or 'the first look has not ended yet'
            return STALE, f'nothing judged: {reason}'
        level, message = OK, f'the model explains the last {judged.sweeps} sweeps'
        if self._explained is not None and self._explained.explanation is not None:
            message += f' with what is expected: {wording.headline(self._explained)}'
        elif judged.driving:
            message = f'the crane drives, as expected: only a full search judges its {judged.sweeps} sweeps'
        if self.finding is not None:
            level, message = WARN, self.described(self.finding)
        elif judged.failed and self._explained is None and judged.searching:
            level = OK if any(self.settings.expected) else WARN  # it may come to something expected
            message = f'the model no longer explains the last {judged.sweeps} sweeps; searching for what it leaves out'
        elif judged.failed and self._explained is None:
            level = WARN
            message = f'the model does not explain the last {judged.sweeps} sweeps, and no search has said why'
        elif self._gone is not None and now - self._gone[1] < self.settings.hold:
            gone, since = self._gone
            level = WARN
            message = f'{message} again, for {now - since:.0f} s; before: {self.described(gone)}'
        if self._problem:
            return WARN, f'the newest sweeps could not be judged: {self._problem}; before: {message}'
        if now - self._heard > NODE.silent:
            return STALE, f'no sweep for {now - self._heard:.0f} s; before: {message}'
        return level, message

    @staticmethod
    def described(judgement: Judgement) -> str:
        """Return a finding in one sentence."""
        diagnosis = judgement.found
        if diagnosis.verdict == 'unexplained' or diagnosis.explanation is None:
            said = 'the model does not explain the data, and no known effect accounts for it'
            if diagnosis.locations:
                worst = max(diagnosis.locations, key=lambda x: x.share)
                said += f'; most of it in: {wording.level_title(worst.level, worst.station)}, {wording.span(worst)}'
            return said
        said = f'left out of the model: {wording.with_sizes(diagnosis.explanation)}'
        for rival in diagnosis.alternatives:
            said += f'; or {wording.with_sizes(rival)}'
        if shift := wording.range_change(diagnosis):
            said += f'; changes the range by up to {wording.millimetres(shift)[0]}'
        return said


def _values(judgement: Judgement) -> dict[str, str | float | int]:
    """Return a finding as keys and values."""
    diagnosis = judgement.found
    fit = diagnosis.fit.held_out if math.isfinite(diagnosis.fit.held_out.before) else diagnosis.fit.fitted
    values: dict[str, str | float | int] = {
        'verdict': diagnosis.verdict,
        'significance': diagnosis.significance,
        'misfit before': fit.before,
        'misfit after': fit.after,
        'found in sweeps from': utc(judgement.start),
        'found in sweeps to': utc(judgement.end),
    }
    for number, found in enumerate(diagnosis.explanation.effects if diagnosis.explanation else (), 1):
        values[f'effect {number}'] = found.effect
        values[f'effect {number} station'] = found.station or ''
        for name, estimate in found.parameters.items():
            values[f'effect {number} {name} [{estimate.unit}]'] = estimate.value
            values[f'effect {number} {name} std [{estimate.unit}]'] = estimate.std
    for number, rival in enumerate(diagnosis.alternatives, 1):
        values[f'alternative {number}'] = wording.with_sizes(rival)
    if diagnosis.next_measurement:
        values['next measurement'] = diagnosis.next_measurement
    for key, figure in (('mean range error', diagnosis.fit.range_bias), ('scatter of range', diagnosis.fit.range_std)):
        if isinstance(figure, BeforeAfter):
            values |= {f'{key} before [m]': figure.before, f'{key} after [m]': figure.after}
    if judgement.written:
        values['written to'] = judgement.written
    return values


def utc(stamp: int) -> str:
    """Return a stamp [ns] as date and time, to the second."""
    return datetime.datetime.fromtimestamp(stamp // 1_000_000_000, datetime.UTC).strftime('%Y-%m-%dT%H:%M:%SZ')
