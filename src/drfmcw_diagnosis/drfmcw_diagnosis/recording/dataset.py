"""A recording as arrays: the sweeps of one pair of stations with everything known about the conditions around them."""

import collections
import dataclasses
import functools
import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from drfmcw_fusion.integrity.settings import IntegritySettings
from drfmcw_fusion.offline import Reference
from drfmcw_fusion.pipeline import RangeFusion
from drfmcw_fusion.replayed.statistics import reference_at
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.processing.processor import StationProcessor, refusal
from drfmcw_node.processing.records import Sweep
from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError, nearest
from drfmcw_physics.sweep import Mode, Role, SweepSettings, beat_frequency
from drfmcw_ros.bag.files import BagError, BagReader
from drfmcw_ros.graph.messages import from_message
from drfmcw_ros.graph.topics import is_measured, split_station_topic
from drfmcw_sim.measurements import Measurements
from drfmcw_sim.nominal import link_budget, nominal_measurements

from .conditions import WEATHER, Conditions
from .grouping import groups, slopes
from .limits import GROUPS, LINES
from .ramp_ends import without_silent_ends
from .topology import Topology

_LINE = ('frequency', 'frequency_std', 'phase', 'power')  # fields of Beat and of Lines


@dataclasses.dataclass(frozen=True)
class Lines:
    """What the chain itself measures, every sweep on its own; NaN where a station has no result."""

    frequency: np.ndarray  # (stations, n) on each station's nominal clock [Hz]
    frequency_std: np.ndarray  # (stations, n) [Hz]
    phase: np.ndarray  # (stations, n) [rad]
    power: np.ndarray  # (stations, n) at the receive antenna port [dBm]
    noise_density: np.ndarray  # (stations, n) of the additive noise at the receive antenna port [dBm/Hz]
    flags: np.ndarray  # (stations, n) bits of drfmcw_node.estimators.estimation.Flag
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
    reference_std: np.ndarray  # (n,) of each reading by itself [m]
    reference_limit: np.ndarray  # (n,) standard deviation that readings at one distance share: of a mark [m]
    missing: tuple[str, ...]  # what the recording lacks and what therefore cannot be tested
    noise_measured: tuple[bool, ...]  # of each station: the calibration gave no noise floor and holds the measured one
    lacking: frozenset[str]  # missing topics of calibration and weather: nominal values and defaults are used

    def __len__(self) -> int:
        """Return the number of sweeps."""
        return len(self.sweep_id)

    @functools.cached_property
    def topology(self) -> Topology:
        """Which stations take part, and which of them have samples."""
        return Topology(self.stations, tuple(i for i, x in enumerate(self.samples) if x is not None), self.iq)

    def samples_of(self, station: int) -> np.ndarray:
        """Return the samples of a station by its number.

        Raises:
            ValueError: it has none.
        """
        samples = self.samples[station]
        if samples is None:
            raise ValueError(f"station '{self.stations[station]}' has no samples")
        return samples

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
            ConfigurationError: no sweep has either of them.
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
        driving crane are taken together by `GROUPS.most` at most, by fewer where it accelerates.
        """
        std = self.reference_std
        if not np.isfinite(self.reference).all():
            std = np.where(np.isfinite(self.reference), std, self.lines.range_std)
        return groups(self.setting, self.time, self.distance, std)

    @functools.cached_property
    def _slope(self) -> tuple[np.ndarray, np.ndarray]:
        return slopes(self.group, self.time, self.reference, self.reference_std)

    @property
    def velocity(self) -> np.ndarray:
        """Slope of the reference over its group, (n,) [m/s]; NaN with fewer than three readings."""
        return self._slope[0]

    @property
    def velocity_std(self) -> np.ndarray:
        """Standard deviation of `velocity`, (n,) [m/s]; a standing crane's velocity is zero within it."""
        return self._slope[1]

    @functools.cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Velocity over each group and its standard deviation, (n,) each [m/s], by the ranges without a reference."""
        velocity, std = self._slope
        unknown = np.isnan(velocity)
        if not unknown.any():
            return velocity, std
        track, track_std = slopes(self.group, self.time, self.lines.range, self.lines.range_std)
        return np.where(unknown, track, velocity), np.where(unknown, track_std, std)

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
        ConfigurationError: what it holds does not fit together, or the distance is unknown.
    """
    with BagReader(path) as bag:
        topics = [t for t in bag.topics if split_station_topic(t)[1] == 'if_samples']
        if not topics:
            raise BagError(f"{bag.path}: holds no '/<station>/if_samples'; topics: {', '.join(sorted(bag.topics))}")
        conditions = Conditions()
        for topic, _, message in bag.messages({t for t in bag.topics if is_measured(t)} - set(topics)):
            try:
                conditions.take(topic, message)
            except ConfigurationError as error:
                raise BagError(f"{bag.path}: topic '{topic}': {error}") from None
        missing: list[str] = []
        stations = _choose(bag, topics, conditions, pair, missing)
        return assembled(str(bag.path), conditions, stations, _sweeps_in(bag, topics, stations, progress), missing)


