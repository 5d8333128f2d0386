"""What is known besides the samples, looked up by stamp: settings, calibrations, temperatures, weather, reference."""

import dataclasses
import functools
import sys
from collections.abc import Collection, Sequence
from typing import Any, TypeVar, cast

import numpy as np

from drfmcw_fusion.offline import Reference, is_weather, read_weather
from drfmcw_fusion.settings import FusionSettings
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.history import History
from drfmcw_physics.sweep import Role, SweepSettings
from drfmcw_ros.graph.messages import from_message, stamp_ns
from drfmcw_ros.graph.topics import SITE_TOPICS, split_station_topic

WEATHER = ('temperature', 'pressure', 'humidity')
"""Quantities of the weather."""

T = TypeVar('T')


class Conditions:
    """Everything that a recording, or the live graph, holds besides the samples."""

    def __init__(self, limit: int = sys.maxsize) -> None:
        """Know nothing yet; keep at most `limit` values of each kind, dropping the oldest."""
        self._limit = limit
        self._settings: dict[tuple[str, str], History[SweepSettings]] = {}
        self._calibrations: dict[str, History[Calibration]] = {}
        self._temperatures: dict[str, History[float]] = {}
        self._weather: dict[str, History[float]] = {}
        self._readings: dict[str, History[tuple[float, float]]] = {}  # (range, std) [m] by frame_id

    def take(self, topic: str, message: Any) -> None:
        """Take in one message that is no sweep.

        Raises:
            ConfigurationError: settings or a calibration that no radar can have.
        """
        name = split_station_topic(topic)[1]
        stamp = stamp_ns(message.header.stamp)
        if is_weather(topic):
            quantity, value = read_weather(topic, message)
            if np.isfinite(value):
                self._add(self._weather, quantity, stamp, value)
        elif topic in SITE_TOPICS:
            if np.isfinite(message.range):
                reading = (float(message.range), float(message.range_std))
                self._add(self._readings, message.header.frame_id, stamp, reading)
        elif name == 'sweep_config':
            sweep = from_message(message, SweepSettings)
            self._add(self._settings, (sweep.station, sweep.peer), stamp, sweep)
        elif name == 'calibration':
            calibration = from_message(message, Calibration)
            self._add(self._calibrations, calibration.station, stamp, calibration)
        elif name == 'status':
            self._add(self._temperatures, message.station, stamp, float(message.temperature))

    def _add(self, histories: dict[Any, History[T]], key: Any, stamp: int, value: T) -> None:
        if key not in histories:
            histories[key] = History(self._limit)
        histories[key].add(stamp, value)

    def keep(self, start: int, end: int) -> None:
        """Drop what holds nowhere between two stamps [ns]."""
        for histories in (self._settings, self._calibrations, self._temperatures, self._weather, self._readings):
            for history in histories.values():
                history.keep(start, end)

    def ordered(self, stations: Sequence[str]) -> tuple[str, str] | None:
        """Return (first, second) of a pair's stations, None where the settings of neither are known."""
        one, other = stations[0], stations[-1]
        for own, peer in ((one, other), (other, one)):
            history = self._settings.get((own, peer))
            latest = history.latest() if history else None
            if latest is not None:
                return (own, peer) if latest.role == Role.FIRST or own == peer else (peer, own)
        return None

    def unknown(self, stations: Sequence[str]) -> list[str]:
        """Return the stations' topics without a message so far, though each station latches them."""
        pairs = zip(stations, reversed(stations), strict=True)
        lacking = [f'/{own}/sweep_config' for own, peer in pairs if (own, peer) not in self._settings]
        return lacking + [f'/{own}/calibration' for own in stations if own not in self._calibrations]

    def settings_at(self, stations: Sequence[str], stamp: int) -> tuple[SweepSettings, ...]:
        """Return the settings of all stations at `stamp`; those of a station without any follow its peer's."""
        histories = [self._settings.get(pair) for pair in zip(stations, reversed(stations), strict=True)]
        return _completed(tuple(stations), tuple(holding(h, stamp) if h else None for h in histories))

    def calibration(self, station: str, stamp: int) -> Calibration:
        """Return a station's calibration at `stamp`, a nominal one where it publishes none."""
        history = self._calibrations.get(station)
        return holding(history, stamp) if history else Calibration(station)

    def board_temperature(self, station: str, stamps: np.ndarray) -> np.ndarray:
        """Return a board's temperature at each stamp, (n,) NaN without any reading [degC]."""
        return _held(self._temperatures.get(station), stamps, np.nan)

    def weather(self, stamps: np.ndarray) -> dict[str, np.ndarray]:
        """Return the weather at each stamp by quantity, (n,) each, the fusion's defaults without a reading."""
        defaults = FusionSettings()
        return {q: _held(self._weather.get(q), stamps, getattr(defaults, f'default_{q}')) for q in WEATHER}

    def reference(self, stations: Sequence[str]) -> Reference:
        """Return the readings of the reference instrument that belong to the pair."""
        readings = sorted((s, *value, frame) for frame, history in self._readings.items() for s, value in history)
        stamps, ranges, stds, frames = zip(*readings, strict=True) if readings else ((), (), (), ())
        return Reference(
            np.array(stamps, dtype=np.int64),
            np.array(ranges, dtype=float),
            np.array(stds, dtype=float),
            np.array(frames, dtype=str),
        ).of(f'{stations[0]}/{stations[-1]}')

    def lacking(self, stations: Sequence[str]) -> frozenset[str]:
        """Return the missing topics of calibration and weather, for which nominal values and defaults are used."""
        calibrations = {f'/{s}/calibration' for s in stations if s not in self._calibrations}
        return frozenset(calibrations | {f'/site/{q}' for q in WEATHER if q not in self._weather})

    def missing(
        self, stations: Sequence[str], sampled: Collection[str], sweeps: tuple[SweepSettings, ...]
    ) -> list[str]:
        """Return what is missing, and what the diagnosis therefore cannot test.

        Args:
            stations: of the pair.
            sampled: those whose samples are there.
            sweeps: first settings, of all stations.
        """
        said: list[str] = []
        for station, peer in zip(stations, reversed(stations), strict=True):
            if station not in sampled:
                said.append(
                    f'/{station}/if_samples is missing: its receiver cannot be tested; an effect on the chirps can be '
                    'assigned to a station only where it shifts with the distance; '
                    f"'{peer}' alone measures the distance no better than T_off is known"
                )
            if (station, peer) not in self._settings:
                said.append(f"/{station}/sweep_config is missing: its settings follow those of '{peer}'")
            if station not in self._calibrations:
                said.append(
                    f'/{station}/calibration is missing: its clocks count as nominal, and an error of them cannot be '
                    'separated from what the calibration would say; its delay is unknown, so the range is not compared'
                )
            else:
                calibration = self._calibrations[station].latest()
                lacking = [
                    words
                    for name, words in (('noise_floor', 'noise floor'), ('phase_noise_level', 'phase noise'))
                    if np.isnan(getattr(calibration, name))
                ]
                if lacking:
                    said.append(f"{' and '.join(lacking)} of '{station}' not characterised: an excess cannot be tested")
            if station not in self._temperatures:
                said.append(f'/{station}/status is missing: effects of its board temperature cannot be tested')
        lacking = [f'/site/{quantity}' for quantity in WEATHER if quantity not in self._weather]
        if lacking:
            said.append(
                f'{", ".join(lacking)} missing: the default is used, and the range is compared only as far as the '
                'air may change it'
            )
        if not len(self.reference(stations).stamps):
            said.append(
                '/reference/range is missing: the measured distance is used instead, so effects that only shift the '
                'distance (clocks, air, delays, geometry, the reference itself) cannot be tested'
            )
        for sweep, other in zip(sweeps, reversed(sweeps), strict=True):
            if np.isnan(other.tx_eirp + sweep.rx_antenna_gain):
                said.append(f"EIRP or antenna gain unknown: a loss of power at '{sweep.station}' cannot be tested")
        return said


