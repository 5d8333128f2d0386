"""`info RECORDING`: what a recording holds, and whether it can be replayed."""

import dataclasses
import itertools
import json
import statistics
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import Mode, Role, SweepSettings

from ..cli import Parser, guarded
from ..messages import from_message, stamp_ns
from ..topics import SITE_TOPICS, split_station_topic
from .files import BagReader
from .options import add_damage_option


def describe(path: str) -> dict[str, Any]:
    """Return what a recording holds: time span, topics, settings and calibrations of its stations.

    Raises:
        BagError: it cannot be read.
    """
    with BagReader(path) as bag:
        settings_topics = {t for t in bag.topics if split_station_topic(t)[1] in ('sweep_config', 'calibration')}
        sweeps: list[dict[str, Any]] = []
        calibrations: list[dict[str, Any]] = []
        for topic, _, message in bag.messages(settings_topics):
            if split_station_topic(topic)[1] == 'sweep_config':
                settings = from_message(message, SweepSettings)
                sweeps.append({name: value for name, value in dataclasses.asdict(settings).items() if name != 'cut'})
            else:
                calibrations.append(dataclasses.asdict(from_message(message, Calibration)))
        recorded = {c.topic: {'type': c.msgtype, 'messages': c.msgcount} for c in bag.connections}
        stations = sorted(split_station_topic(t)[0] for t in recorded if split_station_topic(t)[1] == 'if_samples')
        turns = _turns(bag, sweeps)
        return {
            'recording': str(path),
            'start': bag.start_time if bag.message_count else None,
            'duration': (bag.end_time - bag.start_time) * 1e-9 if bag.message_count else 0.0,
            'messages': bag.message_count,
            'stations': stations,
            'checksums': bag.checksums,
            'unfinished': bag.unfinished,
            'damages': bag.damages,
            'topics': recorded,
            'sweep_configs': sweeps,
            'schedule': turns,
            'calibrations': calibrations,
            'missing': _missing(stations, set(recorded)),
        }


def _turns(bag: BagReader, configs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return how pairs took turns, one entry per pair: sweeps of both stations, rate and longest wait.

    Read from the sweeps themselves, so it holds for any hardware. A station that did not answer has fewer sweeps than
    its partner. Empty where at most one pair measures.
    """
    pairs = sorted({(c['station'], c['peer']) for c in configs if c['role'] == Role.FIRST})
    if len(pairs) < 2:
        return []
    stamps: dict[tuple[str, str], list[int]] = {}
    for topic, _, message in bag.messages({t for t in bag.topics if split_station_topic(t)[1] == 'if_samples'}):
        station = split_station_topic(topic)[0]
        stamps.setdefault((station, message.peer), []).append(stamp_ns(message.header.stamp))
    found = []
    for first, second in pairs:
        own, answers = sorted(stamps.get((first, second), [])), len(stamps.get((second, first), []))
        waits = [b - a for a, b in itertools.pairwise(own)]
        found.append(
            {
                'pair': f'{first}/{second}',
                'sweeps': len(own),
                'answers': answers if first != second else len(own),
                'rate': 1e9 / statistics.median(waits) if waits and statistics.median(waits) else None,
                'longest_wait': max(waits) * 1e-9 if waits else None,
            }
        )
    return found


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
            *map(escape, ('pair', 'sweeps', 'of the peer', 'rate [Hz]', 'longest wait [s]')), header_style='bold'
        )
        for t in found['schedule']:
            numbers = ('-' if value is None else f'{value:.4g}' for value in (t['rate'], t['longest_wait']))
            turns.add_row(t['pair'], str(t['sweeps']), str(t['answers']), *numbers)
        console.print(turns)
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
