"""`demo`: a simulated crane drives past two stations; its distance is shown live, recorded, and computed again."""

import dataclasses
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from drfmcw_fusion.offline import replay_recording
from drfmcw_fusion.replayed.report import summary, table, write_plot
from drfmcw_fusion.replayed.statistics import setting_statistics
from drfmcw_fusion.replayed.verification import compare_with_recorded
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import Parser, guarded
from drfmcw_ros.commands.config_files import find_config
from drfmcw_sim.scenario import Scenario, read_scenario
from drfmcw_sim.timeline import Timeline

from .graph import HOST, WATCH, Graph, private_environment
from .monitor import monitored
from .run import joining, pair_names, start_graph, watch

_START_LIMIT = 90.0  # until the first range arrives, on a machine that is busy otherwise [s]


@dataclasses.dataclass(frozen=True)
class Output:
    """Where the demo writes."""

    directory: Path

    @property
    def recording(self) -> Path:
        """The rosbag2 recording of everything."""
        return self.directory / 'recording'

    @property
    def plot(self) -> Path:
        """Picture of range, error and standard deviation."""
        return self.directory / 'ranges.png'

    @property
    def logs(self) -> Path:
        """What the processes said."""
        return self.directory / 'log'

    def clear(self) -> None:
        """Remove what an earlier demo left, and nothing else.

        Raises:
            ConfigurationError: the directory cannot be written.
        """
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            for left in (self.recording, self.logs):
                shutil.rmtree(left, ignore_errors=True)
            self.plot.unlink(missing_ok=True)
        except OSError as error:
            raise ConfigurationError(f'{self.directory}: {error.strerror or error}') from None


def drive(scenario_path: Path, scenario: Scenario, output: Output, console: Console) -> None:
    """Run the graph until the scenario ends, as fast as the stations go, with a live line.

    Raises:
        ConfigurationError: a process failed, or no range arrived.
    """
    pairs = pair_names(scenario)
    environment = private_environment()
    columns = (TextColumn('{task.description}'), BarColumn(bar_width=20), TaskProgressColumn(), TimeElapsedColumn())
    with (
        Graph(environment, output.logs) as graph,
        monitored(pairs, int(environment['ROS_DOMAIN_ID'])) as monitor,
        Progress(*columns, console=console) as progress,
    ):
        start_graph(graph, scenario_path, scenario, {'pace': 'subscribers'}, monitor, output.recording)
        task = progress.add_task('starting', total=Timeline(scenario).sweep_count)
        began = last_line = time.monotonic()
        while True:
            ended = graph.tend()
            failed = [m for m in ended if m.process.returncode]
            if failed:
                raise ConfigurationError(f'{failed[0].name} failed: {graph.last_words(failed[0])} (see {output.logs})')
            if not monitor.total and time.monotonic() - began > _START_LIMIT:
                raise ConfigurationError(f'no range arrived within {_START_LIMIT:g} s (see {output.logs})')
            line = f'{monitor.describe(pairs[0])}  {monitor.rate():4.0f} ranges/s'
            progress.update(task, completed=monitor.total, description=line)
            if not console.is_terminal and time.monotonic() - last_line > 2.0:  # a log has no live line
                console.print(line, highlight=False)
                last_line = time.monotonic()
            if any(m.name == 'simulator' for m in ended):
                break
            time.sleep(0.1)
        time.sleep(0.5)  # the last ranges are still on their way to the recorder
        progress.update(task, completed=monitor.total)


def stay(scenario_path: Path, scenario: Scenario, output: Output, port: int, console: Console) -> int:
    """Run the graph again, in real time and over and over, with live diagnosis and the host's page, until Ctrl-C.

    Raises:
        ConfigurationError: the page could not be served.
    """
    pairs = pair_names(scenario)
    environment = private_environment()
    with Graph(environment, output.logs) as graph, monitored(pairs, int(environment['ROS_DOMAIN_ID'])) as monitor:
        state, findings = str(output.directory / 'host'), str(output.directory / 'findings')
        host = graph.start('host', HOST, '--port', str(port), '--state', state, '--findings', findings)
        for pair in pairs:
            watched = ('--pair', pair, '--findings', findings, '--ros-args', '-r', f'__ns:=/{pair}')
            graph.start(f'watch {pair.replace("/", " ")}', WATCH, *watched, keep_alive=True, optional=True)
        start_graph(graph, scenario_path, scenario, {'at_end': 'loop'}, monitor, None, True)
        end = time.monotonic() + _START_LIMIT
        while not graph.last_words(host).startswith('host: '):
            if host.process.poll() is not None or time.monotonic() > end:
                raise ConfigurationError(f'the page failed: {graph.last_words(host)} (see {output.logs})')
            time.sleep(0.1)
        console.print(joining(environment), highlight=False, soft_wrap=True)
        address = graph.last_words(host).removeprefix('host: ')
        console.print(f'the graph goes on until Ctrl-C; open {address} in a browser', highlight=False)
        return watch(graph, monitor, pairs, console)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = Parser(prog='drfmcw demo', description=__doc__)
    parser.add_argument('--scenario', default='crane', help='scenario: YAML file or name in config/ (crane)')
    parser.add_argument('--out', type=Path, default=Path('drfmcw-demo'), help='directory of the output (drfmcw-demo)')
    parser.add_argument(
        '--stay',
        action='store_true',
        help="then keep the graph running in real time, diagnose it live and serve the host's page",
    )
    parser.add_argument('--port', type=int, default=8400, metavar='N', help='of the page (8400); 0: a free one')
    arguments = parser.parse_args(argv)

    def work() -> int:
        console = Console()
        path = find_config(arguments.scenario)
        scenario = read_scenario(path)
        output = Output(arguments.out)
        output.clear()
        stations = ', '.join(f"station '{name}'" for name in scenario.stations)
        console.print(f'{path.stem}: simulator, {stations}, fusion and recorder, one process each')
        drive(path, scenario, output, console)
        replay = replay_recording(str(output.recording))
        rows = setting_statistics(replay.results, replay.reference)
        console.print(table(rows, 'The recording, computed again'))
        console.print(summary(rows), highlight=False)
        status = compare_with_recorded(str(output.recording), replay.results, console)
        write_plot(replay.results, replay.reference, rows, path.stem, output.plot)
        console.print(f'recording: {output.recording}\nplot:      {output.plot}', highlight=False)
        return stay(path, scenario, output, arguments.port, console) if arguments.stay else status

    return guarded('drfmcw demo', work)


if __name__ == '__main__':
    sys.exit(main())
