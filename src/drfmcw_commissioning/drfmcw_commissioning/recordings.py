"""Ranges of a recording with the conditions of each, evaluated with calibrations other than the recorded ones."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from drfmcw_diagnosis.recording.conditions import Conditions
from drfmcw_fusion.offline import RecordingReplay, Reference
from drfmcw_fusion.pipeline import RangeResult
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.records import Beat
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import SweepSettings
from drfmcw_ros.bag.files import BagReader
from drfmcw_ros.graph.topics import is_measured, split_station_topic


@dataclasses.dataclass(frozen=True)
class Ranges:
    """Ranges of one pair, or of one station that hears itself, in order of their stamps."""

    stations: tuple[str, ...]  # first and second, or the one
    results: list[RangeResult]
    beats: list[Beat]  # of the stations, whether or not a range came of them
    calibrations: tuple[Calibration, ...]  # of the stations, as used
    board: np.ndarray  # (stations, n) board temperatures, NaN without status [degC]
    sweeps: list[tuple[SweepSettings, ...]]  # settings of the stations at each sweep
    reference: Reference


def read_ranges(
    path: str, calibrations: Sequence[Calibration] = (), velocity: str = 'standing', station: str | None = None
) -> Ranges:
    """Return the ranges of a recording, by maximum likelihood.

    Args:
        path: of the recording.
        calibrations: used instead of the recorded ones.
        velocity: as FusionSettings.
        station: that takes part in the pair; None takes the pair with most ranges.

    Raises:
        ConfigurationError: the recording cannot be read or holds no ranges of such a pair.
    """
    with BagReader(path) as bag:
        conditions = Conditions()
        topics = {t for t in bag.topics if is_measured(t) and split_station_topic(t)[1] != 'if_samples'}
        for topic, _, message in bag.messages(topics):
            conditions.take(topic, message)
        engine = RecordingReplay(
            bag, EstimatorSettings(estimator='ml'), FusionSettings(velocity=velocity), calibrations=calibrations
        )
        beats: list[Beat] = []
        replay = engine.run(observe=lambda beat, result: beats.append(beat))
    pairs: dict[tuple[str, str], list[RangeResult]] = {}
    for result in replay.results:
        names = (result.first_station, result.second_station)
        if station is None or station in names:
            pairs.setdefault(names, []).append(result)
    if not pairs:
        of = f" of '{station}'" if station else ''
        raise ConfigurationError(f'{path}: no range{of} could be computed from {replay.sweeps} sweeps')
    names, results = max(pairs.items(), key=lambda item: len(item[1]))
    results.sort(key=lambda result: result.stamp)
    stations = names if names[0] != names[1] else names[:1]
    stamps = np.array([result.stamp for result in results], dtype=np.int64)
    given = {c.station: c for c in calibrations}
    return Ranges(
        stations=stations,
        results=results,
        beats=[beat for beat in beats if beat.station in stations and beat.peer in stations],
        calibrations=tuple(given.get(s) or conditions.calibration(s, int(stamps[0])) for s in stations),
        board=np.array([conditions.board_temperature(s, stamps) for s in stations]),
        sweeps=[conditions.settings_at(stations, int(stamp)) for stamp in stamps],
        reference=replay.reference.of('/'.join(names)),
    )
