"""The order of events: the measurements of a scenario, and what the hardware publishes around them."""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from drfmcw_physics.air import refractive_index
from drfmcw_physics.rules.mode import choose_mode
from drfmcw_physics.rules.schedule import Demand, Share
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, SweepSettings

from .measurements import Measurements
from .nominal import link_budget, nominal_measurements
from .scenario import Scenario
from .synthesis.random_streams import Purpose, stream
from .synthesis.signal_model import synthesise
from .trajectory import Drive, Recorded

NANOSECONDS = 1_000_000_000


@dataclasses.dataclass(frozen=True)
class IfSweep:
    """One sweep's digitised IF; the fields of IfSamples."""

    station: str
    peer: str
    sweep_id: int
    full_scale: float
    iq: bool
    samples: np.ndarray
    stamp: int
    frame_id: str


@dataclasses.dataclass(frozen=True)
class Reading:
    """A reading of a weather sensor; the fields of Temperature, FluidPressure and RelativeHumidity."""

    stamp: int
    variance: float
    temperature: float | None = None
    fluid_pressure: float | None = None
    relative_humidity: float | None = None
    frame_id: str = 'site'


@dataclasses.dataclass(frozen=True)
class ReferenceReading:
    """A reading of the reference instrument; the fields of ReferenceRange."""

    stamp: int
    range: float
    range_std: float
    frame_id: str = 'reference'


@dataclasses.dataclass(frozen=True)
class Status:
    """Housekeeping of a station; the fields of StationStatus."""

    station: str
    stamp: int
    frame_id: str
    temperature: float
    sweeps: int
    dropped: int = 0
    pll_locked: bool = True
    link_quality: float = 1.0


@dataclasses.dataclass(frozen=True)
class Event:
    """One message at its time."""

    topic: str
    stamp: int  # when it happens [ns]
    content: Any  # dataclass with the message's fields
    sweep_id: int = -1  # of the measurement that it belongs to; -1 for all others


@dataclasses.dataclass(frozen=True)
class Slots:
    """Consecutive measurements, pairs in turn; arrays [n]."""

    sweep_id: np.ndarray
    time: np.ndarray  # since the scenario's start [s]
    pair: np.ndarray  # index into scenario.pairs
    distance: np.ndarray  # [m]
    velocity: np.ndarray  # [m/s]
    acceleration: np.ndarray  # [m/s^2]

    def __len__(self) -> int:
        """Return the number of measurements."""
        return len(self.sweep_id)

    def __getitem__(self, rows: slice | np.ndarray) -> 'Slots':
        """Return some of the measurements."""
        return Slots(*(getattr(self, f.name)[rows] for f in dataclasses.fields(self)))


