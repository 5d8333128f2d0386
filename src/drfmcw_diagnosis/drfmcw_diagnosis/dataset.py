"""A recording as arrays: the sweeps of one pair of stations with everything known about the conditions around them."""

import collections
import dataclasses
import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_fusion.offline import Reference, is_weather, read_weather
from drfmcw_fusion.pipeline import RangeFusion
from drfmcw_fusion.settings import FusionSettings
from drfmcw_fusion.statistics import reference_at
from drfmcw_node.estimation import EstimatorSettings
from drfmcw_node.processing import StationProcessor, Sweep, refusal
from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.history import History
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_physics.sweep import Mode, Role, SweepSettings, beat_frequency
from drfmcw_ros.bag import BagError, BagReader
from drfmcw_ros.messages import from_message, stamp_ns
from drfmcw_ros.topics import SITE_TOPICS, is_measured, split_station_topic
from drfmcw_sim.nominal import link_budget, nominal_measurements
from drfmcw_sim.signal_model import Measurements

GROUP = 24
"""Largest number of sweeps of a driving crane that are taken together."""

_PAUSE = 2.0  # a longer one, and one of more than five intervals, between sweeps begins a new group [s]
_FASTEST = 10.0  # a faster change of the reference is another distance, not a drive [m/s]
_STILL = 0.05  # by which a standing crane's reference may change beyond its noise [m]
_PEAK = 8.0  # largest difference within one group of readings, in standard deviations of the reference
_BENT = 4.0  # standard deviations from which on an acceleration is more than noise
_SMALLEST = 6  # sweeps of a driving crane's group that is not cut further
_STEADY = 60.0  # weather and temperatures count as steady for so long [s]
_PAIRING = 1.0  # largest difference of both stations' stamps of one sweep [s]
_FAR = 1.0  # a delay at which the sign of a beat frequency is beyond doubt [s]
_MAD_TO_STD = 1.4826  # of normal noise
_CHUNK = 512  # sweeps estimated at once
_LINE = ('frequency', 'frequency_std', 'phase', 'power')  # fields of Beat and of Lines
_WEATHER = ('temperature', 'pressure', 'humidity')


@dataclasses.dataclass(frozen=True)
class Lines:
    """What the chain itself measures, every sweep on its own; NaN where a station has no result."""

    frequency: np.ndarray  # (stations, n) on each station's nominal clock [Hz]
    frequency_std: np.ndarray  # (stations, n) [Hz]
    phase: np.ndarray  # (stations, n) [rad]
    power: np.ndarray  # (stations, n) at the receive antenna port [dBm]
    noise_density: np.ndarray  # (stations, n) of the additive noise at the receive antenna port [dBm/Hz]
    flags: np.ndarray  # (stations, n) bits of drfmcw_node.estimation.Flag
    range: np.ndarray  # (n,) [m]
    range_std: np.ndarray  # (n,) [m]


