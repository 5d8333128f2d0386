"""Recomputing a recording's ranges offline with the classes the live nodes use."""

import collections
import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.pair_processor import PairProcessor
from drfmcw_node.processing.processor import StationProcessor
from drfmcw_node.processing.records import Beat, Sweep
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import nearest
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.graph.messages import ImplausibleError, check, from_message, stamp_ns
from drfmcw_ros.graph.topics import SITE_TOPICS, is_measured, split_station_topic

from .pipeline import RangeFusion, RangeResult
from .settings import FusionSettings

_REASONS_SHOWN = 10  # of refused messages
_CHUNK = 512  # sweeps estimated at once: enough to batch, little enough to stay in the cache

_WEATHER = {
    '/site/temperature': ('temperature', 'temperature'),
    '/site/pressure': ('pressure', 'fluid_pressure'),
    '/site/humidity': ('humidity', 'relative_humidity'),
}


@dataclasses.dataclass(frozen=True)
class Reference:
    """Readings of the reference instrument."""

    stamps: np.ndarray  # [ns], increasing
    ranges: np.ndarray  # [m]
    stds: np.ndarray  # [m]
    frames: np.ndarray  # frame_id of each reading

    def of(self, pair: str) -> 'Reference':
        """Return the readings that belong to a pair ('first/second'): those that name it as frame_id, else all."""
        own = self.frames == pair
        if not own.any():
            own = ~np.char.count(self.frames, '/').astype(bool)  # another pair's readings say nothing about this one
        return Reference(self.stamps[own], self.ranges[own], self.stds[own], self.frames[own])


@dataclasses.dataclass(frozen=True)
class Replay:
    """Everything recomputed from one recording."""

    results: list[RangeResult]
    reference: Reference
    missing: list[str]  # what the recording lacks, and what follows from that
    sweeps: int
    dropped: dict[str, int]  # reason: sweeps without a range


def read_weather(topic: str, message: Any) -> tuple[str, float]:
    """Return (quantity, value) of a message on one of the /site topics, as RangeFusion.add_weather takes it.

    Raises:
        ImplausibleError: no weather has that value.
    """
    check(message)
    quantity, field = _WEATHER[topic]
    return quantity, float(getattr(message, field))


def weather_std(message: Any) -> float:
    """Return the standard deviation that a message of a weather sensor states, in its unit; 0 where it states none."""
    variance = float(message.variance)
    return math.sqrt(variance) if 0.0 < variance < math.inf else 0.0


def is_weather(topic: str) -> bool:
    """Return True for the topics of the weather sensors."""
    return topic in _WEATHER