class Timeline:
    """Steps through a scenario.

    `slots` and `render` say what comes next without moving on; `advance` moves on; `change_mode` and
    `change_schedule` act in between.
    """

    def __init__(
        self, scenario: Scenario, start: int | None = None, mode_by_range: bool = True, first_sweep_id: int = 0
    ) -> None:
        """Begin at the scenario's start.

        Args:
            scenario: what to simulate.
            start: time of the first sweep [ns]; None takes the scenario's.
            mode_by_range: the hardware changes its mode at the scenario's limit; False: only `change_mode` does.
            first_sweep_id: number of the first sweep.
        """
        self.scenario = scenario
        self.start = round(scenario.timing.start_time * NANOSECONDS) if start is None else start
        self.next_sweep_id = first_sweep_id
        self._first_sweep_id = first_sweep_id
        self.schedule = scenario.schedule
        """The time division in use; its slots count from the first sweep on."""
        self._demands: Sequence[Demand] | None = None  # of the next schedule
        self._pause = 0.0  # time spent changing modes [s]
        self._by_range = mode_by_range
        self._reported = -1  # time up to which weather and status are published [ns]
        self.modes: list[Mode] = []  # of each pair, none before the first is chosen
        self._start_delays: list[float] = []
        turns = [self.schedule.frame.index(pair) for pair in range(len(scenario.pairs))]
        first = self._at(first_sweep_id + np.array(turns))
        wanted = [self._wanted(int(p), 0, float(d)) for p, d in zip(first.pair, first.distance, strict=True)]
        self.modes, self._start_delays = [mode for mode, _ in wanted], [delay for _, delay in wanted]

    def _wanted(self, pair: int, index: int, distance: float) -> tuple[Mode, float]:
        """Return the mode and T_off [s] that the pair's sweep number `index` at a distance [m] asks for."""
        trajectory = self.scenario.pairs[pair].trajectory
        if isinstance(trajectory, Recorded):
            return trajectory.mode(index)
        before = self.modes[pair] if self.modes else None
        mode = choose_mode(before, distance, self.scenario.mode)
        kept = mode == before
        return mode, self._start_delays[pair] if kept else self.scenario.mode.start_delay(mode)

    def stamp(self, time: float) -> int:
        """Return scenario time [s] as stamp [ns]."""
        return self.start + round(time * NANOSECONDS)

    def sweep_settings(self, pair: int) -> tuple[SweepSettings, ...]:
        """Return the settings now in use by both stations of a pair."""
        return self.scenario.sweep_settings(self.scenario.pairs[pair], self.modes[pair], self._start_delays[pair])

    @property
    def sweep_count(self) -> int:
        """Measurements of the whole scenario, changes of mode left out."""
        counts = []
        for number, pair in enumerate(self.scenario.pairs):
            if isinstance(pair.trajectory, Drive):
                counts.append(math.ceil(pair.trajectory.duration / self.scenario.timing.sweep_interval))
            else:
                counts.append(self.schedule.slots_until(number, pair.trajectory.sweep_count))
        return max(counts)

    def _at(self, sweep_id: np.ndarray) -> Slots:
        """Return the slots of given sweep numbers."""
        pairs = self.scenario.pairs
        number = sweep_id - self._first_sweep_id
        pair, index = self.schedule.pair(number), self.schedule.index(number)
        time = number * self.scenario.timing.sweep_interval + self._pause
        standing = [
            p.trajectory.moves(np.maximum(self.schedule.before(member, number + 1) - 1, 0))
            for member, p in enumerate(pairs)
            if not isinstance(p.trajectory, Drive)
        ]
        if standing:
            time = time + np.max(standing, axis=0)
        states = np.empty((3, len(sweep_id)))
        for member, settings in enumerate(pairs):
            rows = pair == member
            states[:, rows] = settings.trajectory.state(index[rows], time[rows])
        return Slots(sweep_id, time, pair, *states)

    def _index(self, sweep_id: np.ndarray) -> np.ndarray:
        """Return the number of each sweep for its own pair."""
        return self.schedule.index(sweep_id - self._first_sweep_id)

    def _ended(self, slots: Slots) -> np.ndarray:
        """Return which slots lie behind the end of all trajectories."""
        number = slots.sweep_id - self._first_sweep_id
        ended = np.ones(len(slots), bool)
        for pair, p in enumerate(self.scenario.pairs):
            if isinstance(p.trajectory, Drive):
                ended &= slots.time >= p.trajectory.duration
            else:
                ended &= self.schedule.in_whole_frames(pair, number) >= p.trajectory.sweep_count
        return ended

    def slots(self, limit: int) -> Slots:
        """Return up to `limit` next measurements that share modes and schedule; none at the end or before a change."""
        if self._demands is not None:
            limit = max(0, min(limit, self._change_due() - self.next_sweep_id))
        slots = self._at(np.arange(self.next_sweep_id, self.next_sweep_id + limit))
        stop = self._ended(slots)
        if self._by_range:
            index = self._index(slots.sweep_id)
            stop = stop | [
                self._wanted(p, i, d) != (self.modes[p], self._start_delays[p])
                for p, i, d in zip(slots.pair.tolist(), index.tolist(), slots.distance.tolist(), strict=True)
            ]
        end = int(np.argmax(stop)) if stop.any() else len(slots)
        return slots[:end]

    @property
    def finished(self) -> bool:
        """True when all trajectories are over."""
        return bool(self._ended(self._at(np.array([self.next_sweep_id])))[0])

    @property
    def duration(self) -> float:
        """Scenario time of the next measurement [s]."""
        return float(self._at(np.array([self.next_sweep_id])).time[0])

    def advance(self, count: int) -> None:
        """Move on by `count` measurements."""
        if count:
            last = self._at(np.array([self.next_sweep_id + count - 1]))
            self._reported = self._end(float(last.time[0]), int(last.pair[0]))
        self.next_sweep_id += count

    def opening(self) -> list[Event]:
        """Return calibrations and settings of all stations, published before the first sweep."""
        early = self.stamp(0.0) - NANOSECONDS
        events = self.calibrations(early)
        for pair in range(len(self.scenario.pairs)):
            events += self._settings_events(pair, early + NANOSECONDS // 2)
            events += self._schedule_events(pair, early + NANOSECONDS // 2)
        return events

    def calibrations(self, stamp: int) -> list[Event]:
        """Return the calibrations of all stations, valid from a stamp [ns] on."""
        return [
            Event(
                f'/{name}/calibration',
                stamp,
                dataclasses.replace(self.scenario.published_calibration(name), stamp=stamp),
            )
            for name in self.scenario.stations
        ]

    def _settings_events(self, pair: int, stamp: int) -> list[Event]:
        return [
            Event(f'/{s.station}/sweep_config', stamp, dataclasses.replace(s, stamp=stamp))
            for s in self.sweep_settings(pair)
        ]

    def _schedule_events(self, pair: int, stamp: int) -> list[Event]:
        grant = self.schedule.grant(pair)
        return [
            Event(
                f'/{s.station}/sweep_schedule',
                stamp,
                Share(s.station, s.peer, *grant, stamp, self.scenario.frame_id(s.station)),
            )
            for s in self.sweep_settings(pair)
        ]

    def change_mode(self, pair: int, mode: Mode, start_delay: float | None = None) -> list[Event]:
        """Change the mode of a pair before the next measurement; return its new settings, to be published now.

        Args:
            pair: index into the scenario's pairs.
            mode: new mode.
            start_delay: its T_off [s]; None takes the scenario's.
        """
        duration = self.scenario.timing.mode_change_duration
        self.modes[pair] = Mode(mode)
        self._start_delays[pair] = self.scenario.mode.start_delay(mode) if start_delay is None else start_delay
        self._pause += duration
        time = self._at(np.array([self.next_sweep_id])).time[0]
        return self._settings_events(pair, self.stamp(time - duration / 2))

    def due_mode_changes(self) -> list[Event]:
        """Change the mode of the next measurement's pair where its distance asks for it; return the new settings."""
        slot = self._at(np.array([self.next_sweep_id]))
        pair = int(slot.pair[0])
        index = int(self._index(slot.sweep_id)[0])
        wanted = self._wanted(pair, index, float(slot.distance[0]))
        if not self._by_range or wanted == (self.modes[pair], self._start_delays[pair]):
            return []
        return self.change_mode(pair, *wanted)

    def change_schedule(self, demands: Sequence[Demand]) -> None:
        """Let another schedule follow as soon as each pair has had a slot of the present one.

        Args:
            demands: of the scenario's pairs.

        Raises:
            ConfigurationError: the number of demands is another one.
        """
        if len(demands) != len(self.scenario.pairs):
            raise ConfigurationError(f'{len(demands)} demands for {len(self.scenario.pairs)} pairs')
        self._demands = demands

    def _change_due(self) -> int:
        """Return the number of the first sweep of the schedule that follows."""
        return self._first_sweep_id + self.schedule.change(self.next_sweep_id - self._first_sweep_id)

    def due_schedule_change(self) -> list[Event]:
        """Begin the schedule that follows if its time has come; return what is granted to pairs where that changes."""
        if self._demands is None or self._change_due() > self.next_sweep_id:
            return []
        number, before = self.next_sweep_id - self._first_sweep_id, self.schedule
        self.schedule, self._demands = before.followed_by(self._demands, number), None
        stamp = self.stamp(self.duration) - 1
        changed = [p for p in range(len(self.scenario.pairs)) if before.grant(p) != self.schedule.grant(p)]
        return [event for pair in changed for event in self._schedule_events(pair, stamp)]

    def measurements(self, slots: Slots, pair: int) -> Measurements:
        """Return the conditions of those slots that belong to a pair."""
        s = self.scenario
        settings = s.pairs[pair]
        slots = slots[slots.pair == pair]
        sweeps = self.sweep_settings(pair)
        stations = [s.stations[sweep.station] for sweep in sweeps]
        powers = []
        for sweep, peer in zip(sweeps, reversed(sweeps), strict=True):
            power = link_budget(sweep, peer, slots.distance)
            if not math.isnan(settings.path_loss):
                power = np.full(len(slots), peer.tx_eirp + sweep.rx_antenna_gain - settings.path_loss)
            powers.append(power)
        time = slots.time
        nominal = nominal_measurements(
            sweeps,
            [s.calibration(sweep.station) for sweep in sweeps],
            powers,
            [station.board_temperature.at(time) for station in stations],
            [float(1 << (station.adc_bits - 1)) for station in stations],
            s.waveform.iq,
            slots.sweep_id,
            time,
            slots.distance,
            slots.velocity,
            slots.acceleration,
            refractive_index(s.weather.temperature.at(time), s.weather.pressure.at(time), s.weather.humidity.at(time)),
            settings.trajectory.setting(self._index(slots.sweep_id)),
        )
        return dataclasses.replace(
            nominal, start_delay_jitter=s.timing.start_delay_jitter, amplitude_scatter=s.timing.amplitude_scatter
        )

    def render(self, slots: Slots) -> list[Event]:
        """Return everything that is published with these measurements, in order of time; IF samples synthesised.

        Weather and status stand before the measurement that they belong to, those between its two sweeps too: what
        holds at a sweep is known before the sweep is evaluated. A measurement's own reference reading follows it: no
        range waits until those who listen to the reference have it.
        """
        s = self.scenario
        sweeps: dict[int, list[Event]] = {}
        for pair in np.unique(slots.pair):
            m = self.measurements(slots, int(pair))
            samples = synthesise(m, s.seed, s.effects)
            for row, (sweep_id, time) in enumerate(zip(m.sweep_id, m.time, strict=True)):
                stamps = [self.stamp(time), self.stamp(time) + round(m.stations[0].sweep.start_delay * NANOSECONDS)]
                sweeps[int(sweep_id)] = [
                    Event(
                        f'/{station.name}/if_samples',
                        stamp,
                        IfSweep(
                            station.name,
                            station.sweep.peer,
                            int(sweep_id),
                            station.full_scale,
                            station.iq,
                            codes[row],
                            stamp,
                            station.sweep.frame_id,
                        ),
                        int(sweep_id),
                    )
                    for station, codes, stamp in zip(m.stations, samples, stamps, strict=False)
                ]
        events: list[Event] = []
        reported = self._reported
        for sweep_id, time, pair, distance in zip(slots.sweep_id, slots.time, slots.pair, slots.distance, strict=True):
            end = self._end(float(time), int(pair))
            events += self._reports(reported, end, int(sweep_id))
            reported = end
            events += sweeps[int(sweep_id)]
            if s.reference.enabled and s.reference.interval == 0:
                index = int(self._index(np.array([sweep_id]))[0])
                reading = self._reference(int(sweep_id), int(pair), index, float(time), float(distance))
                events.append(dataclasses.replace(reading, sweep_id=int(sweep_id)))
        return events

    def _reference(self, number: int, pair: int, index: int, time: float, distance: float) -> Event:
        """Return reading `number`, of a pair at its sweep number `index`, at a time [s] and true distance [m]."""
        s = self.scenario
        error = stream(s.seed, Purpose.REFERENCE, number).standard_normal() * s.reference.range_std
        p = s.pairs[pair]

        def earlier(t: np.ndarray | float) -> np.ndarray | float:
            if isinstance(p.trajectory, Drive):
                return p.trajectory.state(None, t)[0]
            # between two distances a standing crane is not simulated: its reference has settled
            return distance + p.trajectory.step(index) * (t - time) / self.schedule.interval(pair)

        error += sum((float(e.reference_error(time, distance, earlier)) for e in s.effects), 0.0)
        frame = 'reference' if len(s.pairs) == 1 else f'{p.first}/{p.second}'
        stamp = self.stamp(time)
        return Event('/reference/range', stamp, ReferenceReading(stamp, distance + error, s.reference.range_std, frame))

    def _end(self, time: float, pair: int) -> int:
        """Return the scenario time of the later sweep of a pair's measurement at `time` [s], as stamps have it [ns]."""
        delays = (sweep.start_delay for sweep in self.sweep_settings(pair))
        return round(time * NANOSECONDS) + round(max(delays) * NANOSECONDS)

    def _reports(self, since: int, until: int, sweep_id: int) -> Iterator[Event]:
        """Yield weather, status and timed reference readings due after `since` and up to `until` [ns]."""
        s = self.scenario
        sweeps = sweep_id - self._first_sweep_id
        due: list[tuple[float, list[Event]]] = []
        for number, t in _ticks(s.weather.interval, since, until):
            due.append((t, self._weather(number, t)))
        for _, t in _ticks(s.timing.status_interval, since, until):
            due.append((t, [self._status(name, t, sweeps) for name in s.stations]))
        if s.reference.enabled and s.reference.interval:
            for number, t in _ticks(s.reference.interval, since, until):
                index = max(int(self.schedule.before(0, sweeps + 1)) - 1, 0)
                distance = s.pairs[0].trajectory.state(np.array([index]), np.array([t]))[0][0]
                due.append((t, [self._reference(number, 0, index, t, float(distance))]))
        for _, events in sorted(due, key=lambda item: item[0]):
            yield from events

    def _weather(self, number: int, time: float) -> list[Event]:
        w = self.scenario.weather
        deviates = stream(self.scenario.seed, Purpose.WEATHER, number).standard_normal(3)
        stamp = self.stamp(time)
        temperature = float(w.temperature.at(time) + w.temperature_std * deviates[0])
        pressure = float(w.pressure.at(time) + w.pressure_std * deviates[1])
        humidity = float(np.clip(w.humidity.at(time) + w.humidity_std * deviates[2], 0.0, 1.0))
        return [
            Event('/site/temperature', stamp, Reading(stamp, w.temperature_std**2, temperature=temperature)),
            Event('/site/pressure', stamp, Reading(stamp, w.pressure_std**2, fluid_pressure=pressure)),
            Event('/site/humidity', stamp, Reading(stamp, w.humidity_std**2, relative_humidity=humidity)),
        ]

    def _status(self, station: str, time: float, measured: int) -> Event:
        stamp = self.stamp(time)
        own = [number for number, p in enumerate(self.scenario.pairs) if station in (p.first, p.second)]
        sweeps = sum(int(self.schedule.before(number, measured)) for number in own)
        temperature = float(self.scenario.stations[station].board_temperature.at(time))
        frame = self.scenario.frame_id(station)
        return Event(f'/{station}/status', stamp, Status(station, stamp, frame, temperature, sweeps))


def _ticks(interval: float, since: int, until: int) -> Iterator[tuple[int, float]]:
    """Yield (number, time [s]) of the multiples of `interval` [s] in (since, until] [ns], from 0 on.

    Compared are stamps: a time that falls on the same nanosecond is the same, whatever the last bit of its sum says.
    """
    number = max(0, math.floor(since / NANOSECONDS / interval))
    while (stamp := round(number * interval * NANOSECONDS)) <= until:
        if stamp > since:
            yield number, number * interval
        number += 1