def holding(history: History[T], stamp: int) -> T:
    """Return the value that holds at `stamp`, before all of them the first."""
    found = history.at(stamp)
    return cast(T, history.first()) if found is None else found[1]


def _held(history: History[float] | None, stamps: np.ndarray, default: float) -> np.ndarray:
    """Return the reading that holds at each stamp, `default` without any."""
    if not history:
        return np.full(len(stamps), default)
    return np.array([holding(history, int(s)) for s in stamps], dtype=float)


@functools.lru_cache(maxsize=64)
def _completed(stations: tuple[str, ...], own: tuple[SweepSettings | None, ...]) -> tuple[SweepSettings, ...]:
    """Return the settings of all stations; a station without any (None) has its peer's, in the other role.

    Raises:
        ValueError: no station has settings.
    """
    settings = []
    for sweep, other, station in zip(own, reversed(own), stations, strict=True):
        if sweep is None:
            if other is None:
                raise ValueError(f'no settings of {" and ".join(stations)}')
            role = Role.FIRST if other.role == Role.SECOND else Role.SECOND
            sweep = dataclasses.replace(other, station=station, peer=other.station, role=int(role), frame_id='')
        scale = 0.0 if np.isnan(sweep.full_scale_power) else sweep.full_scale_power
        settings.append(dataclasses.replace(sweep, stamp=0, full_scale_power=scale))
    return tuple(settings)