@dataclasses.dataclass(frozen=True)
class Dataset:
    """All n sweeps of one pair of stations, in order of time.

    Rows of arrays with shape (stations, n) are in the order of `stations`.
    """

    path: str  # of the recording
    stations: tuple[str, ...]  # (first, second), or the one that hears itself
    samples: tuple[np.ndarray | None, ...]  # per station int16 (n, N), I and Q interleaved (n, 2 N); None: not recorded
    full_scale: np.ndarray  # (stations, n) [LSB]
    iq: bool
    sweep_id: np.ndarray  # (n,)
    stamp: np.ndarray  # (n,) start of the first station's sweep [ns]
    sweeps: tuple[tuple[SweepSettings, ...], ...]  # distinct settings, each of all stations
    setting: np.ndarray  # (n,) index into `sweeps`
    calibration: tuple[Calibration, ...]  # of each station
    board_temperature: np.ndarray  # (stations, n) NaN without status [degC]
    temperature: np.ndarray  # (n,) of the air [degC]
    pressure: np.ndarray  # (n,) [Pa]
    humidity: np.ndarray  # (n,) relative [0..1]
    reference: np.ndarray  # (n,) NaN where no reading is near enough [m]
    reference_std: np.ndarray  # (n,) [m]
    missing: tuple[str, ...]  # what the recording lacks and what can therefore not be told

    def __len__(self) -> int:
        """Return the number of sweeps."""
        return len(self.sweep_id)

    @functools.cached_property
    def time(self) -> np.ndarray:
        """Time since the first sweep, (n,) [s]."""
        return (self.stamp - self.stamp[0]) * 1e-9

    @functools.cached_property
    def refractive_index(self) -> np.ndarray:
        """Refractive index of the air after ITU-R P.453, (n,) [1]."""
        return refractive_index(self.temperature, self.pressure, self.humidity)

    @functools.cached_property
    def lines(self) -> Lines:
        """Beat frequencies, powers and ranges by the maximum-likelihood estimator; computed when first asked for."""
        return _measure(self)

    @functools.cached_property
    def distance(self) -> np.ndarray:
        """Distance that the nominal model takes, (n,) [m]: the reference's, the measured one where there is none.

        Raises:
            ConfigurationError: neither tells the distance of any sweep.
        """
        if np.isfinite(self.reference).all():
            return self.reference
        distance = np.where(np.isfinite(self.reference), self.reference, self.lines.range)
        known = np.isfinite(distance)
        if not known.any():
            raise ConfigurationError(f"{self.path}: no '/reference/range' and no line found: the distance is unknown")
        return np.where(known, distance, np.interp(self.time, self.time[known], distance[known]))

    @functools.cached_property
    def group(self) -> np.ndarray:
        """Number of the group of consecutive sweeps that share settings and conditions, (n,).

        A new one begins with new settings, after a pause, where the distance jumps, and every minute. Sweeps of a
        driving crane are taken together by `GROUP` at most, by fewer where it accelerates.
        """
        std = self.reference_std
        if not np.isfinite(self.reference).all():
            std = np.where(np.isfinite(self.reference), std, self.lines.range_std)
        return _groups(self.setting, self.time, self.distance, std)

    @functools.cached_property
    def _slope(self) -> tuple[np.ndarray, np.ndarray]:
        return _slopes(self.group, self.time, self.reference, self.reference_std)

    @property
    def velocity(self) -> np.ndarray:
        """Slope of the reference over its group, (n,) [m/s]; NaN where fewer than three readings tell it."""
        return self._slope[0]

    @property
    def velocity_std(self) -> np.ndarray:
        """Standard deviation of `velocity`, (n,) [m/s]; a standing crane's velocity is zero within it."""
        return self._slope[1]

    @functools.cached_property
    def received_power(self) -> np.ndarray:
        """Power that each station receives in the nominal model, (stations, n) [dBm].

        After the link budget; where EIRP or gain are unknown, as measured, the mean over each group.
        """
        powers = np.empty((len(self.stations), len(self)))
        for index, sweeps in enumerate(self.sweeps):
            rows = self.setting == index
            for row, (own, peer) in enumerate(zip(sweeps, reversed(sweeps), strict=True)):
                powers[row, rows] = link_budget(own, peer, self.distance[rows])
        if np.isnan(powers).any():
            for number in range(self.group[-1] + 1):
                rows = self.group == number
                measured = self.lines.power[:, rows]
                mean = np.array([np.mean(p[np.isfinite(p)]) if np.isfinite(p).any() else np.nan for p in measured])
                powers[:, rows] = np.where(np.isnan(powers[:, rows]), mean[:, None], powers[:, rows])
        return powers

    def nominal(self, rows: np.ndarray | slice) -> Measurements:
        """Return the nominal model of some sweeps: what it says before any effect acts.

        A crane that stands at each sweep's `distance`, one path, weather, link budget, calibrated clocks, delays,
        noise floor and phase noise; nominal T_off, initial phases zero. An unknown board temperature counts as that of
        the calibration. Measurements.setting is the number of the group.

        Args:
            rows: of the sweeps, as slice, mask or indices; all of one of the settings.

        Raises:
            ValueError: no sweeps, or sweeps of several settings.
        """
        settings = np.unique(self.setting[rows])
        if len(settings) != 1:
            raise ValueError(f'nominal() needs sweeps of one setting, not of {len(settings)}')
        distance = self.distance[rows]
        still = np.zeros(len(distance))
        return nominal_measurements(
            self.sweeps[settings[0]],
            self.calibration,
            list(self.received_power[:, rows]),
            [
                np.where(np.isfinite(t), t, c.temperature)
                for t, c in zip(self.board_temperature[:, rows], self.calibration, strict=True)
            ],
            [float(np.median(f)) for f in self.full_scale[:, rows]],
            self.iq,
            self.sweep_id[rows],
            self.time[rows],
            distance,
            still,
            still,
            self.refractive_index[rows],
            self.group[rows],
        )


