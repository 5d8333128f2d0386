"""Scenario: site, stations, pairs, trajectories, weather, noise and effects, read from YAML."""

import dataclasses
import functools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.mode import ModeSettings
from drfmcw_physics.rules.schedule import LARGEST_PRIORITY, LARGEST_RATE, Demand, Schedule, schedule
from drfmcw_physics.settings import (
    ConfigurationError,
    Parameter,
    check_value,
    from_mapping,
    nearest,
    parameter,
    read_yaml,
)
from drfmcw_physics.sweep import Mode, Role, SweepSettings
from drfmcw_ros.calibration.document import read_document
from drfmcw_ros.commands.config_files import find_config

from .effects import Effect, effect_from_mapping
from .synthesis.measured import Measured, read_measured
from .trajectory import Drive, Profile, Recorded, Standing

_PROFILE = 'true value: a number, or `{times: [s], values: []}`'


@dataclasses.dataclass(frozen=True)
class StationSettings:
    """One station as calibrated, unless `calibration` names a document; effects make its true values differ."""

    alpha: float = parameter(1.0, bounds=(0.999, 1.001), description='reference frequency / nominal')
    sample_clock_alpha: float = parameter(
        math.nan,
        bounds=(0.999, 1.001),
        nan_means='made from the reference, as alpha',
        description='ADC clock / nominal',
    )
    calibration_temperature: float = parameter(
        25.0, unit='degC', bounds=(-100.0, 150.0), description='board temperature at calibration'
    )
    delay: float = parameter(0.0, unit='s', bounds=(-1e-3, 1e-3), description="this station's part of the path's delay")
    noise_floor: float = parameter(
        -140.7, unit='dBm/Hz', bounds=(-250.0, 0.0), description='additive noise at the receive antenna port'
    )
    phase_noise_level: float = parameter(
        -90.0, unit='dBc/Hz', bounds=(-250.0, 0.0), nan_means='no phase noise',
        description='single side-band at 100 kHz offset',
    )  # fmt: skip
    phase_noise_corner: float = parameter(
        200e3, unit='Hz', bounds=(100.0, 1e9), description='corner of the one-pole phase-noise shape'
    )
    tx_eirp: float = parameter(13.0, unit='dBm', bounds=(-200.0, 100.0), description='transmitted EIRP')
    rx_antenna_gain: float = parameter(21.0, unit='dBi', bounds=(-100.0, 100.0), description='receive antenna gain')
    full_scale_power: float = parameter(
        -20.0, unit='dBm', bounds=(-200.0, 100.0), description='power of a full-scale sine at the receive antenna port'
    )
    alpha_linear: float = parameter(
        0.0, unit='1/K', bounds=(-1e-5, 1e-5),
        description='alpha over board temperature: factor of d, its excess over that at calibration; the ADC follows',
    )  # fmt: skip
    alpha_quadratic: float = parameter(0.0, unit='1/K^2', bounds=(-1e-6, 1e-6), description='factor of d^2')
    alpha_cubic: float = parameter(0.0, unit='1/K^3', bounds=(-1e-8, 1e-8), description='factor of d^3')
    delay_slope: float = parameter(
        0.0, unit='s/K', bounds=(-1e-8, 1e-8), description='delay over board temperature: factor of d'
    )
    calibration: str = parameter(
        '', description='calibration document that the station publishes, beside this file; empty: the true values'
    )
    adc_bits: int = parameter(14, bounds=(2, 16), description='ADC resolution')
    frame_id: str = parameter('', description="the antenna's frame; empty: <station>_antenna")
    board_temperature: Profile = parameter(Profile([25.0]), unit='degC', description=_PROFILE)


