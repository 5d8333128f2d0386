"""`info RECORDING`: what a recording holds, and whether it can be replayed."""

import contextlib
import dataclasses
import itertools
import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.schedule import NO_TURNS, Share
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, Role, SweepSettings

from ..commands.cli import Parser, guarded
from ..graph.messages import from_message, stamp_ns
from ..graph.topics import SITE_TOPICS, split_station_topic
from .files import BagReader
from .options import add_damage_option

_SETTINGS = ('sweep_config', 'sweep_schedule', 'schedule_request', 'calibration')  # last names of the topics read whole
_PAUSE = 5.0  # times the median wait, beyond which a pair waits for something else than its turn


def describe(path: str) -> dict[str, Any]:
    """Return what a recording holds: time span, topics, settings and calibrations of its stations.

    Raises:
        BagError: it cannot be read.
    """
    with BagReader(path) as bag:
        settings_topics = {t for t in bag.topics if split_station_topic(t)[1] in _SETTINGS}
        sweeps: list[dict[str, Any]] = []
        grants: list[Share] = []
        requests: dict[tuple[str, str], Share] = {}
        calibrations: list[dict[str, Any]] = []
        for topic, _, message in bag.messages(settings_topics):
            kind = split_station_topic(topic)[1]
            if kind == 'sweep_config':
                settings = from_message(message, SweepSettings)
                sweeps.append({name: value for name, value in dataclasses.asdict(settings).items() if name != 'cut'})
            elif kind == 'sweep_schedule':
                grants.append(from_message(message, Share))
            elif kind == 'schedule_request':
                with contextlib.suppress(ConfigurationError):  # refused by the hardware too
                    requests[message.station, message.peer] = from_message(message, Share)
            else:
                calibrations.append(dataclasses.asdict(from_message(message, Calibration)))
        recorded = {c.topic: {'type': c.msgtype, 'messages': c.msgcount} for c in bag.connections}
        stations = sorted(split_station_topic(t)[0] for t in recorded if split_station_topic(t)[1] == 'if_samples')
        turns = _turns(bag, sweeps, grants, requests)
        for _ in bag.raw_messages(bag.readable - settings_topics, whole=True):
            pass  # one that cannot be decoded is refused, or listed among the damages
        return {
            'recording': str(path),
            'start': bag.start_time if bag.message_count else None,
            'duration': (bag.end_time - bag.start_time) * 1e-9 if bag.message_count else 0.0,
            'messages': bag.message_count,
            'stations': stations,
            'checksums': bag.checksums,
            'unfinished': bag.unfinished,
            'damages': bag.damages,
            'older': bag.older,
            'unreadable': list(bag.unreadable.values()),
            'topics': recorded,
            'sweep_configs': sweeps,
            'schedule': turns,
            'calibrations': calibrations,
            'missing': _missing(stations, set(recorded)),
        }


def _turns(
    bag: BagReader,
    configs: Sequence[dict[str, Any]],
    schedules: Sequence[Share],
    requests: Mapping[tuple[str, str], Share],
) -> list[dict[str, Any]]:
    """Return how pairs took turns, one entry per pair, as it was at last: since a granted rate last changed.

    What was asked for and granted, and counted from the sweeps themselves, whatever hardware made them: the sweeps of
    both stations, rate and longest wait. A station that did not answer has fewer sweeps than its partner. Empty where
    at most one pair measures.
    """
    pairs = sorted({(c['station'], c['peer']) for c in configs if c['role'] == Role.FIRST})
    if len(pairs) < 2:
        return []
    stamps: dict[tuple[str, str], list[int]] = {}
    for topic, _, message in bag.messages({t for t in bag.topics if split_station_topic(t)[1] == 'if_samples'}):
        station = split_station_topic(topic)[0]
        stamps.setdefault((station, message.peer), []).append(stamp_ns(message.header.stamp))
    grants = {pair: _granted([s for s in schedules if (s.station, s.peer) == pair]) for pair in pairs}
    since = max(stamp for _, _, stamp in grants.values())
    found = []
    for first, second in pairs:
        request = requests.get((first, second))
        asked = request.rate or None if request is not None else None
        granted, priority, _ = grants[first, second]
        own = sorted(stamp for stamp in stamps.get((first, second), []) if stamp >= since)
        answers = sum(stamp >= since for stamp in stamps.get((second, first), []))
        waits = [b - a for a, b in itertools.pairwise(own)]
        turns = [wait for wait in waits if wait <= _PAUSE * statistics.median(waits)]
        found.append(
            {
                'pair': f'{first}/{second}',
                'asked': asked,
                'granted': granted,
                'priority': priority,
                'since': since or None,
                'sweeps': len(own),
                'answers': answers,
                'rate': 1e9 / statistics.mean(turns) if sum(turns) else None,
                'longest_wait': max(waits) * 1e-9 if waits else None,
            }
        )
    return found