def _choose(
    bag: BagReader, topics: Sequence[str], conditions: Conditions, pair: str | None, missing: list[str]
) -> tuple[str, ...]:
    """Return the stations of the pair, in order of their roles; `missing` gets the pairs that are left out."""
    counts: collections.Counter[tuple[str, ...]] = collections.Counter()
    for _, _, message in bag.messages(topics):
        counts[tuple(sorted({message.station, message.peer}))] += 1
    if not counts:
        raise BagError(f'{bag.path}: holds not one message of IF samples')
    names = {stations: '/'.join(order) for stations in counts if (order := conditions.ordered(stations))}
    if not names:
        needed = ' or '.join(sorted({f"'/{s}/sweep_config'" for stations in counts for s in stations}))
        raise BagError(f'{bag.path}: no sweep settings of the stations that have samples: needs {needed}')
    if pair is None:
        chosen = max(sorted(names), key=lambda stations: counts[stations])
        if len(counts) > 1:
            others = ', '.join(sorted(names.get(s) or '/'.join(s) for s in counts if s != chosen))
            missing.append(f'only the pair {names[chosen]} is looked at; the recording also holds {others}')
    else:
        chosen = tuple(sorted(set(pair.split('/'))))
        if chosen not in names:
            raise BagError(f"{bag.path}: unknown pair '{pair}'{nearest(pair, sorted(names.values()))}")
    return tuple(dict.fromkeys(names[chosen].split('/')))


def _sweeps_in(
    bag: BagReader, topics: Sequence[str], stations: Sequence[str], progress: Callable[[int], None] | None
) -> Iterator[Sweep]:
    """Yield the sweeps of the stations with each other."""
    wanted = set(stations)
    for count, (_, _, message) in enumerate(bag.messages(topics)):
        if progress is not None and count % 100 == 0:
            progress(count)
        if {message.station, message.peer} == wanted:
            yield from_message(message, Sweep)


# --- from sweeps and conditions, wherever they come from ---


def assembled(
    path: str, conditions: Conditions, stations: tuple[str, ...], sweeps: Iterable[Sweep], missing: Sequence[str] = ()
) -> Dataset:
    """Return sweeps with everything known about the conditions around them.

    Args:
        path: where they come from, for messages.
        conditions: of the stations that have samples, settings at least.
        stations: (first, second), or the one that hears itself.
        sweeps: of these stations with each other, in any order.
        missing: what is already known to be missing, in sentences.

    Raises:
        ConfigurationError: nothing usable, what does not fit together, or an unknown distance.
    """
    said = list(missing)
    of_station = _usable(path, conditions, stations, sweeps, said)
    matched = _matched(path, stations, of_station, said)
    present = [[s for s in m if s is not None] for m in matched]
    heard = np.array([p[0].stamp for p in present])
    late = [
        0.0 if m[0] else conditions.settings_at(stations, p[0].stamp)[1].start_delay
        for m, p in zip(matched, present, strict=True)
    ]
    stamp = heard - np.rint(np.array(late) * 1e9).astype(np.int64)
    held = [conditions.settings_at(stations, int(instant)) for instant in heard]
    settings = {repr(s): s for s in dict.fromkeys(held)}  # unlike NaN, its name equals itself
    numbers = {name: number for number, name in enumerate(settings)}
    said += conditions.missing(stations, [s for s in stations if of_station[s]], next(iter(settings.values())))
    reference = conditions.reference(stations)
    known = reference_at(reference, heard)
    calibrations = tuple(conditions.calibration(s, int(stamp[0])) for s in stations)
    dataset = Dataset(
        path=path,
        stations=stations,
        samples=tuple(
            np.stack([np.asarray(s.samples) for m in matched if (s := m[i])]) if of_station[station] else None
            for i, station in enumerate(stations)
        ),
        full_scale=np.array(
            [[(m[i] or p[0]).full_scale for m, p in zip(matched, present, strict=True)] for i in range(len(stations))]
        ),
        iq=present[0][0].iq,
        sweep_id=np.array([p[0].sweep_id for p in present]),
        stamp=stamp,
        sweeps=tuple(settings.values()),
        setting=np.array([numbers[repr(s)] for s in held]),
        calibration=calibrations,
        board_temperature=np.array([conditions.board_temperature(s, heard) for s in stations]),
        **conditions.weather(heard),
        reference=known,
        reference_std=_reference_std(reference, heard, known),
        reference_limit=np.zeros(len(heard)),
        missing=tuple(said),
        noise_measured=tuple(bool(np.isnan(c.noise_floor)) for c in calibrations),
        lacking=conditions.lacking(stations),
    )
    if not dataset.topology.hears_itself:
        kept = without_silent_ends(dataset.sweeps, dataset.setting, dataset.samples, dataset.iq)
        dataset = dataclasses.replace(dataset, sweeps=kept)
    if any(dataset.noise_measured):
        dataset = _with_measured_noise(dataset)
    _ = dataset.group  # raises at once where the distance is unknown
    return dataset


