"""`replay RECORDING`: recompute a recording's ranges offline, or play its measured topics into the live graph."""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.settings import ConfigurationError, declared_parameters, from_mapping, nearest, read_yaml
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.bag.options import add_damage_option
from drfmcw_ros.calibration.document import read_document
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.work.progress import Progress

from .offline import RecordingReplay, Replay
from .replayed import report
from .replayed.statistics import DEFAULT_BIN, setting_statistics
from .replayed.up_and_down import up_and_down
from .replayed.verification import compare_with_recorded
from .settings import FusionSettings


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    own, ros = split_ros_arguments(argv)
    arguments = _parser().parse_args(own)
    if arguments.publish:
        from drfmcw_ros.bag.player import play  # the offline replay needs no ROS graph

        return guarded('drfmcw replay', lambda: play(arguments, ros))
    return guarded('drfmcw replay', lambda: _offline(arguments))


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog='drfmcw replay', description=__doc__)
    parser.add_argument('recording', help='rosbag2 recording: directory, .mcap or .db3 file')
    add_damage_option(parser)
    offline = parser.add_argument_group('offline (default): as fast as possible')
    offline.add_argument('--json', metavar='FILE', help="write the table as JSON, '-' prints it")
    offline.add_argument('--csv', metavar='FILE', help="write the table as CSV, '-' prints it")
    offline.add_argument('--results', metavar='FILE', help='write every range with its corrections as CSV')
    offline.add_argument('--plot', metavar='FILE', help='write a plot (.png, .svg, .pdf)')
    offline.add_argument('--station', action='append', metavar='NAME', help='only this station (repeatable)')
    offline.add_argument('--bin', type=float, default=DEFAULT_BIN, metavar='M', help="width of a drive's distance bins")
    offline.add_argument('--verify', action='store_true', help='compare with the ranges in the recording, bit by bit')
    offline.add_argument('--config', metavar='FILE', help="YAML with 'estimator' and 'fusion' settings")
    for name, choices in (('atmosphere', None), ('velocity', None)):
        declared = declared_parameters(FusionSettings)[name][1]
        offline.add_argument(f'--{name}', choices=declared.choices or choices, help=declared.description)
    offline.add_argument('--estimator', help=declared_parameters(EstimatorSettings)['estimator'][1].description)
    offline.add_argument('--window', help=declared_parameters(EstimatorSettings)['window'][1].description)
    offline.add_argument(
        '--search-range', metavar='MIN:MAX', help='distances among which the line is searched [m], as 5:40'
    )
    offline.add_argument(
        '--pair', metavar='UP/DOWN', help='two stations that hear themselves, rising and falling ramps of one radar: '
        'combine them to range and velocity',
    )  # fmt: skip
    offline.add_argument(
        '--calibration', action='append', default=[], metavar='FILE',
        help='calibration document of a station, used instead of the recorded one (repeatable)',
    )  # fmt: skip
    offline.add_argument('--no-alpha', action='store_true', help='take all clocks as nominal (no eq. 19)')
    live = parser.add_argument_group('into the live graph')
    live.add_argument('--publish', action='store_true', help='publish the measured topics instead')
    live.add_argument(
        '--rate', type=float, default=1.0, metavar='X', help='play X times as fast; 0: as fast as possible'
    )
    live.add_argument('--loop', type=int, default=1, metavar='N', help='play N times; 0: until stopped')
    live.add_argument('--restamp', action='store_true', help='move stamps to the time of publishing')
    live.add_argument('--wait', type=float, default=10.0, metavar='S', help='wait at most S for subscribers')
    return parser