def read_dataset(path: Path | str, pair: str | None = None, progress: Callable[[int], None] | None = None) -> Dataset:
    """Read the sweeps of one pair of stations.

    Args:
        path: of the recording.
        pair: 'first/second' ('station/station' where it hears itself); None takes the one with most sweeps.
        progress: called with the number of messages read so far.

    Raises:
        BagError: it cannot be read, or lacks samples or sweep settings, or has no such pair.
        ConfigurationError: what it holds does not fit together, or its distance cannot be told.
    """
    with BagReader(path) as bag:
        dataset = _Recording(bag).dataset(pair, progress)
    if any(np.isnan(c.noise_floor) for c in dataset.calibration):
        dataset = _with_measured_noise(dataset)
    _ = dataset.group  # says at once where the distance cannot be told
    return dataset


class _Recording:
    """What a recording holds besides the samples, looked up by stamp."""

    def __init__(self, bag: BagReader) -> None:
        """Read everything but samples.

        Raises:
            BagError: no samples, or no settings of any station that has samples.
        """
        self._bag = bag
        self._sample_topics = [t for t in bag.topics if split_station_topic(t)[1] == 'if_samples']
        if not self._sample_topics:
            raise BagError(f"{bag.path}: holds no '/<station>/if_samples'; topics: {', '.join(sorted(bag.topics))}")
        self._settings: dict[tuple[str, str], History[SweepSettings]] = {}
        self._calibrations: dict[str, History[Calibration]] = {}
        self._temperatures: dict[str, History[float]] = {}
        self._weather: dict[str, History[float]] = {}
        self._readings: list[tuple[int, float, float, str]] = []
        self._combined: dict[tuple[int, ...], tuple[SweepSettings, ...]] = {}
        for topic, _, message in bag.messages({t for t in bag.topics if is_measured(t)} - set(self._sample_topics)):
            try:
                self._take(topic, message)
            except ConfigurationError as error:
                raise BagError(f"{bag.path}: topic '{topic}': {error}") from None
        readings = sorted(self._readings)
        stamps, ranges, stds, frames = zip(*readings, strict=True) if readings else ((), (), (), ())
        self._reference = Reference(
            np.array(stamps, dtype=np.int64),
            np.array(ranges, dtype=float),
            np.array(stds, dtype=float),
            np.array(frames, dtype=str),
        )
        self.missing: list[str] = []

    def _take(self, topic: str, message: Any) -> None:
        """Take in one message that is no sweep."""
        name = split_station_topic(topic)[1]
        stamp = stamp_ns(message.header.stamp)
        if is_weather(topic):
            quantity, value = read_weather(topic, message)
            if np.isfinite(value):
                self._weather.setdefault(quantity, History()).add(stamp, value)
        elif topic in SITE_TOPICS:
            if np.isfinite(message.range):
                self._readings.append((stamp, message.range, message.range_std, message.header.frame_id))
        elif name == 'sweep_config':
            sweep = from_message(message, SweepSettings)
            self._settings.setdefault((sweep.station, sweep.peer), History()).add(stamp, sweep)
        elif name == 'calibration':
            calibration = from_message(message, Calibration)
            self._calibrations.setdefault(calibration.station, History()).add(stamp, calibration)
        elif name == 'status':
            self._temperatures.setdefault(message.station, History()).add(stamp, float(message.temperature))

    def _choose(self, pair: str | None) -> tuple[str, ...]:
        """Return the stations of the pair, in order of their roles."""
        counts: collections.Counter[tuple[str, ...]] = collections.Counter()
        for _, _, message in self._bag.messages(self._sample_topics):
            counts[tuple(sorted({message.station, message.peer}))] += 1
        if not counts:
            raise BagError(f'{self._bag.path}: holds not one message of IF samples')
        names = {stations: '/'.join(order) for stations in counts if (order := self._ordered(stations))}
        if not names:
            needed = ' or '.join(sorted({f"'/{s}/sweep_config'" for stations in counts for s in stations}))
            raise BagError(f'{self._bag.path}: no sweep settings of the stations that have samples: needs {needed}')
        if pair is None:
            chosen = max(sorted(names), key=lambda stations: counts[stations])
            if len(counts) > 1:
                others = ', '.join(sorted(names.get(s) or '/'.join(s) for s in counts if s != chosen))
                self.missing.append(f'only the pair {names[chosen]} is looked at; the recording also holds {others}')
        else:
            chosen = tuple(sorted(set(pair.split('/'))))
            if chosen not in names:
                raise BagError(f"{self._bag.path}: unknown pair '{pair}'{nearest(pair, sorted(names.values()))}")
        return tuple(dict.fromkeys(names[chosen].split('/')))

    def _ordered(self, stations: tuple[str, ...]) -> tuple[str, str] | None:
        """Return (first, second) of a pair's stations, None where neither tells its settings."""
        one, other = stations[0], stations[-1]
        for own, peer in ((one, other), (other, one)):
            history = self._settings.get((own, peer))
            if history:
                return (own, peer) if history.latest().role == Role.FIRST or own == peer else (peer, own)
        return None

    def dataset(self, pair: str | None, progress: Callable[[int], None] | None) -> Dataset:
        """Return the sweeps of one pair; arguments and errors as `read_dataset`."""
        stations = self._choose(pair)
        of_station = self._read_sweeps(stations, progress)
        matched = self._matched(stations, of_station)
        present = [[s for s in m if s is not None] for m in matched]
        heard = np.array([p[0].stamp for p in present])
        late = [0.0 if m[0] else self._settings_at(stations, m[1].stamp)[1].start_delay for m in matched]
        stamp = heard - np.rint(np.array(late) * 1e9).astype(np.int64)
        held = [self._settings_at(stations, int(instant)) for instant in heard]
        sweeps = {repr(settings): settings for settings in dict.fromkeys(held)}  # unlike NaN, its name equals itself
        numbers = {name: number for number, name in enumerate(sweeps)}
        self._say_what_is_missing(stations, of_station, list(sweeps.values()))
        reference = self._reference.of('/'.join((stations[0], stations[-1])))
        known = reference_at(reference, heard)
        defaults = FusionSettings()
        weather = {
            quantity: _held(self._weather.get(quantity), heard, getattr(defaults, f'default_{quantity}'))
            for quantity in _WEATHER
        }
        return Dataset(
            path=str(self._bag.path),
            stations=stations,
            samples=tuple(
                np.stack([np.asarray(m[i].samples) for m in matched]) if of_station[station] else None
                for i, station in enumerate(stations)
            ),
            full_scale=np.array(
                [
                    [(m[i] or p[0]).full_scale for m, p in zip(matched, present, strict=True)]
                    for i in range(len(stations))
                ]
            ),
            iq=present[0][0].iq,
            sweep_id=np.array([p[0].sweep_id for p in present]),
            stamp=stamp,
            sweeps=tuple(sweeps.values()),
            setting=np.array([numbers[repr(settings)] for settings in held]),
            calibration=tuple(self._calibration(s, int(stamp[0])) for s in stations),
            board_temperature=np.array([_held(self._temperatures.get(s), heard, np.nan) for s in stations]),
            **weather,
            reference=known,
            reference_std=_reference_std(reference, heard, known),
            missing=tuple(self.missing),
        )

    def _settings_at(self, stations: tuple[str, ...], stamp: int) -> tuple[SweepSettings, ...]:
        """Return the settings of all stations at `stamp`; those of a station that tells none follow its peer's."""
        own = []
        for station, peer in zip(stations, reversed(stations), strict=True):
            history = self._settings.get((station, peer))
            own.append(_holding(history, stamp) if history else None)
        key = tuple(id(sweep) for sweep in own)
        if key not in self._combined:
            self._combined[key] = self._complete(stations, own)
        return self._combined[key]

    @staticmethod
    def _complete(stations: tuple[str, ...], own: Sequence[SweepSettings | None]) -> tuple[SweepSettings, ...]:
        """Return the settings of all stations from those told."""
        settings = []
        for sweep, other, station in zip(own, reversed(own), stations, strict=True):
            if sweep is None:
                role = Role.FIRST if other.role == Role.SECOND else Role.SECOND
                sweep = dataclasses.replace(other, station=station, peer=other.station, role=int(role), frame_id='')
            scale = 0.0 if np.isnan(sweep.full_scale_power) else sweep.full_scale_power
            settings.append(dataclasses.replace(sweep, stamp=0, full_scale_power=scale))
        return tuple(settings)

    def _calibration(self, station: str, stamp: int) -> Calibration:
        """Return a station's calibration at the first sweep."""
        history = self._calibrations.get(station)
        return _holding(history, stamp) if history else Calibration(station)

    def _read_sweeps(self, stations: tuple[str, ...], progress: Callable[[int], None] | None) -> dict[str, list[Sweep]]:
        """Return each station's sweeps with this pair, in order of time; those that do not fit the settings left out.

        Raises:
            ConfigurationError: none is left, or real and quadrature ones are mixed.
        """
        result: dict[str, list[Sweep]] = {station: [] for station in stations}
        refused: collections.Counter[str] = collections.Counter()
        wanted = set(stations)
        for count, (_, _, message) in enumerate(self._bag.messages(self._sample_topics)):
            if progress is not None and count % 100 == 0:
                progress(count)
            if {message.station, message.peer} != wanted:
                continue
            sweep = from_message(message, Sweep)
            settings = self._settings_at(stations, sweep.stamp)[stations.index(sweep.station)]
            reason = refusal(sweep, np.asarray(sweep.samples), settings.sample_count)
            if reason:
                refused[reason] += 1
            else:
                result[sweep.station].append(sweep)
        self.missing += [f'left out: {count} sweeps ({reason})' for reason, count in refused.items()]
        kept = [sweep for sweeps in result.values() for sweep in sweeps]
        if not kept:
            raise ConfigurationError(f'{self._bag.path}: no usable sweep: {next(iter(refused))}')
        if len({sweep.iq for sweep in kept}) > 1:
            raise ConfigurationError(f'{self._bag.path}: real and quadrature samples are mixed')
        if len({len(sweep.samples) for sweep in kept}) > 1:
            raise ConfigurationError(f'{self._bag.path}: sweeps of different numbers of samples are mixed')
        for sweeps in result.values():
            sweeps.sort(key=lambda sweep: sweep.stamp)
        return result

    def _matched(self, stations: tuple[str, ...], of_station: dict[str, list[Sweep]]) -> list[tuple[Sweep | None, ...]]:
        """Return the sweeps of all stations that belong together, in order of time."""
        first, second = of_station[stations[0]], of_station[stations[-1]]
        if stations[0] == stations[-1]:
            return [(sweep,) for sweep in first]
        if not first or not second:
            return [(sweep, None) for sweep in first] + [(None, sweep) for sweep in second]
        partners: dict[int, list[Sweep]] = {}
        for sweep in second:
            partners.setdefault(sweep.sweep_id, []).append(sweep)
        matched = []
        for sweep in first:
            same = partners.get(sweep.sweep_id, [])  # several where numbers begin again
            nearest_one = min(same, key=lambda other: abs(other.stamp - sweep.stamp), default=None)
            if nearest_one is not None and abs(nearest_one.stamp - sweep.stamp) * 1e-9 <= _PAIRING:
                matched.append((sweep, nearest_one))
        alone = len(first) + len(second) - 2 * len(matched)
        if not matched:
            raise ConfigurationError(
                f"{self._bag.path}: no sweep of '{stations[0]}' and '{stations[1]}' has one number"
            )
        if alone:
            self.missing.append(f"left out: {alone} sweeps of which only one station's record is there")
        return matched

    def _say_what_is_missing(
        self,
        stations: tuple[str, ...],
        of_station: dict[str, list[Sweep]],
        sweeps: Sequence[tuple[SweepSettings, ...]],
    ) -> None:
        """Add what lacks to `missing`, and what can therefore not be told."""
        say = self.missing.append
        for station, peer in zip(stations, reversed(stations), strict=True):
            if not of_station[station]:
                say(
                    f'/{station}/if_samples is missing: nothing of its receiver can be told, nor to which station an '
                    f"effect on the chirps belongs; '{peer}' alone tells the distance no better than T_off is known"
                )
            if (station, peer) not in self._settings:
                say(f"/{station}/sweep_config is missing: its settings follow those of '{peer}'")
            if station not in self._calibrations:
                say(
                    f'/{station}/calibration is missing: its clocks count as nominal and its delay as zero, so errors '
                    'of both cannot be told from what the calibration would say'
                )
            else:
                calibration = self._calibrations[station].latest()
                lacking = [
                    words
                    for name, words in (('noise_floor', 'noise floor'), ('phase_noise_level', 'phase noise'))
                    if np.isnan(getattr(calibration, name))
                ]
                if lacking:
                    say(f"{' and '.join(lacking)} of '{station}' not characterised: an excess cannot be told")
            if station not in self._temperatures:
                say(f'/{station}/status is missing: nothing that goes with its board temperature can be told')
        lacking = [f'/site/{quantity}' for quantity in _WEATHER if quantity not in self._weather]
        if lacking:
            say(f'{", ".join(lacking)} missing: the default is used, refractivity cannot be told from the weather')
        if not len(self._reference.of('/'.join((stations[0], stations[-1]))).stamps):
            say(
                '/reference/range is missing: the measured distance stands in for it, so what only shifts the distance '
                '(clocks, air, delays, geometry, the reference itself) cannot be told'
            )
        for own, peer in zip(sweeps[0], reversed(sweeps[0]), strict=True):
            if np.isnan(peer.tx_eirp + own.rx_antenna_gain):
                say(f"EIRP or antenna gain unknown: a loss of power at '{own.station}' cannot be told")