def _usable(
    path: str, conditions: Conditions, stations: tuple[str, ...], sweeps: Iterable[Sweep], said: list[str]
) -> dict[str, list[Sweep]]:
    """Return each station's sweeps in order of time; those that do not fit the settings are left out, and said.

    Raises:
        ConfigurationError: none is left, or real and quadrature ones are mixed.
    """
    result: dict[str, list[Sweep]] = {station: [] for station in stations}
    refused: collections.Counter[str] = collections.Counter()
    before: set[tuple[str, bytes]] = set()
    for sweep in sweeps:
        settings = conditions.settings_at(stations, sweep.stamp)[stations.index(sweep.station)]
        samples = np.asarray(sweep.samples)
        reason = refusal(sweep, samples, settings.sample_count)
        content = sweep.station, hashlib.sha256(samples.tobytes()).digest()
        if not reason and content in before:  # no receiver's noise comes twice
            reason = 'equal to an earlier one, sample by sample'
        before.add(content)
        if reason:
            refused[reason] += 1
        else:
            result[sweep.station].append(sweep)
    said += [f'left out: {count} sweeps ({reason})' for reason, count in refused.items()]
    kept = [sweep for of_one in result.values() for sweep in of_one]
    if not kept:
        raise ConfigurationError(f'{path}: no usable sweep: {next(iter(refused), "there is none")}')
    if len({sweep.iq for sweep in kept}) > 1:
        raise ConfigurationError(f'{path}: real and quadrature samples are mixed')
    if len({len(sweep.samples) for sweep in kept}) > 1:
        raise ConfigurationError(f'{path}: sweeps of different numbers of samples are mixed')
    for of_one in result.values():
        of_one.sort(key=lambda sweep: sweep.stamp)
    return result


def _matched(
    path: str, stations: tuple[str, ...], of_station: dict[str, list[Sweep]], said: list[str]
) -> list[tuple[Sweep | None, ...]]:
    """Return the sweeps of all stations that belong together, in order of time; those left alone are said."""
    first, second = of_station[stations[0]], of_station[stations[-1]]
    if stations[0] == stations[-1]:
        return [(sweep,) for sweep in first]
    if not first or not second:
        return [(sweep, None) for sweep in first] + [(None, sweep) for sweep in second]
    partners: dict[int, list[Sweep]] = {}
    for sweep in second:
        partners.setdefault(sweep.sweep_id, []).append(sweep)
    matched: list[tuple[Sweep | None, ...]] = []
    for sweep in first:
        same = partners.get(sweep.sweep_id, [])  # several where numbers begin again
        nearest_one = min(same, key=lambda other: abs(other.stamp - sweep.stamp), default=None)
        if nearest_one is not None and abs(nearest_one.stamp - sweep.stamp) <= GROUPS.pairing:
            matched.append((sweep, nearest_one))
    alone = len(first) + len(second) - 2 * len(matched)
    if not matched:
        raise ConfigurationError(f"{path}: no sweep of '{stations[0]}' and '{stations[1]}' has one number")
    if alone:
        said.append(f"left out: {alone} sweeps of which only one station's record is there")
    return matched


