"""The pair station: raw sweeps of both stations of a pair in, beat frequencies and spectra of both out."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from drfmcw_physics.rules.history import LIVE
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.nodes.diagnostics import WARN, Status
from drfmcw_ros.nodes.parameters import SettingsParameters

from .processing.pair_processor import PairProcessor
from .processing.records import Sweep
from .station_settings import PairEstimatorSettings, PairStationSettings, antenna_frame, check_pair
from .sweep_node import SweepNode, run_named

_GATHER = 2e-3  # of sweeps that are evaluated together; a pair alone costs as much as three in a batch of eight [s]
_PATIENCE = 1.0  # after which, at the earliest, a sweep is evaluated without its partner [s]


class PairStationNode(SweepNode):
    """Stands in place of a station's node and those of its peers. Topics and parameters: README.md of this package."""

    processor: PairProcessor

    def __init__(self, **kwargs: Any) -> None:
        """Declare the parameters, then begin; `kwargs` go to rclpy's Node."""
        super().__init__('pair_station', PairProcessor(kept=LIVE), PairEstimatorSettings, **kwargs)
        self._settings = settings = SettingsParameters(self, PairStationSettings).value
        check_pair(settings)
        self._pairs = [{settings.first, second} for second in settings.seconds]
        self._last_pairs = (0, 0)
        self._start_diagnostics(settings.first).add('Pairs', self._diagnose_pairs)
        self.begin()

    def configure(self) -> None:
        """Create the topics."""
        super().configure()
        settings = self._settings
        sources = dict.fromkeys(settings.seconds, settings.second_source)
        for station, source in ((settings.first, settings.first_source), *sources.items()):
            prefix = f'/{station}/'
            self._publish_results_of(station, prefix)
            self._listen_to_settings(prefix)
            self._listen_to_sweeps(prefix, source, _GATHER)
        self.create_timer(_PATIENCE, self._give_up)

    def cleanup(self) -> None:
        """Forget what came in."""
        super().cleanup()
        self._last_pairs = (0, 0)

    def _concerns(self, station: str, peer: str) -> bool:
        return {station, peer} in self._pairs

    def _take_sweeps(self, sweeps: Sequence[Sweep]) -> None:
        """Leave out sweeps with other peers: they take turns with these, but are not this node's."""
        own = [s for s in sweeps if self._concerns(s.station, s.peer)]
        super()._take_sweeps([s if s.frame_id else _in_frame(s) for s in own])

    def _give_up(self) -> None:
        """Evaluate alone the sweeps that waited too long for settings or a partner, even if none come any more."""
        if not self.active:
            return
        self._take_sweeps([])
        self._publish(self.processor.give_up())

    def _diagnose_pairs(self, status: Status) -> None:
        processor = self.processor
        pairs, alone = processor.pairs - self._last_pairs[0], processor.unpaired - self._last_pairs[1]
        self._last_pairs = (processor.pairs, processor.unpaired)
        if alone:
            status.report(WARN, f'{alone} sweeps without partner')
        elif not pairs:
            status.report(WARN, 'no pairs')
        status.value('pairs per second', pairs)
        status.value('pairs', processor.pairs)
        status.value('sweeps without partner', processor.unpaired)
        status.value('waiting for their partner', processor.waiting)


def _in_frame(sweep: Sweep) -> Sweep:
    return dataclasses.replace(sweep, frame_id=antenna_frame(sweep.station))


def main(argv: Sequence[str] | None = None) -> int:
    """Run a pair station; return the exit status."""
    own, ros = split_ros_arguments(argv)
    parser = Parser(
        prog='drfmcw pair',
        description='Signal processing of both stations of a pair, where the raw sweeps of both are at hand: '
        'sweeps in, beat frequencies and spectra out. All parameters: src/drfmcw_node/README.md.',
        epilog='Anything after --ros-args goes to ROS, for instance: --ros-args -p second_source:=topic',
    )
    parser.add_argument('--first', metavar='NAME', help='name of the one station (parameter first)')
    parser.add_argument('--second', metavar='NAME[,NAME]', help='name of the other, or of several (parameter second)')
    parser.add_argument('--config', metavar='FILE', help='ROS parameter file (YAML)')
    arguments = parser.parse_args(own)
    stations = {'first': arguments.first, 'second': arguments.second}
    return guarded(parser.prog, lambda: run_named(PairStationNode, stations, arguments.config, ros))


if __name__ == '__main__':
    raise SystemExit(main())
