"""`run SCENARIO`: the whole graph of a simulated site - simulator, one process per station, fusion."""

import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.text import Text

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_physics.settings import ConfigurationError, declared_parameters
from drfmcw_ros.commands.cli import Parser, guarded
from drfmcw_ros.commands.config_files import find_config
from drfmcw_sim.scenario import Scenario, read_scenario

from .graph import (
    FUSION,
    ON_THIS_MACHINE,
    PAIR_STATION,
    RECORDER,
    SIMULATOR,
    STATION,
    Graph,
    parameters,
    private_environment,
)
from .monitor import RangeMonitor, monitored

_ESTIMATOR = declared_parameters(EstimatorSettings)['estimator'][1]
PATIENT = parameters({'pair_time_limit': 60.0})
"""Arguments of a fusion for which no sweep is late, however slow the machine."""
_DISCOVERY_LIMIT = 15.0  # takes up to 3 s on an idle machine [s]


def pair_names(scenario: Scenario) -> list[str]:
    """Return the pairs of a scenario as 'first/second'."""
    return [f'{pair.first}/{pair.second}' for pair in scenario.pairs]


def start_nodes(
    graph: Graph,
    scenario: Scenario,
    record: Path | None = None,
    keep_alive: bool = False,
    estimator: str | None = None,
    file: Path | None = None,
    patient: bool = False,
) -> None:
    """Start recorder, fusion and everything between fusion and simulator.

    With estimator 'pair', a pair station replaces each pair's first station; the second one's sweeps reach it
    compressed, as over a radio link, from a node that evaluates nothing.

    Args:
        graph: that takes the processes.
        scenario: with the stations and pairs.
        record: recording to write, None for none.
        keep_alive: restart stations, fusion and recorder when they die.
        estimator: of the stations; None takes their default.
        file: with parameters of stations and fusion, in ROS's format; None for none.
        patient: fusion waits for the second result of a sweep as long as a busy machine may need; `file` precedes.

    Raises:
        ConfigurationError: estimator 'pair', and a station hears itself.
    """
    if estimator == 'pair':
        for pair in scenario.pairs:
            if pair.hears_itself:
                raise ConfigurationError(f"estimator 'pair' needs two stations, but {pair.first} hears itself")
    if record is not None:
        resume = ('--resume',) if keep_alive else ()  # after a restart
        graph.start('recorder', RECORDER, str(record), *resume, keep_alive=keep_alive, optional=True)
    pairs = [argument for name in pair_names(scenario) for argument in ('--pair', name)]
    given = parameters({}, file) if file is not None else []
    patience = PATIENT if patient else []
    graph.start('fusion', FUSION, *pairs, *patience, *given, keep_alive=keep_alive)
    stations, settings = list(scenario.stations), {'estimator': estimator} if estimator else {}
    if estimator == 'pair':
        stations, settings = sorted({pair.second for pair in scenario.pairs}), {'output': 'compressed'}
        for first in dict.fromkeys(pair.first for pair in scenario.pairs):
            seconds = ','.join(pair.second for pair in scenario.pairs if pair.first == first)
            names = ('--first', first, '--second', seconds)
            graph.start(f'pair_station_{first}', PAIR_STATION, *names, *given, keep_alive=keep_alive)
    options = parameters(settings, file) if settings else given
    for station in stations:
        graph.start(f'station_{station}', STATION, '--station', station, *options, keep_alive=keep_alive)


