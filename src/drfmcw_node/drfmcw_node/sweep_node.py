"""What all nodes that evaluate sweeps share: settings and sweeps from topics, results, warnings, diagnostics."""

import collections
import dataclasses
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from drfmcw_msgs.msg import (
    BeatFrequency,
    CompressedIfSamples,
    IfSamples,
    IfSpectrum,
    StationCalibration,
    StationStatus,
    SweepConfig,
)

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.plausible import printable
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import check, from_message, publish, stamp_ns, to_message
from drfmcw_ros.graph.topics import DISPLAYED
from drfmcw_ros.nodes.diagnostics import ERROR, WARN, Diagnostics, Status
from drfmcw_ros.nodes.managed import ManagedNode
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import run

from .compression import CompressionError, decompress_message
from .estimators.estimation import EstimatorSettings, Flag
from .processing.early import EarlySweeps
from .processing.excerpt import Excerpt
from .processing.processor import StationProcessor
from .processing.records import Beat, Spectrum, Sweep
from .station_settings import SpectrumSettings, is_station_name

_REPORT_INTERVAL = 10.0  # between repetitions of the same warning [s]
_MOST_REPORTS = 20  # different warnings in that time
_LATCHED_DEPTH = 32  # settings for so many peers

T = TypeVar('T')


@dataclasses.dataclass(frozen=True)
class _Publishers:
    """Of one station's results: of all sweeps, and of the excerpt that displays get."""

    beats: Any
    spectra: Any
    shown_beats: Any
    shown_spectra: Any