@dataclasses.dataclass(frozen=True)
class WaveformSettings:
    """Nominal sweep, the same at all stations."""

    start_frequency: float = parameter(5725e6, unit='Hz', bounds=(1e6, 1e12), description='f_0 of first stations')
    bandwidth: float = parameter(
        150e6, unit='Hz', bounds=(-1e11, 1e11), description='B_sw, negative for a falling ramp'
    )
    ramp_duration: float = parameter(1e-3, unit='s', bounds=(1e-6, 100.0), description='T_sw')
    sample_rate: float = parameter(2.048e6, unit='Hz', bounds=(1e2, 1e10), description='ADC rate')
    sample_count: int = parameter(2048, bounds=(16, 1 << 24), description='samples per sweep')
    iq: bool = parameter(False, description='quadrature receiver')


@dataclasses.dataclass(frozen=True)
class _PairParameters:
    """Settings of a pair except its trajectory, of which there are several kinds."""

    first: str = parameter(description='station that starts first')
    second: str = parameter(description='station that starts T_off later')
    path_loss: float = parameter(
        math.nan, unit='dB', bounds=(-50.0, 300.0), nan_means='free space',
        description='loss between the antenna ports, antennas left out, at any distance (attenuator of a cable set-up)',
    )  # fmt: skip
    frequency_offset: float = parameter(
        0.0, unit='Hz', bounds=(-1e9, 1e9), description='f_o,off = f_0 of the first minus f_0 of the second station'
    )
    rate: float = parameter(
        math.nan, unit='Hz', bounds=(1e-6, LARGEST_RATE), nan_means='an equal share of the time that is left',
        description='at least so many sweeps per second, in time division with other pairs',
    )  # fmt: skip
    priority: int = parameter(
        0, bounds=(-LARGEST_PRIORITY, LARGEST_PRIORITY), description='the higher one gets its rate first'
    )


@dataclasses.dataclass(frozen=True)
class PairSettings(_PairParameters):
    """Two stations that measure their distance; the same name twice for a station that hears itself."""

    trajectory: Standing | Drive | Recorded = dataclasses.field(kw_only=True)

    @property
    def hears_itself(self) -> bool:
        """True for a station alone with a reflector or cable loop."""
        return self.first == self.second


@dataclasses.dataclass(frozen=True)
class WeatherSettings:
    """Weather on the path, and the noise with which its sensors report it."""

    temperature: Profile = parameter(Profile([15.0]), unit='degC', description=_PROFILE)
    pressure: Profile = parameter(Profile([101325.0]), unit='Pa', description=_PROFILE)
    humidity: Profile = parameter(Profile([0.6]), description=f'relative, 0 ... 1; {_PROFILE}')
    temperature_std: float = parameter(0.2, unit='degC', bounds=(0.0, 50.0), description='noise of the reported value')
    pressure_std: float = parameter(20.0, unit='Pa', bounds=(0.0, 1e4), description='noise of the reported value')
    humidity_std: float = parameter(0.01, bounds=(0.0, 1.0), description='noise of the reported value, 0..1')
    interval: float = parameter(10.0, unit='s', bounds=(1e-3, 1e6), description='time between two reports')


