"""What a recording says about a site: one row per sweep of each pair, recomputed with the classes of the live nodes."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from drfmcw_fusion.combination import Station, start_delay_excess
from drfmcw_fusion.offline import RecordingReplay, Replay
from drfmcw_fusion.pipeline import USELESS, RangeResult
from drfmcw_fusion.replayed.statistics import reference_at
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.records import Beat
from drfmcw_physics.link_budget import received_power
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.history import History
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.graph.messages import from_message, stamp_ns
from drfmcw_ros.graph.topics import split_station_topic

_SHORTEST = 1.0  # below it the link budget of the far field says nothing [m]


@dataclasses.dataclass(frozen=True)
class StationEvidence:
    """What one station received, one value per row of the pair."""

    name: str
    power: np.ndarray  # at the antenna port [dBm]
    excess: np.ndarray  # over free space; NaN where EIRP or gain is not known [dB]
    snr: np.ndarray  # of the line, in a bin of 1/T_sw [dB]
    noise: np.ndarray  # density [dBm/Hz]
    flags: np.ndarray  # of BeatFrequency
    temperatures: np.ndarray  # of the board, from the status [degC]
    calibrated_at: float  # temperature of the calibration, NaN without one [degC]
    calibrated_within: tuple[float, float]  # coldest and warmest board of the calibration, NaN where not stated [degC]

    @property
    def states_range(self) -> bool:
        """Return whether the calibration states in which range of temperatures it holds."""
        return math.isfinite(self.calibrated_within[0])


@dataclasses.dataclass(frozen=True)
class PairEvidence:
    """One row per sweep with a range; stations in the order of the pair."""

    pair: str
    stamps: np.ndarray  # [ns], increasing
    sweep_ids: np.ndarray
    reference: np.ndarray  # NaN where no reading is near [m]
    reference_std: np.ndarray  # [m]
    range: np.ndarray  # [m]
    range_std: np.ndarray  # [m]
    protection_level: np.ndarray  # [m]
    flags: np.ndarray  # of RangeEstimate
    clock_difference: np.ndarray  # of the references beyond their calibrations [ppm]
    stations: tuple[StationEvidence, ...]

    @property
    def usable(self) -> np.ndarray:
        """Return which ranges a controller may use, shape (n,) of bool."""
        return (self.flags & int(USELESS) == 0) & np.isfinite(self.range)

    @property
    def distance(self) -> np.ndarray:
        """Return the reference distance, the range where there is no reference [m]."""
        return np.where(np.isfinite(self.reference), self.reference, self.range)

    @property
    def error(self) -> np.ndarray:
        """Return range minus reference, NaN without one [m]."""
        return self.range - self.reference


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Everything that a recording says about a site."""

    pairs: tuple[PairEvidence, ...]
    replay: Replay


class _Settings:
    """Settings, calibrations and board temperatures of all stations, by stamp."""

    def __init__(self, bag: BagReader) -> None:
        self.sweeps: dict[tuple[str, str], History[SweepSettings]] = {}
        self.calibrations: dict[str, History[Calibration]] = {}
        self.temperatures: dict[str, History[float]] = {}
        wanted = {t for t in bag.topics if split_station_topic(t)[1] in ('sweep_config', 'calibration', 'status')}
        for topic, _, message in bag.messages(wanted):
            name = split_station_topic(topic)[1]
            if name == 'sweep_config':
                sweep = from_message(message, SweepSettings)
                self.sweeps.setdefault((sweep.station, sweep.peer), History()).add(sweep.stamp, sweep)
            elif name == 'calibration':
                calibration = from_message(message, Calibration)
                self.calibrations.setdefault(calibration.station, History()).add(calibration.stamp, calibration)
            else:
                stamp = stamp_ns(message.header.stamp)
                self.temperatures.setdefault(message.station, History()).add(stamp, message.temperature)

    def _at(self, history: History | None, stamp: int) -> Any:
        found = history.at(stamp) if history is not None else None
        return found[1] if found is not None else None

    def station(self, beat: Beat) -> Station | None:
        """Return a result with the settings and the calibration that hold for it, None where none do."""
        sweep = self._at(self.sweeps.get((beat.station, beat.peer)), beat.stamp)
        if sweep is None:
            return None
        calibration = self.calibration(beat) or Calibration(beat.station)
        if calibration.depends_on_temperature:
            calibration = calibration.at(self.temperature(beat))
        return Station(beat, sweep, calibration)

    def calibration(self, beat: Beat) -> Calibration | None:
        """Return the calibration that holds for a result, None without one."""
        return self._at(self.calibrations.get(beat.station), beat.stamp)

    def temperature(self, beat: Beat) -> float:
        """Return the board temperature at a result [degC], NaN where it is not known."""
        found = self._at(self.temperatures.get(beat.station), beat.stamp)
        return math.nan if found is None else float(found)