class SweepNode(ManagedNode):
    """Shell around a `StationProcessor`; a subclass chooses the topics in `configure`, after that of this class."""

    def __init__(self, name: str, processor: StationProcessor, estimation: type = EstimatorSettings, **kwargs: Any):
        """Declare the parameters that all such nodes share.

        Args:
            name: of the node.
            processor: that evaluates the sweeps.
            estimation: class of the estimation's settings.
            kwargs: go to rclpy's Node.

        Raises:
            ConfigurationError: a value given at start is wrong.
        """
        super().__init__(name, **kwargs)
        self.lock = threading.RLock()
        """Held while the processor works: a source delivers in its own thread."""
        self._new_processor = type(processor)
        self.processor = processor
        """Evaluates the sweeps."""
        self._estimation = SettingsParameters(self, estimation, on_change=self._change_estimation)
        processor.settings = self._estimation.value
        self._spectrum = SettingsParameters(self, SpectrumSettings)
        self._first = qos.FirstTopics(self)  # settings and calibrations: before the sweeps that need them
        self._early = EarlySweeps(processor)
        self._sweep_subscriptions: dict[str, Any] = {}  # by topic, each matched with all publishers
        self._results: dict[str, _Publishers] = {}  # by station
        self._excerpt = Excerpt()
        self._seen: dict[str, int] = {}
        self._last_report = (0, 0)
        self._rate_time = time.monotonic()
        self._refused = self._refused_before = 0  # messages
        self._refusal = ''  # why the last one was
        self._flags: collections.Counter[str] = collections.Counter()
        self._snr: collections.deque[float] = collections.deque(maxlen=1000)
        self._reported: dict[str, float] = {}

    def configure(self) -> None:
        """Begin without topics, as after the constructor."""
        self._first = qos.FirstTopics(self)
        self._sweep_subscriptions, self._results = {}, {}

    def cleanup(self) -> None:
        """Forget all sweeps, settings and calibrations."""
        with self.lock:
            self.processor = self._new_processor()
            self.processor.settings = self._estimation.value
        self._early = EarlySweeps(self.processor)
        self._seen, self._last_report = {}, (0, 0)

    def _publish_results_of(self, station: str, prefix: str) -> None:
        """Create the publishers of a station's results; `prefix` stands before the topics' last names."""
        self._results[station] = _Publishers(
            qos.publisher(self, BeatFrequency, f'{prefix}beat_frequency', qos.DEEP),
            qos.publisher(self, IfSpectrum, f'{prefix}if_spectrum', qos.RELIABLE),
            qos.publisher(self, BeatFrequency, prefix + DISPLAYED['beat_frequency'], qos.RELIABLE),
            qos.publisher(self, IfSpectrum, prefix + DISPLAYED['if_spectrum'], qos.RELIABLE),
        )

    def _start_diagnostics(self, hardware_id: str) -> Diagnostics:
        """Start the diagnostics; return them, so that further tasks can be added."""
        diagnostics = Diagnostics(self, hardware_id, self.state)
        diagnostics.add('Sweeps', self._diagnose_sweeps)
        diagnostics.add('Source', self._diagnose_source)
        diagnostics.add('Inputs', self._diagnose_inputs)
        return diagnostics

    # --- settings, calibrations and sweeps from topics ---

    def _listen_to_settings(self, prefix: str) -> None:
        latched = qos.latched_subscription(_LATCHED_DEPTH)
        self._first.subscription(SweepConfig, f'{prefix}sweep_config', self._take_sweep_config, latched)
        self._listen_to_calibration(prefix)

    def _listen_to_calibration(self, prefix: str) -> None:
        topic = f'{prefix}calibration'
        latched = qos.latched_subscription(_LATCHED_DEPTH)
        self._first.subscription(StationCalibration, topic, self._take_calibration, latched)
        self._first.subscription(StationStatus, f'{prefix}status', self._take_status, qos.RELIABLE)

    def _listen_to_sweeps(self, prefix: str, source: str, gather: float) -> None:
        """Take sweeps from a station's topic: `source` is 'topic' or 'compressed'; `gather` as qos.subscription."""
        if source == 'topic':
            kind, name, take = IfSamples, 'if_samples', self._take_samples
        else:
            kind, name, take = CompressedIfSamples, 'if_samples_compressed', self._take_compressed

        def note(created: Any) -> None:
            self._sweep_subscriptions[created.topic_name] = created

        qos.stream(self, kind, prefix + name, take, qos.RELIABLE, gather, note)

    def _concerns(self, station: str, peer: str) -> bool:
        """Return True for settings that this node's sweeps may need."""
        raise NotImplementedError

    def _take_sweep_config(self, message: SweepConfig) -> None:
        settings = self.converted(message, SweepSettings, 'sweep_config')
        if settings is not None and self._concerns(settings.station, settings.peer):
            self._add_sweep_config(settings)
            self._take_sweeps([])

    def _add_sweep_config(self, settings: SweepSettings) -> None:
        self.processor.add_sweep_config(settings)

    def _take_calibration(self, message: StationCalibration) -> None:
        calibration = self.converted(message, Calibration, 'calibration')
        if calibration is not None:
            self.processor.add_calibration(calibration)
            self._take_sweeps([])

    def _take_status(self, message: StationStatus) -> None:
        """Take in a board temperature, on which calibrated clocks may depend."""
        try:
            check(message)
        except ConfigurationError as error:
            self._refused += 1
            self._refusal = f'status of {printable(message.station)}: {error}'
            self.warn(f'refused {self._refusal}')
            return
        with self.lock:
            self.processor.add_board_temperature(
                message.station, stamp_ns(message.header.stamp), float(message.temperature)
            )

    def converted(self, message: Any, cls: Callable[..., T], topic: str) -> T | None:
        """Return a message as `cls`; None, counted and reported, where it holds values that cannot be."""
        try:
            return from_message(message, cls)
        except ConfigurationError as error:
            self._refused += 1
            self._refusal = f'{topic} of {printable(message.station)}: {error}'
            self.warn(f'refused {self._refusal}')
            return None

    def _take_samples(self, messages: Sequence[IfSamples]) -> None:
        self._first.poll()
        sweeps = (self.converted(message, Sweep, f'sweep {message.sweep_id}') for message in messages)
        self._take_sweeps([sweep for sweep in sweeps if sweep is not None])

    def _take_compressed(self, messages: Sequence[CompressedIfSamples]) -> None:
        self._first.poll()
        sweeps = []
        for message in messages:
            try:
                check(message)
                sweeps.append(decompress_message(message))
            except (CompressionError, ConfigurationError) as error:
                self.processor.sweeps += 1
                self.processor.drop('damaged compressed sweep')
                self.warn(f'compressed sweep {message.sweep_id} of {printable(message.station)}: {error}')
        self._take_sweeps(sweeps)

    def _take_sweeps(self, sweeps: Sequence[Sweep]) -> None:
        """Evaluate the sweeps whose settings are known; the others wait a moment for them. Inactive, drop them."""
        if not self.active:
            return
        self._process(self._early.release(sweeps, time.monotonic()))

    # --- results ---

    def _process(self, sweeps: list[Sweep]) -> None:
        """Evaluate a batch and publish what is wanted of it."""
        if sweeps:
            self._evaluate(sweeps)

    def _evaluate(self, sweeps: Sequence[Sweep]) -> None:
        """Publish beat frequencies and, where wanted and taken by somebody, spectra of a batch, and the excerpt."""
        settings, topics = self._spectrum.value, self._results.values()
        every = settings.spectrum_decimation if any(t.spectra.get_subscription_count() for t in topics) else 0
        shown = any(t.shown_beats.get_subscription_count() or t.shown_spectra.get_subscription_count() for t in topics)

        def is_due(sweep: Sweep | Spectrum) -> bool:
            return every > 0 and sweep.sweep_id % every == 0

        def wanted(sweep: Sweep) -> bool:
            chosen = shown and self._excerpt.choose(sweep)
            return settings.spectrum and (chosen or is_due(sweep))

        with self.lock:
            self._excerpt.begin(time.monotonic())
            beats, spectra = self.processor.process_with_spectra(sweeps, wanted)
            results: list[Beat | Spectrum] = [*beats, *spectra] if shown else []
            excerpt = [result for result in results if self._excerpt.holds(result)]
        self._publish(beats)
        for spectrum in filter(is_due, spectra):
            self._results[spectrum.station].spectra.publish(to_message(spectrum, IfSpectrum))
        for result in excerpt:
            publishers = self._results[result.station]
            publish(publishers.shown_beats if isinstance(result, Beat) else publishers.shown_spectra, result)

    def _publish(self, beats: Sequence[Beat]) -> None:
        for beat in beats:
            self._results[beat.station].beats.publish(to_message(beat, BeatFrequency))
        self._note(beats)

    def _note(self, beats: Sequence[Beat]) -> None:
        """Keep what the diagnostics report."""
        for beat in beats:
            self._snr.append(beat.snr)
            if beat.flags:
                for flag in Flag(beat.flags):
                    self._flags[str(flag.name)] += 1
        dropped = self.processor.dropped
        if dropped.total() != sum(self._seen.values()):
            for reason, count in dropped.items():
                if count != self._seen.get(reason, 0):
                    self.warn(f'sweeps dropped: {reason}')
            self._seen = dict(dropped)

    def _change_estimation(self, settings: EstimatorSettings) -> None:
        with self.lock:
            self.processor.settings = settings

    def warn(self, text: str) -> None:
        """Log a warning, the same one at most every ten seconds, and no more different ones than `_MOST_REPORTS`."""
        now = time.monotonic()
        if now - self._reported.get(text, -math.inf) <= _REPORT_INTERVAL:
            return
        self._reported = {known: at for known, at in self._reported.items() if now - at <= _REPORT_INTERVAL}
        if len(self._reported) < _MOST_REPORTS:  # what comes from outside can differ each time
            self._reported[text] = now
            self.get_logger().warning(text)

    def now(self) -> int:
        """Return the time of the node's clock [ns]."""
        return int(self.get_clock().now().nanoseconds)

    # --- once a second ---

    def _diagnose_sweeps(self, status: Status) -> None:
        with self.lock:
            processor = self.processor
            sweeps, dropped = processor.sweeps, processor.dropped.total()
            now = time.monotonic()
            new, lost = sweeps - self._last_report[0], dropped - self._last_report[1]
            rate = new / max(now - self._rate_time, 1e-3)
            self._last_report, self._rate_time = (sweeps, dropped), now
            flags, snr = dict(self._flags), list(self._snr)
            self._flags.clear()
            self._snr.clear()
            reasons = dict(processor.dropped)
        if not new:
            status.report(WARN, 'no sweeps')
        if lost:
            status.report(WARN, f'{lost} of {new} sweeps dropped')
        for name, count in flags.items():
            status.report(WARN, f'{count} of {new} sweeps {name.lower().replace("_", " ")}')
        status.value('sweeps per second', rate)
        status.value('sweeps', sweeps)
        status.value('dropped', dropped)
        status.value('weak', processor.weak)
        status.value('median SNR [dB]', float(np.median(snr)) if snr else math.nan)
        for reason, count in reasons.items():
            status.value(f'dropped: {reason}', count)
        for publishers in self._results.values():
            beats = publishers.beats
            status.value(f'subscribers of {beats.topic_name}', beats.get_subscription_count())

    def _diagnose_inputs(self, status: Status) -> None:
        new, self._refused_before = self._refused - self._refused_before, self._refused
        if new:
            status.report(ERROR, f'{new} messages refused, last: {self._refusal}')
        status.value('refused messages', self._refused)

    def _diagnose_source(self, status: Status) -> None:
        for topic, subscription in self._sweep_subscriptions.items():
            publishers = subscription.get_publisher_count()
            status.value(f'publishers of {topic}', publishers)
            if not publishers:
                status.report(WARN, f'nobody publishes {topic}')