def settings_from(arguments: argparse.Namespace) -> tuple[EstimatorSettings, FusionSettings]:
    """Return the estimator's and the fusion's settings that the command line gives.

    Raises:
        ConfigurationError: unknown key or wrong value in --config or an option.
    """
    sections: dict[str, Any] = read_yaml(arguments.config) if arguments.config else {}
    where = str(arguments.config)
    for key in sections:
        if key not in ('estimator', 'fusion'):
            raise ConfigurationError(f"{where}: unknown key '{key}'{nearest(key, ('estimator', 'fusion'))}")
    estimator = from_mapping(EstimatorSettings, sections.get('estimator'), f'{where}: estimator')
    options = {name: getattr(arguments, name) for name in ('estimator', 'window') if getattr(arguments, name)}
    from_mapping(EstimatorSettings, options, 'options')  # refuses unknown names
    options |= search_range(arguments.search_range)
    estimator = dataclasses.replace(estimator, **options)
    fusion = from_mapping(FusionSettings, sections.get('fusion'), f'{where}: fusion')
    chosen = {name: getattr(arguments, name) for name in ('atmosphere', 'velocity') if getattr(arguments, name)}
    if arguments.no_alpha:
        chosen['alpha_correction'] = False
    return estimator, dataclasses.replace(fusion, **chosen)


def search_range(text: str | None) -> dict[str, Any]:
    """Return the estimator's settings for 'MIN:MAX' [m], none for None.

    Raises:
        ConfigurationError: no two numbers.
    """
    if text is None:
        return {}
    low, _, high = text.partition(':')
    try:
        return {'search_range_minimum': float(low), 'search_range_maximum': float(high)}
    except ValueError:
        raise ConfigurationError(f"--search-range '{text}': expected MIN:MAX in metres, as 5:40") from None


def _offline(arguments: argparse.Namespace) -> int:
    estimator, fusion = settings_from(arguments)
    if not arguments.bin > 0.0:
        raise ConfigurationError(f'--bin = {arguments.bin:g} m must be above zero')
    quiet = '-' in (arguments.json, arguments.csv, arguments.results)  # the data is what is printed
    console = Console(stderr=quiet)
    with BagReader(arguments.recording) as bag:
        stations = arguments.pair.split('/') if arguments.pair else arguments.station
        calibrations = [read_document(path).calibration() for path in arguments.calibration]
        engine = RecordingReplay(bag, estimator, fusion, stations, calibrations)
        replay = _with_progress(engine, bag.message_count)
    if arguments.pair:
        combined = up_and_down(replay.results, arguments.pair, engine.doppler_scale(stations[0]))
        replay = dataclasses.replace(replay, results=combined)
    rows = setting_statistics(replay.results, replay.reference, arguments.bin)
    for line in replay.missing:
        console.print(f'note: {line}', highlight=False)
    for reason, count in replay.dropped.items():
        console.print(f'note: {count} sweeps without a range: {reason}', highlight=False)
    if not rows:
        raise ConfigurationError(f'{arguments.recording}: no range could be computed from {replay.sweeps} sweeps')
    name = Path(arguments.recording).name
    console.print(report.table(rows, name, velocity=bool(arguments.pair)))
    console.print(report.summary(rows), highlight=False)
    alone = {} if arguments.pair else {s: engine.doppler_scale(s) for s in engine.stations}
    for sentence in (
        report.left_out(replay.results),
        report.mismatch(replay.results),
        report.hopping(replay.results),
        *report.spread(rows),
        report.unknown_velocity(rows, alone, fusion.maximum_velocity),
    ):
        if sentence:
            console.print(sentence, highlight=False)
    if arguments.json:
        report.write_json(rows, arguments.json)
    if arguments.csv:
        report.write_csv(rows, arguments.csv)
    if arguments.results:
        report.write_results(replay.results, arguments.results)
    if arguments.plot:
        report.write_plot(replay.results, replay.reference, rows, name, arguments.plot)
        console.print(f'plot: {arguments.plot}', highlight=False)
    if not any(row.n for row in rows):
        raise ConfigurationError(f'{arguments.recording}: none of {replay.sweeps} sweeps gave a range that counts')
    return compare_with_recorded(arguments.recording, replay.results, console) if arguments.verify else 0


def _with_progress(engine: RecordingReplay, message_count: int) -> Replay:
    columns = (
        TextColumn('{task.description}'),
        BarColumn(),
        TextColumn('{task.percentage:>3.0f} %'),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console) as progress:
        task = progress.add_task('replaying', total=message_count)
        return engine.run(lambda count: progress.update(task, completed=count))


if __name__ == '__main__':
    sys.exit(main())