def _reference_std(reference: Reference, stamp: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the standard deviation stated with the reference nearest to each stamp, NaN where there is none."""
    if not len(reference.stamps):
        return np.full(len(stamp), np.nan)
    after = np.clip(np.searchsorted(reference.stamps, stamp), 0, len(reference.stamps) - 1)
    before = np.maximum(after - 1, 0)
    later = np.abs(reference.stamps[after] - stamp) <= np.abs(stamp - reference.stamps[before])
    return np.where(np.isfinite(known), reference.stds[np.where(later, after, before)], np.nan)


def _sweeps_of(dataset: Dataset, rows: np.ndarray) -> Iterator[Sweep]:
    """Yield the sweeps of all stations."""
    for i, samples in enumerate(dataset.samples):
        if samples is None:
            continue
        own, peer = dataset.stations[i], dataset.stations[-1 - i]
        for row in rows:
            stamp = int(dataset.stamp[row]) + i  # stations in turn; the distance needs no finer one
            yield Sweep(own, peer, int(row), float(dataset.full_scale[i, row]), dataset.iq, samples[row], stamp)


def _fusion(dataset: Dataset) -> RangeFusion:
    """Return a fusion that knows calibrations, weather and board temperatures."""
    alone = dataset.topology.hears_itself  # then what noise does to a range is wanted, and nothing else
    settings = FusionSettings(maximum_range=1e7, velocity='standing' if alone else 'tracked')
    fusion = RangeFusion(settings, IntegritySettings(monitor=not alone))
    for calibration in dataset.calibration:
        fusion.add_calibration(dataclasses.replace(calibration, stamp=0))
    for quantity in WEATHER:
        for stamp, value in zip(dataset.stamp, getattr(dataset, quantity), strict=True):
            fusion.add_weather(quantity, int(stamp), float(value))
    for station, temperatures in zip(dataset.stations, dataset.board_temperature, strict=True):
        for row in np.flatnonzero(np.isfinite(temperatures)):
            fusion.add_board_temperature(station, int(dataset.stamp[row]), float(temperatures[row]))
    return fusion


def _measure(dataset: Dataset) -> Lines:
    """Return what the chain measures: maximum-likelihood beat frequencies, and their ranges."""
    shape = (len(dataset.stations), len(dataset))
    found = {name: np.full(shape, np.nan) for name in _LINE}
    density, flags = np.full(shape, np.nan), np.zeros(shape, int)
    ranges, stds = np.full((2, len(dataset)), np.nan)
    fusion = _fusion(dataset)
    changes = np.flatnonzero(np.diff(dataset.setting)) + 1
    for run in np.split(np.arange(len(dataset)), changes):
        settings = dataset.sweeps[dataset.setting[run[0]]]
        processor = StationProcessor(EstimatorSettings(estimator='ml'))
        for calibration in dataset.calibration:
            processor.add_calibration(dataclasses.replace(calibration, stamp=0))
        warm = [c.at(_middle(t[run])) for c, t in zip(dataset.calibration, dataset.board_temperature, strict=True)]
        for station, temperatures in zip(dataset.stations, dataset.board_temperature[:, run], strict=True):
            processor.add_board_temperature(station, 0, _middle(temperatures))
        for sweep in settings:
            processor.add_sweep_config(sweep)
            fusion.add_sweep_config(dataclasses.replace(sweep, stamp=int(dataset.stamp[run[0]])))
        for rows in np.array_split(run, -(-len(run) // LINES.chunk)):
            beats = processor.process(list(_sweeps_of(dataset, rows)))
            for beat in sorted(beats, key=lambda b: b.stamp):
                at = dataset.stations.index(beat.station), beat.sweep_id
                for name in _LINE:
                    found[name][at] = getattr(beat, name)
                density[at] = beat.power - beat.snr + 10.0 * np.log10(settings[0].ramp_duration)
                flags[at] = beat.flags
                result = fusion.add_beat(beat)
                if result is not None:
                    ranges[beat.sweep_id], stds[beat.sweep_id] = result.range, result.white_std
        for i, samples in enumerate(dataset.samples):
            if samples is None:
                delay = delay_of_one(settings[1 - i], found['frequency'][1 - i, run], warm[1 - i], warm[i])
                hardware = sum(c.delay for c in warm)
                ranges[run] = (delay - hardware) * SPEED_OF_LIGHT / dataset.refractive_index[run]
    return Lines(**found, noise_density=density, flags=flags, range=ranges, range_std=stds)


def _middle(temperatures: np.ndarray) -> float:
    """Return the mean of the known temperatures [degC], NaN where none is."""
    known = temperatures[np.isfinite(temperatures)]
    return float(np.mean(known)) if len(known) else np.nan


def delay_of_one(sweep: SweepSettings, frequency: np.ndarray, own: Calibration, peer: Calibration) -> np.ndarray:
    """Return the path's delay after one station's line, T_off taken as nominal [s]; `frequency` on its clock [Hz]."""
    near, far = (beat_frequency(sweep, delay, own.alpha, peer.alpha) for delay in (LINES.far, 2.0 * LINES.far))
    falls = sweep.role == Role.SECOND and sweep.mode == Mode.SHORT_DISTANCE  # with the delay
    line = (-1.0 if falls else 1.0) * own.sample_clock_alpha * frequency
    return LINES.far + (line - near) * LINES.far / (far - near)


def _with_measured_noise(dataset: Dataset) -> Dataset:
    """Return the dataset with measured noise floors where the calibration gives none."""
    calibrations = []
    for calibration, density in zip(dataset.calibration, dataset.lines.noise_density, strict=True):
        known = density[np.isfinite(density)]
        if np.isnan(calibration.noise_floor) and len(known):
            calibration = dataclasses.replace(calibration, noise_floor=float(np.median(known)))
        calibrations.append(calibration)
    return dataclasses.replace(dataset, calibration=tuple(calibrations))