def run_named(
    node_class: type, stations: Mapping[str, str | None], config: str | None, ros_arguments: Sequence[str]
) -> int:
    """Run a node in the namespace of its station; return the exit status.

    Args:
        node_class: as `drfmcw_ros.nodes.runner.run` takes it.
        stations: parameters that name stations, the one that gives the namespace first, and the names given on the
            command line, None for those that were not.
        config: ROS parameter file, None for none.
        ros_arguments: from --ros-args on.

    Raises:
        ConfigurationError: the parameter file cannot be read.
    """
    extra = []
    if config is not None:
        try:
            open(config, encoding='utf-8').close()
        except OSError as error:
            raise ConfigurationError(f'{config}: {error.strerror}') from None
        extra += ['--params-file', config]
    for parameter, name in stations.items():
        if name is not None:
            extra += ['-p', f'{parameter}:={name}']
    assigned = dict(a.split(':=', 1) for a in [*ros_arguments, *extra] if ':=' in a)
    name = assigned.get(next(iter(stations)), '').strip('"\'')
    if '__ns' not in assigned and is_station_name(name):
        extra += ['-r', f'__ns:=/{name}']  # so that several stations can run on one machine
    arguments = ['--ros-args', *(a for a in ros_arguments if a not in ('--ros-args', '--')), *extra]
    return run(node_class, arguments)