def _holding(history: History, stamp: int) -> Any:
    """Return the value that holds at `stamp`, before all of them the first."""
    found = history.at(stamp)
    return history.first() if found is None else found[1]


def _held(history: History[float] | None, stamp: np.ndarray, default: float) -> np.ndarray:
    """Return the reading that holds at each stamp, `default` without any."""
    if not history:
        return np.full(len(stamp), default)
    return np.array([_holding(history, int(s)) for s in stamp], dtype=float)


def _reference_std(reference: Reference, stamp: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the standard deviation stated with the reference nearest to each stamp, NaN where there is none."""
    if not len(reference.stamps):
        return np.full(len(stamp), np.nan)
    after = np.clip(np.searchsorted(reference.stamps, stamp), 0, len(reference.stamps) - 1)
    before = np.maximum(after - 1, 0)
    later = np.abs(reference.stamps[after] - stamp) <= np.abs(stamp - reference.stamps[before])
    return np.where(np.isfinite(known), reference.stds[np.where(later, after, before)], np.nan)


def _groups(setting: np.ndarray, time: np.ndarray, distance: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Return the number of each sweep's group, (n,); arguments (n,), `std` of the distances."""
    step = np.diff(time)
    pause = max(_PAUSE, 5.0 * float(np.median(step))) if len(step) else _PAUSE
    noise = _noise(distance, std)
    still = _STILL + _PEAK * noise
    new = (np.diff(setting) != 0) | (step > pause) | (np.abs(np.diff(distance)) > _FASTEST * step + still)
    group = np.empty(len(time), int)
    number = 0
    for run in np.split(np.arange(len(time)), np.flatnonzero(new) + 1):
        parts = min(int((time[run[-1]] - time[run[0]]) / _STEADY) + 1, max(len(run) // GROUP, 1))
        drives = np.ptp(distance[run]) > still
        if drives:
            parts = max(parts, -(-len(run) // GROUP))
        for part in np.array_split(run, parts):
            for piece in _steady(part, time, distance, noise) if drives else [part]:
                group[piece] = number
                number += 1
    return group


def _steady(rows: np.ndarray, time: np.ndarray, distance: np.ndarray, noise: float) -> list[np.ndarray]:
    """Return the rows in pieces, halved until the speed is steady in each as far as the `noise` [m] of distances shows.

    Otherwise one velocity would not hold for a whole group of a crane that accelerates.
    """
    if len(rows) < 2 * _SMALLEST:
        return [rows]
    bend = np.polynomial.legendre.Legendre.fit(time[rows], distance[rows], 2).coef[2]
    # the coefficient's variance is that of the mean times 5; its polynomial reaches 1 at the ends
    if abs(bend) <= _BENT * noise * np.sqrt(5.0 / len(rows)):
        return [rows]
    return [piece for half in np.array_split(rows, 2) for piece in _steady(half, time, distance, noise)]


def _noise(distance: np.ndarray, std: np.ndarray) -> float:
    """Return the noise of distances, as stated or as they scatter from sweep to sweep if that is more [m]."""
    stated = float(np.median(std[np.isfinite(std)])) if np.isfinite(std).any() else 0.0
    if len(distance) < 3:
        return stated
    bends = np.diff(distance, 2)  # a steady drive has none; their standard deviation is sqrt(6) times the distance's
    return max(stated, _MAD_TO_STD * float(np.median(np.abs(bends))) / np.sqrt(6.0))


def _slopes(
    group: np.ndarray, time: np.ndarray, reference: np.ndarray, std: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the slope of the reference over each group and its standard deviation, (n,) [m/s]."""
    slope, error = np.full((2, len(group)), np.nan)
    for number in range(group[-1] + 1):
        rows = np.flatnonzero((group == number) & np.isfinite(reference))
        t = time[rows] - np.mean(time[rows]) if len(rows) else rows
        if len(rows) < 3 or not (spread := np.sum(t * t)):
            continue
        value = np.sum(t * reference[rows]) / spread
        residual = reference[rows] - np.mean(reference[rows]) - value * t
        # a reference that states too little is believed as far as its own scatter says
        noise = max(np.sqrt(np.mean(std[rows] ** 2)), np.sqrt(np.sum(residual**2) / (len(rows) - 2)))
        slope[group == number], error[group == number] = value, noise / np.sqrt(spread)
    return slope, error


def _sweeps_of(dataset: Dataset, rows: np.ndarray) -> Iterator[Sweep]:
    """Yield the sweeps of all stations."""
    for i, samples in enumerate(dataset.samples):
        if samples is None:
            continue
        own, peer = dataset.stations[i], dataset.stations[-1 - i]
        for row in rows:
            stamp = int(dataset.stamp[row]) + i  # stations in turn; the distance needs no finer one
            yield Sweep(own, peer, int(row), float(dataset.full_scale[i, row]), dataset.iq, samples[row], stamp)


def _measure(dataset: Dataset) -> Lines:
    """Return what the chain measures: maximum-likelihood beat frequencies, and their ranges."""
    shape = (len(dataset.stations), len(dataset))
    found = {name: np.full(shape, np.nan) for name in _LINE}
    density, flags = np.full(shape, np.nan), np.zeros(shape, int)
    ranges, stds = np.full((2, len(dataset)), np.nan)
    fusion = RangeFusion(FusionSettings(maximum_range=1e7))
    for calibration in dataset.calibration:
        fusion.add_calibration(dataclasses.replace(calibration, stamp=0))
    for quantity in _WEATHER:
        for stamp, value in zip(dataset.stamp, getattr(dataset, quantity), strict=True):
            fusion.add_weather(quantity, int(stamp), float(value))
    changes = np.flatnonzero(np.diff(dataset.setting)) + 1
    for run in np.split(np.arange(len(dataset)), changes):
        settings = dataset.sweeps[dataset.setting[run[0]]]
        processor = StationProcessor(EstimatorSettings(estimator='ml'))
        for calibration in dataset.calibration:
            processor.add_calibration(dataclasses.replace(calibration, stamp=0))
        for sweep in settings:
            processor.add_sweep_config(sweep)
            fusion.add_sweep_config(dataclasses.replace(sweep, stamp=int(dataset.stamp[run[0]])))
        for rows in np.array_split(run, -(-len(run) // _CHUNK)):
            beats = processor.process(list(_sweeps_of(dataset, rows)))
            for beat in sorted(beats, key=lambda b: b.stamp):
                at = dataset.stations.index(beat.station), beat.sweep_id
                for name in _LINE:
                    found[name][at] = getattr(beat, name)
                density[at] = beat.power - beat.snr + 10.0 * np.log10(settings[0].ramp_duration)
                flags[at] = beat.flags
                result = fusion.add_beat(beat)
                if result is not None:
                    ranges[beat.sweep_id], stds[beat.sweep_id] = result.range, result.range_std
        for i, samples in enumerate(dataset.samples):
            if samples is None:
                delay = _delay_of_one(
                    settings[1 - i], found['frequency'][1 - i, run], dataset.calibration[1 - i], dataset.calibration[i]
                )
                hardware = sum(c.delay for c in dataset.calibration)
                ranges[run] = (delay - hardware) * SPEED_OF_LIGHT / dataset.refractive_index[run]
    return Lines(**found, noise_density=density, flags=flags, range=ranges, range_std=stds)


def _delay_of_one(sweep: SweepSettings, frequency: np.ndarray, own: Calibration, peer: Calibration) -> np.ndarray:
    """Return the path's delay after one station's line, T_off taken as nominal [s]; `frequency` on its clock [Hz]."""
    near, far = (beat_frequency(sweep, delay, own.alpha, peer.alpha) for delay in (_FAR, 2.0 * _FAR))
    falls = sweep.role == Role.SECOND and sweep.mode == Mode.SHORT_DISTANCE  # with the delay
    line = (-1.0 if falls else 1.0) * own.sample_clock_alpha * frequency
    return _FAR + (line - near) * _FAR / (far - near)


def _with_measured_noise(dataset: Dataset) -> Dataset:
    """Return the dataset with measured noise floors where the calibration tells none."""
    calibrations = []
    for calibration, density in zip(dataset.calibration, dataset.lines.noise_density, strict=True):
        known = density[np.isfinite(density)]
        if np.isnan(calibration.noise_floor) and len(known):
            calibration = dataclasses.replace(calibration, noise_floor=float(np.median(known)))
        calibrations.append(calibration)
    return dataclasses.replace(dataset, calibration=tuple(calibrations))