def start_graph(
    graph: Graph,
    scenario_path: Path,
    scenario: Scenario,
    simulator: dict[str, object],
    monitor: RangeMonitor,
    record: Path | None = None,
    keep_alive: bool = False,
    estimator: str | None = None,
    file: Path | None = None,
) -> None:
    """Start the nodes of a scenario, and its simulator once the monitor hears the fusion.

    Args:
        graph: that takes the processes.
        scenario_path: of the scenario file.
        scenario: as read from it.
        simulator: further parameters of the simulator node.
        monitor: that shall not miss the first range.
        record: as for `start_nodes`, like the following.
        keep_alive: see there.
        estimator: see there; raises as there.
        file: see there.
    """
    start_nodes(graph, scenario, record, keep_alive, estimator, file, patient=simulator.get('pace') == 'subscribers')
    monitor.wait_for_publishers(_DISCOVERY_LIMIT)
    settings = {'scenario': str(scenario_path), 'listeners': 1 if record is None else 2} | simulator
    graph.start('simulator', SIMULATOR, *parameters(settings))


def watch(graph: Graph, monitor: RangeMonitor, pairs: Sequence[str], console: Console) -> int:
    """Show the ranges until the simulator ends; return its exit status, or that of a member that failed."""
    with Live(console=console, refresh_per_second=5, transient=not console.is_terminal) as live:
        while True:
            ended = graph.tend()
            rate = Text(f'{monitor.rate():.0f} ranges/s, {monitor.total} so far', style='dim')
            live.update(Text('\n').join([*(Text(monitor.describe(pair)) for pair in pairs), rate]))
            for member in ended:
                if member.name == 'simulator' or member.process.returncode:
                    return member.process.returncode
            time.sleep(0.1)


def joining(environment: Mapping[str, str]) -> str:
    """Return the line that says how other commands join a graph that has a ROS domain of its own."""
    needed = {'ROS_DOMAIN_ID': environment['ROS_DOMAIN_ID']} | ON_THIS_MACHINE
    return 'to join this graph: export ' + ' '.join(f'{name}={value}' for name, value in needed.items())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    parser = Parser(prog='drfmcw run', description=__doc__)
    parser.add_argument('scenario', nargs='?', default='crane', help='scenario: YAML file or name in config/ (crane)')
    parser.add_argument('--rate', type=float, default=1.0, metavar='X', help='scenario seconds per second (1)')
    parser.add_argument('--fast', action='store_true', help='as fast as stations and fusion go')
    parser.add_argument('--loop', action='store_true', help='start again when the scenario ends')
    parser.add_argument('--record', type=Path, metavar='RECORDING', help='write a recording')
    parser.add_argument(
        '--network', action='store_true', help="use the environment's ROS domain, not one of its own on this machine"
    )
    parser.add_argument('--estimator', choices=_ESTIMATOR.choices, help=_ESTIMATOR.description)
    parser.add_argument(
        '--parameters', type=Path, metavar='FILE', help='ROS parameter file of all nodes, as the host saves it'
    )
    arguments = parser.parse_args(argv)

    def work() -> int:
        path = find_config(arguments.scenario)
        scenario = read_scenario(path)
        if not arguments.rate > 0.0:
            raise ConfigurationError(f'--rate = {arguments.rate:g} must be above zero')
        if arguments.record is not None and arguments.record.exists():
            raise ConfigurationError(f'{arguments.record}: exists already, not overwriting')
        if arguments.parameters is not None and not arguments.parameters.is_file():
            raise ConfigurationError(f'--parameters {arguments.parameters}: no such file')
        simulator: dict[str, object] = {'rate': arguments.rate, 'at_end': 'loop' if arguments.loop else 'exit'}
        if arguments.fast:
            simulator['pace'] = 'subscribers'
        pairs = pair_names(scenario)
        console = Console()
        environment = dict(os.environ) if arguments.network else private_environment()
        if not arguments.network:
            console.print(joining(environment), highlight=False, soft_wrap=True)
        domain = None if arguments.network else int(environment['ROS_DOMAIN_ID'])
        with Graph(environment) as graph, monitored(pairs, domain) as monitor:
            start_graph(
                graph,
                path,
                scenario,
                simulator,
                monitor,
                arguments.record,
                True,
                arguments.estimator,
                arguments.parameters,
            )
            return watch(graph, monitor, pairs, console)

    return guarded('drfmcw run', work)


if __name__ == '__main__':
    sys.exit(main())