def read_evidence(
    path: str, estimator: EstimatorSettings | None = None, progress: Callable[[int], None] | None = None
) -> Evidence:
    """Recompute a recording and return what it says about the site.

    Args:
        path: of the recording.
        estimator: of the stations; None takes the default.
        progress: called with the number of messages read so far.

    Raises:
        BagError: the recording cannot be read or lacks samples or settings.
    """
    with BagReader(path) as bag:
        settings = _Settings(bag)
        latest: dict[tuple[str, str, int], Beat] = {}
        ranges: dict[tuple[str, str], list[tuple[RangeResult, tuple[Beat, ...]]]] = {}

        def observe(beat: Beat, result: RangeResult | None) -> None:
            latest[beat.station, beat.peer, beat.sweep_id] = beat
            if result is None:
                return
            names = (result.first_station, result.second_station)
            members = ((names[0], names[1]), (names[1], names[0]))[: 1 if names[0] == names[1] else 2]
            both = tuple(latest.pop((*member, result.sweep_id)) for member in members)
            ranges.setdefault(names, []).append((result, both))

        replay = RecordingReplay(bag, estimator).run(progress, observe)
    pairs = tuple(_pair(names, rows, settings, replay) for names, rows in sorted(ranges.items()))
    return Evidence(pairs, replay)


def _pair(
    names: tuple[str, str],
    rows: list[tuple[RangeResult, tuple[Beat, ...]]],
    settings: _Settings,
    replay: Replay,
) -> PairEvidence:
    rows = sorted(rows, key=lambda row: row[0].stamp)
    results = [result for result, _ in rows]
    stamps = np.array([r.stamp for r in results], dtype=np.int64)
    reference = replay.reference.of('/'.join(names))
    truth = reference_at(reference, stamps)
    stds = np.interp(stamps, reference.stamps, reference.stds) if len(reference.stamps) else np.zeros(len(stamps))
    distance = np.where(np.isfinite(truth), truth, [r.range for r in results])
    heard = [[settings.station(beat) for beat in both] for _, both in rows]
    count = len(rows[0][1])
    return PairEvidence(
        pair='/'.join(names),
        stamps=stamps,
        sweep_ids=np.array([r.sweep_id for r in results], dtype=np.int64),
        reference=truth,
        reference_std=stds,
        range=np.array([r.range for r in results]),
        range_std=np.array([r.range_std for r in results]),
        protection_level=np.array([r.protection_level for r in results]),
        flags=np.array([r.flags for r in results], dtype=np.int64),
        clock_difference=np.array([_clocks(both, r) for both, r in zip(heard, results, strict=True)]),
        stations=tuple(_station(k, rows, heard, distance, settings) for k in range(count)),
    )


def _clocks(stations: list[Station | None], result: RangeResult) -> float:
    """Return the difference of both references that the calibrations leave [ppm], from the excess of T_off.

    A difference d displaces the excess by d f_c / k (docs/integrity.md); jitter of T_off of 2 ns is 0.05 ppm.
    """
    if len(stations) < 2 or stations[0] is None or stations[1] is None:
        return math.nan
    excess = start_delay_excess(stations[0], stations[1], result.path_delay)
    sweep = stations[0].sweep
    return 1e6 * excess * abs(sweep.chirp_rate) / sweep.center_frequency


def _station(
    k: int,
    rows: list[tuple[RangeResult, tuple[Beat, ...]]],
    heard: list[list[Station | None]],
    distance: np.ndarray,
    settings: _Settings,
) -> StationEvidence:
    beats = [both[k] for _, both in rows]
    own = [stations[k] for stations in heard]
    peers = [stations[-1 - k] for stations in heard]
    expected = np.array([_expected(a, b, d) for a, b, d in zip(own, peers, distance, strict=True)])
    power = np.array([beat.power for beat in beats])
    snr = np.array([beat.snr for beat in beats])
    duration = np.array([s.sweep.ramp_duration if s else math.nan for s in own])
    calibration = settings.calibration(beats[-1])
    return StationEvidence(
        name=beats[0].station,
        power=power,
        excess=power - expected,
        snr=snr,
        noise=power - snr + 10.0 * np.log10(duration),
        flags=np.array([beat.flags for beat in beats], dtype=np.int64),
        temperatures=np.array([settings.temperature(beat) for beat in beats]),
        calibrated_at=calibration.temperature if calibration is not None else math.nan,
        calibrated_within=_range(calibration),
    )


def _range(calibration: Calibration | None) -> tuple[float, float]:
    """Return the range of board temperatures that a calibration states, NaN where it states none [degC]."""
    if calibration is None or calibration.covers(calibration.temperature) is None:
        return math.nan, math.nan
    return calibration.temperature_low, calibration.temperature_high


def _expected(own: Station | None, peer: Station | None, distance: float) -> float:
    """Return the power at the antenna port in free space [dBm], NaN where settings are not known."""
    if own is None or peer is None or not math.isfinite(distance):
        return math.nan
    gain, frequency = own.sweep.rx_antenna_gain, own.sweep.center_frequency
    return float(received_power(peer.sweep.tx_eirp, gain, max(distance, _SHORTEST), frequency))