@dataclasses.dataclass(frozen=True)
class ReferenceSettings:
    """Independent instrument that measures the distance of a pair."""

    enabled: bool = parameter(True, description='false where there is none')
    range_std: float = parameter(0.005, unit='m', bounds=(0.0, 1e3), description='noise of each reading')
    interval: float = parameter(
        0.0, unit='s', bounds=(0.0, 1e6),
        description='time between two readings of the first pair; 0: one of the measuring pair with every sweep',
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class TimingSettings:
    """When sweeps happen, and how they vary."""

    sweep_interval: float = parameter(
        0.02,
        unit='s',
        bounds=(1e-5, 1e6),
        description='of a slot of the time division: from one sweep pair to the next',
    )
    mode_change_duration: float = parameter(
        0.05, unit='s', bounds=(0.0, 1e3), description='time without sweeps while the hardware changes its mode'
    )
    start_delay_jitter: float = parameter(
        2e-9, unit='s', bounds=(0.0, 1e-3), description='standard deviation of the true T_off from sweep to sweep'
    )
    amplitude_scatter: float = parameter(
        0.3, unit='dB', bounds=(0.0, 20.0), description='standard deviation of the received power from sweep to sweep'
    )
    start_time: float = parameter(
        1.7e9, unit='s', bounds=(0.0, 9e9), description='UNIX time of the first sweep of a recording'
    )
    status_interval: float = parameter(1.0, unit='s', bounds=(1e-3, 1e6), description='between two station status')


@dataclasses.dataclass(frozen=True)
class Scenario:
    """Everything that a simulation needs."""

    stations: dict[str, StationSettings]
    pairs: tuple[PairSettings, ...]
    waveform: WaveformSettings = WaveformSettings()
    mode: ModeSettings = ModeSettings()
    weather: WeatherSettings = WeatherSettings()
    reference: ReferenceSettings = ReferenceSettings()
    timing: TimingSettings = TimingSettings()
    effects: tuple[Effect, ...] = ()
    stored: dict[str, Calibration] = dataclasses.field(default_factory=dict)  # by station, where it is not the truth
    seed: int = parameter(1, bounds=(0, 2**63 - 1), description='of all random numbers')

    @functools.cached_property
    def schedule(self) -> Schedule:
        """Which pair measures in which slot, before somebody asks for other rates."""
        return schedule([Demand(p.rate, p.priority) for p in self.pairs], self.timing.sweep_interval)

    def published_calibration(self, station: str) -> Calibration:
        """Return the calibration that a station publishes: a stored document's, else the true one."""
        stored = self.stored.get(station)
        if stored is None:
            return self.calibration(station)
        return dataclasses.replace(stored, frame_id=self.frame_id(station))

    def calibration(self, station: str) -> Calibration:
        """Return the calibration that holds for a station exactly, effects aside."""
        s = self.stations[station]
        sample_clock = s.alpha if math.isnan(s.sample_clock_alpha) else s.sample_clock_alpha
        return Calibration(
            station=station,
            alpha=s.alpha,
            sample_clock_alpha=sample_clock,
            alpha_linear=s.alpha_linear,
            alpha_quadratic=s.alpha_quadratic,
            alpha_cubic=s.alpha_cubic,
            sample_clock_linear=s.alpha_linear * sample_clock / s.alpha,
            sample_clock_quadratic=s.alpha_quadratic * sample_clock / s.alpha,
            sample_clock_cubic=s.alpha_cubic * sample_clock / s.alpha,
            delay_slope=s.delay_slope,
            temperature=s.calibration_temperature,
            delay=s.delay,
            noise_floor=s.noise_floor,
            phase_noise_level=s.phase_noise_level,
            phase_noise_corner=s.phase_noise_corner,
            frame_id=self.frame_id(station),
        )

    def frame_id(self, station: str) -> str:
        """Return the frame of a station's antenna."""
        return self.stations[station].frame_id or f'{station}_antenna'

    def sweep_settings(self, pair: PairSettings, mode: Mode, start_delay: float) -> tuple[SweepSettings, ...]:
        """Return the settings of the first and the second station of a pair (one, where it hears itself)."""
        settings = []
        names = [(pair.first, pair.second, Role.FIRST, 0.0)]
        if not pair.hears_itself:
            names.append((pair.second, pair.first, Role.SECOND, pair.frequency_offset))
        for station, peer, role, offset in names:
            s = self.stations[station]
            settings.append(
                SweepSettings(
                    station=station,
                    peer=peer,
                    role=int(role),
                    mode=int(mode),
                    start_frequency=self.waveform.start_frequency - offset,
                    bandwidth=self.waveform.bandwidth,
                    ramp_duration=self.waveform.ramp_duration,
                    start_delay=0.0 if pair.hears_itself else start_delay,
                    sample_rate=self.waveform.sample_rate,
                    sample_count=self.waveform.sample_count,
                    tx_eirp=s.tx_eirp,
                    rx_antenna_gain=s.rx_antenna_gain,
                    full_scale_power=s.full_scale_power,
                    frame_id=self.frame_id(station),
                )
            )
        return tuple(settings)


_SECTIONS = {
    'waveform': WaveformSettings,
    'mode': ModeSettings,
    'reference': ReferenceSettings,
    'timing': TimingSettings,
}
_KEYS = ('description', 'stations', 'pairs', *_SECTIONS, 'weather', 'effects', 'measured', 'seed')


def _with_profiles(mapping: Any, names: tuple[str, ...]) -> Any:
    """Return the mapping with single numbers turned into constant profiles."""
    if not isinstance(mapping, Mapping):
        return mapping
    return {k: {'values': [v]} if k in names and not isinstance(v, Mapping) else v for k, v in mapping.items()}


def _pair(mapping: Any, where: str, stations: list[str]) -> PairSettings:
    if not isinstance(mapping, Mapping):
        raise ConfigurationError(f'{where}: expected a mapping of settings, not {mapping!r}')
    kinds = {'standing': Standing, 'drive': Drive, 'recorded': Recorded}
    given = [k for k in kinds if k in mapping]
    for key in mapping:
        valid = [f.name for f in dataclasses.fields(_PairParameters)] + list(kinds)
        if key not in valid:
            raise ConfigurationError(f"{where}: unknown key '{key}'{nearest(key, valid)}")
    if len(given) != 1:
        raise ConfigurationError(f"{where}: needs one of 'standing', 'drive' and 'recorded'")
    trajectory = from_mapping(kinds[given[0]], mapping[given[0]], f'{where}: {given[0]}')
    pair = from_mapping(_PairParameters, {k: v for k, v in mapping.items() if k not in kinds}, where)
    for station in (pair.first, pair.second):
        if station not in stations:
            raise ConfigurationError(f"{where}: unknown station '{station}'{nearest(station, stations)}")
    return PairSettings(**vars(pair), trajectory=trajectory)


def scenario_from_mapping(mapping: Mapping[str, Any], where: str) -> Scenario:
    """Build a scenario from a mapping read from YAML.

    Args:
        mapping: sections `stations` (name: settings), `pairs` (list) and optionally `waveform`, `mode`, `weather`,
            `reference`, `timing`, `effects` (list), `measured` (file), `seed`, `description`.
        where: file name, for messages, and for files whose names are relative to it.

    Raises:
        ConfigurationError: unknown or missing key, wrong value, station that does not exist.
    """
    for key in mapping:
        if key not in _KEYS:
            raise ConfigurationError(f"{where}: unknown key '{key}'{nearest(key, _KEYS)}")
    for key, kind in (('stations', Mapping), ('pairs', list), ('effects', list)):
        if key in mapping and not isinstance(mapping[key], kind) or (key != 'effects' and not mapping.get(key)):
            raise ConfigurationError(f"{where}: '{key}' must be a non-empty {'mapping' if kind is Mapping else 'list'}")
    stations = {}
    for name, settings in mapping['stations'].items():
        if not isinstance(name, str) or not name.isidentifier():
            raise ConfigurationError(f"{where}: stations: '{name}' is no valid name (letters, digits and _)")
        stations[name] = from_mapping(
            StationSettings, _with_profiles(settings, ('board_temperature',)), f'{where}: stations: {name}'
        )
    names = list(stations)
    pairs = tuple(_pair(p, f'{where}: pairs[{i}]', names) for i, p in enumerate(mapping['pairs']))
    if len({frozenset((p.first, p.second)) for p in pairs}) < len(pairs):
        raise ConfigurationError(f'{where}: pairs: two pairs of the same stations')
    sections = {
        key: from_mapping(cls, mapping[key], f'{where}: {key}') for key, cls in _SECTIONS.items() if key in mapping
    }
    if 'weather' in mapping:
        weather = _with_profiles(mapping['weather'], ('temperature', 'pressure', 'humidity'))
        sections['weather'] = from_mapping(WeatherSettings, weather, f'{where}: weather')
    effects = tuple(
        effect_from_mapping(e, f'{where}: effects[{i}]', names) for i, e in enumerate(mapping.get('effects', []))
    )
    if 'measured' in mapping:
        effects = (*effects, _measured(mapping['measured'], where))
    seed = check_value('seed', mapping.get('seed', 1), int, Parameter('1', '', (0, 2**63 - 1)), where)
    stored = {name: _stored(s.calibration, name, where) for name, s in stations.items() if s.calibration}
    scenario = Scenario(stations, pairs, **sections, effects=effects, stored=stored, seed=seed)
    _check(scenario, where)
    return scenario


def _stored(name: str, station: str, where: str) -> Calibration:
    """Return the calibration of a document, whose name is relative to the scenario's."""
    document = read_document(Path(where).parent / name)
    if document.station != station:
        raise ConfigurationError(f"{where}: stations: {station}: calibration {name} is of station '{document.station}'")
    return document.calibration()


def _measured(name: Any, where: str) -> Measured:
    """Return the measured remainder of a file, whose name is relative to the scenario's."""
    if not isinstance(name, str) or not name:
        raise ConfigurationError(f"{where}: 'measured' must be the name of a file, not {name!r}")
    try:
        return Measured(read_measured(Path(where).parent / name))
    except ConfigurationError as error:
        raise ConfigurationError(f'{where}: measured: {error}') from None


def _check(scenario: Scenario, where: str) -> None:
    """Refuse settings that are valid one by one but not together."""
    limits = {'temperature': (-90.0, 70.0), 'pressure': (3e4, 1.2e5), 'humidity': (0.0, 1.0)}
    for name, (low, high) in limits.items():
        for value in getattr(scenario.weather, name).values:
            if not low <= value <= high:
                raise ConfigurationError(f'{where}: weather: {name} = {value:g} is outside {low:g} ... {high:g}')
    for i, pair in enumerate(scenario.pairs):
        try:
            for mode in Mode:
                scenario.sweep_settings(pair, mode, scenario.mode.start_delay(mode))
            if isinstance(pair.trajectory, Recorded):
                scenario.sweep_settings(pair, Mode.SHORT_DISTANCE, max(pair.trajectory.start_delays))
        except ConfigurationError as error:
            raise ConfigurationError(f'{where}: pairs[{i}]: {error}') from None
    busy = scenario.waveform.ramp_duration + scenario.mode.start_delay_short
    interval = scenario.timing.sweep_interval
    if interval < busy:
        raise ConfigurationError(
            f'{where}: timing: sweep_interval = {interval:g} s is shorter than a sweep ({busy:g} s)'
        )


def override(mapping: dict[str, Any], assignment: str) -> None:
    """Apply one ``section.key=value`` to a scenario's mapping, in place; list items are counted: ``pairs.0.first=a``.

    Raises:
        ConfigurationError: no `=`, or the path leads through something that is not there.
    """
    path, equals, text = assignment.partition('=')
    if not equals or not path:
        raise ConfigurationError(f"--set '{assignment}': expected key=value")
    *parents, last = path.split('.')
    at: Any = mapping
    for key in parents:
        if isinstance(at, list):
            at = at[int(key)] if key.isdigit() and int(key) < len(at) else None
        else:
            at = at.setdefault(key, {})
        if not isinstance(at, dict | list):
            raise ConfigurationError(f"--set '{assignment}': '{key}' holds no settings")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise ConfigurationError(f"--set '{assignment}': the value is no valid YAML") from None
    if isinstance(at, list):
        if not last.isdigit() or int(last) >= len(at):
            raise ConfigurationError(f"--set '{assignment}': the list has no item '{last}'")
        at[int(last)] = value
    else:
        at[last] = value


def read_scenario(path: Path | str, overrides: tuple[str, ...] = (), seed: int | None = None) -> Scenario:
    """Read a scenario file.

    Args:
        path: YAML file, or the name of one in config/.
        overrides: assignments as for `override`.
        seed: replaces the scenario's.

    Raises:
        ConfigurationError: no such file; as `scenario_from_mapping`.
    """
    path = find_config(str(path))
    mapping = read_yaml(path)
    for assignment in overrides:
        override(mapping, assignment)
    if seed is not None:
        mapping['seed'] = seed
    return scenario_from_mapping(mapping, str(path))
