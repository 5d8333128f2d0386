"""A scenario through the classes of the live nodes, without a recording between."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from drfmcw_fusion.offline import is_weather
from drfmcw_fusion.pipeline import RangeFusion, RangeResult
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.processing.records import Sweep
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import SweepSettings
from drfmcw_sim.scenario import Scenario
from drfmcw_sim.timeline import Event, Timeline

_BLOCK = 64  # measurements rendered at once


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """Ranges of a scenario's first pair, one per sweep."""

    results: list[RangeResult]
    true_range: np.ndarray  # (n,) [m]
    board: dict[str, np.ndarray]  # true temperature of each station's board at each sweep, (n,) [degC]


def evaluate(scenario: Scenario, calibrations: Mapping[str, Calibration]) -> Evaluated:
    """Return the ranges that stations with these calibrations measure in a scenario of standing distances."""
    chain = _Chain(calibrations)
    timeline = Timeline(scenario)
    times, distances = [], []
    for event in timeline.opening():
        chain.take(event)
    while not timeline.finished:
        slots = timeline.slots(_BLOCK)
        if not len(slots):
            for event in timeline.due_mode_changes():
                chain.take(event)
            continue
        for event in timeline.render(slots):
            chain.take(event)
        chain.process()
        timeline.advance(len(slots))
        times.append(slots.time)
        distances.append(slots.distance)
    time = np.concatenate(times)
    board = {name: settings.board_temperature.at(time) for name, settings in scenario.stations.items()}
    return Evaluated(chain.results, np.concatenate(distances), board)


def heard(scenario: Scenario, station: str) -> tuple[SweepSettings, list[Sweep]]:
    """Return a station's settings and the sweeps that it records in a scenario at one distance."""
    timeline = Timeline(scenario)
    settings = next(s for s in timeline.sweep_settings(0) if s.station == station)
    sweeps = []
    while len(slots := timeline.slots(_BLOCK)):
        sweeps += [_sweep(e) for e in timeline.render(slots) if e.topic == f'/{station}/if_samples']
        timeline.advance(len(slots))
    return settings, sweeps


def _sweep(event: Event) -> Sweep:
    return Sweep(**{field.name: getattr(event.content, field.name) for field in dataclasses.fields(Sweep)})


class _Chain:
    """Both stations' processors and the fusion."""

    def __init__(self, calibrations: Mapping[str, Calibration]) -> None:
        self.results: list[RangeResult] = []
        self._processor = StationProcessor(EstimatorSettings(estimator='ml'))
        self._fusion = RangeFusion(FusionSettings(velocity='standing'))
        self._sweeps: list[Sweep] = []
        for calibration in calibrations.values():
            for consumer in (self._processor, self._fusion):
                consumer.add_calibration(dataclasses.replace(calibration, stamp=0))

    def take(self, event: Event) -> None:
        """Take in what a simulated site publishes, but for the calibrations."""
        content, name = event.content, event.topic.rpartition('/')[2]
        if name == 'if_samples':
            self._sweeps.append(_sweep(event))
        elif name == 'sweep_config':
            for consumer in (self._processor, self._fusion):
                consumer.add_sweep_config(content)
        elif name == 'status':
            for consumer in (self._processor, self._fusion):
                consumer.add_board_temperature(content.station, event.stamp, content.temperature)
        elif is_weather(event.topic):
            values = (content.temperature, content.fluid_pressure, content.relative_humidity)
            value = next(v for v in values if v is not None)
            self._fusion.add_weather(name, event.stamp, value, math.sqrt(content.variance))

    def process(self) -> None:
        """Turn the sweeps so far into ranges."""
        for beat in self._processor.process(self._sweeps):
            result = self._fusion.add_beat(beat)
            if result is not None:
                self.results.append(result)
        self._sweeps.clear()