def _granted(schedules: Sequence[Share]) -> tuple[float | None, int | None, int]:
    """Return rate [Hz] and priority that a pair was granted last, and since when [ns]; 0: from the beginning on.

    Both are None where the hardware does not state them.
    """
    runs = [list(run) for _, run in itertools.groupby(schedules, lambda schedule: schedule.turns)]
    if not runs:
        return None, None, 0
    newest, since = runs[-1][0], runs[-1][0].stamp if len(runs) > 1 else 0
    return (None, None, since) if newest.turns == NO_TURNS else (*newest.turns, since)


def _missing(stations: Sequence[str], topics: set[str]) -> list[str]:
    """Return the topics that a full replay would use and that are not there."""
    wanted = [f'/{s}/{name}' for s in stations for name in ('sweep_config', 'calibration', 'status')]
    return [t for t in (*wanted, *SITE_TOPICS) if t not in topics] or ([] if stations else ['/<station>/if_samples'])


def _show(found: dict[str, Any], console: Console) -> None:
    when = (
        datetime.fromtimestamp(found['start'] * 1e-9, UTC).isoformat(' ', 'seconds') if found['messages'] else 'empty'
    )
    console.print(
        f'{found["recording"]}: {when}, {found["duration"]:.1f} s, {found["messages"]} messages', highlight=False
    )
    topics = Table('topic', 'type', 'messages', header_style='bold')
    for topic, about in sorted(found['topics'].items()):
        topics.add_row(topic, about['type'], str(about['messages']))
    console.print(topics)
    settings = Table(
        *map(escape, ('station', 'peer', 'mode', 'role', 'f_0 [MHz]', 'B_sw [MHz]', 'T_sw [ms]', 'T_off [us]')),
        *map(escape, ('f_s [MS/s]', 'samples')),
        header_style='bold',
    )
    for s in found['sweep_configs']:
        row = (s['start_frequency'] / 1e6, s['bandwidth'] / 1e6, s['ramp_duration'] * 1e3, s['start_delay'] * 1e6)
        cells = (*(f'{v:g}' for v in (*row, s['sample_rate'] / 1e6)), str(s['sample_count']))
        settings.add_row(s['station'], s['peer'], Mode(s['mode']).short_name, str(s['role']), *cells)
    console.print(settings)
    if found['schedule']:
        turns = Table(
            Column('pair', no_wrap=True),
            *map(escape, ('asked [Hz]', 'granted', 'arrived', 'longest wait [s]')),
            *('sweeps', 'of the peer'),
            header_style='bold',
        )
        for t in found['schedule']:
            names = ('asked', 'granted', 'rate', 'longest_wait')
            numbers = ('-' if t[name] is None else f'{t[name]:.4g}' for name in names)
            turns.add_row(t['pair'], *numbers, str(t['sweeps']), str(t['answers']))
        console.print(turns)
        if since := found['schedule'][0]['since']:
            seconds = (since - found['start']) * 1e-9
            console.print(f'note: turns since the schedule changed, {seconds:.1f} s after the start', highlight=False)
    clocks = Table(
        *map(escape, ('station', 'reference [ppm]', 'ADC clock [ppm]', 'at [degC]', 'delay [ns]')),
        *map(escape, ('noise floor [dBm/Hz]', 'phase noise [dBc/Hz]', 'corner [kHz]')),
        header_style='bold',
    )
    for c in found['calibrations']:
        values = ((c['alpha'] - 1) * 1e6, (c['sample_clock_alpha'] - 1) * 1e6, c['temperature'], c['delay'] * 1e9)
        noise = (c['noise_floor'], c['phase_noise_level'], c['phase_noise_corner'] / 1e3)
        clocks.add_row(c['station'], *(f'{v:.6g}' for v in (*values, *noise)))
    console.print(clocks)
    if not found['checksums']:
        console.print('note: not every message stands under a checksum', highlight=False)
    for kind, fields in found['older'].items():
        text = f'note: an older {kind} without {", ".join(fields)}: replay --publish adds them, ros2 bag play does not'
        console.print(text, highlight=False)
    for text in found['unreadable']:
        console.print(f'note: {text}', highlight=False)
    for topic in found['missing']:
        console.print(f'note: {topic} is missing', highlight=False)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = Parser(prog='drfmcw info', description=__doc__)
    parser.add_argument('recording', help='rosbag2 recording: directory or storage file')
    parser.add_argument('--json', action='store_true', help='print everything as JSON')
    add_damage_option(parser)
    arguments = parser.parse_args(argv)

    def work() -> None:
        found = describe(arguments.recording)
        if arguments.json:
            print(json.dumps(found, indent=2))
        else:
            _show(found, Console())

    return guarded('drfmcw info', work)


if __name__ == '__main__':
    sys.exit(main())