class RecordingReplay:
    """Streams one recording through the stations' processors and the fusion."""

    def __init__(
        self,
        bag: BagReader,
        estimator: EstimatorSettings | None = None,
        fusion: FusionSettings | None = None,
        stations: list[str] | None = None,
        calibrations: Sequence[Calibration] = (),
    ) -> None:
        """Check that the recording holds what is needed.

        Args:
            bag: the open recording.
            estimator: settings of the stations' estimator.
            fusion: settings of the fusion.
            stations: only these; None takes all whose samples are recorded.
            calibrations: of some stations, used instead of the recorded ones from the beginning.

        Raises:
            BagError: no samples, no settings of a station, or a station that is not in the recording.
        """
        self._bag = bag
        recorded = [split_station_topic(t)[0] for t in bag.topics if split_station_topic(t)[1] == 'if_samples']
        if not recorded:
            raise BagError(f"{bag.path}: holds no '/<station>/if_samples'; topics: {', '.join(sorted(bag.topics))}")
        for station in [*(stations or []), *(c.station for c in calibrations)]:
            if station not in recorded:
                raise BagError(f"{bag.path}: unknown station '{station}'{nearest(station, recorded)}")
        self.stations = stations or recorded
        for station in self.stations:
            bag.require(f'/{station}/sweep_config')
        self.missing = [f'{topic} is missing: {why}' for topic, why in self._optional() if topic not in bag.topics]
        estimator = estimator or EstimatorSettings()
        self._fusion = RangeFusion(fusion)
        self._processor = PairProcessor(estimator) if estimator.estimator == 'pair' else StationProcessor(estimator)
        self._calibrated = {c.station for c in calibrations}
        for calibration in calibrations:
            for consumer in (self._fusion, self._processor):
                consumer.add_calibration(dataclasses.replace(calibration, stamp=0))
        for name in set(self.stations) - self._calibrated:
            if f'/{name}/calibration' not in bag.topics:  # nominal clocks; the ranges are flagged as uncalibrated
                self._processor.add_calibration(Calibration(name))
        self._pending: list[Sweep] = []
        self._reference: list[tuple[int, float, float, str]] = []
        self._sweeps = 0
        self._observe: Callable[[Beat, RangeResult | None], None] | None = None
        self._refused: collections.Counter[str] = collections.Counter()  # messages by reason

    def _optional(self) -> Iterator[tuple[str, str]]:
        for station in self.stations:
            yield f'/{station}/calibration', f"the clocks of '{station}' count as nominal and its delay as zero"
        yield '/site/temperature', 'the default weather is used'
        yield '/site/pressure', 'the default weather is used'
        yield '/site/humidity', 'the default weather is used'
        yield '/reference/range', 'no error against a reference is known'

    def run(
        self,
        progress: Callable[[int], None] | None = None,
        observe: Callable[[Beat, RangeResult | None], None] | None = None,
    ) -> Replay:
        """Recompute everything.

        Args:
            progress: called with the number of messages read so far.
            observe: called with each station's result, and the range that it completes, None without one.
        """
        self._observe = observe
        results: list[RangeResult] = []
        samples = {f'/{name}/if_samples' for name in self.stations}
        # everything is looked up by stamp: first all that sweeps depend on, whenever it was written, then the sweeps
        first = {t for t in self._bag.topics if is_measured(t) and split_station_topic(t)[1] != 'if_samples'}
        for topic, _, message in self._bag.messages(first):
            try:
                self._take(topic, message)
            except ImplausibleError as error:
                self._refused[f'{topic}: {error}'] += 1
        for count, (topic, _, message) in enumerate(self._bag.messages(samples)):
            self._sweeps += 1
            try:
                self._pending.append(from_message(message, Sweep))
            except ImplausibleError as error:
                self._refused[f'{topic}: {error}'] += 1
            if len(self._pending) >= _CHUNK:
                results.extend(self._process())
            if progress is not None and count % 100 == 0:
                progress(count)
        results.extend(self._process())
        if isinstance(self._processor, PairProcessor):
            results.extend(self._combine(self._processor.finish()))
        readings = sorted(self._reference)
        stamps, ranges, stds, frames = zip(*readings, strict=True) if readings else ((), (), (), ())
        dropped = collections.Counter(self._processor.dropped)
        dropped[self._fusion.reason] += self._fusion.unpaired + self._fusion.without_settings
        return Replay(
            results=results,
            reference=Reference(
                np.array(stamps, dtype=np.int64),
                np.array(ranges, dtype=float),
                np.array(stds, dtype=float),
                np.array(frames, dtype=str),
            ),
            missing=[*self.missing, *_summary(self._refused)],
            sweeps=self._sweeps,
            dropped={reason: count for reason, count in dropped.items() if count},
        )

    def doppler_scale(self, station: str) -> float:
        """Return the range that a velocity adds to a rising ramp's of a station that hears itself, f_c / k [s]."""
        sweep = self._fusion.sweep_config(station, station, 1 << 62)
        return sweep.center_frequency / abs(sweep.chirp_rate) if sweep is not None else math.nan

    def _take(self, topic: str, message: Any) -> None:
        """Take in one message that is no sweep.

        Raises:
            ImplausibleError: it holds a value that cannot be.
        """
        check(message)
        station, name = split_station_topic(topic)
        stamp = stamp_ns(message.header.stamp)
        if topic in SITE_TOPICS:
            if is_weather(topic):
                quantity, value = read_weather(topic, message)
                self._fusion.add_weather(quantity, stamp, value, weather_std(message))
            else:
                self._reference.append((stamp, message.range, message.range_std, message.header.frame_id))
        elif name == 'sweep_config':
            sweep = from_message(message, SweepSettings)
            self._fusion.add_sweep_config(sweep)
            self._processor.add_sweep_config(sweep)
        elif name == 'calibration' and station not in self._calibrated:
            calibration = from_message(message, Calibration)
            self._fusion.add_calibration(calibration)
            self._processor.add_calibration(calibration)
        elif name == 'status':
            for consumer in (self._fusion, self._processor):
                consumer.add_board_temperature(station, stamp, message.temperature)

    def _process(self) -> Iterator[RangeResult]:
        """Estimate the pending sweeps and yield the ranges of those whose partner is there too."""
        beats = self._processor.process(self._pending)
        self._pending.clear()
        return self._combine(beats)

    def _combine(self, beats: list[Beat]) -> Iterator[RangeResult]:
        """Yield the ranges of beat frequencies whose partner is there too."""
        for beat in sorted(beats, key=lambda b: (b.stamp, b.sweep_id)):
            result = self._fusion.add_beat(beat)
            if self._observe is not None:
                self._observe(beat, result)
            if result is not None:
                yield result


def _summary(refused: collections.Counter[str]) -> list[str]:
    """Return one line per reason, the most frequent ones."""
    lines = [f'refused {count} messages: {reason}' for reason, count in refused.most_common(_REASONS_SHOWN)]
    rest = len(refused) - len(lines)
    return [*lines, f'refused messages for {rest} further reasons'] if rest else lines


def replay_recording(
    path: str,
    estimator: EstimatorSettings | None = None,
    fusion: FusionSettings | None = None,
    stations: list[str] | None = None,
    progress: Callable[[int], None] | None = None,
    calibrations: Sequence[Calibration] = (),
) -> Replay:
    """Recompute all ranges of a recording; arguments and errors as RecordingReplay."""
    with BagReader(path) as bag:
        return RecordingReplay(bag, estimator, fusion, stations, calibrations).run(progress)
