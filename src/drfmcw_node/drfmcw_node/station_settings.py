"""What can be set of a station node besides the estimation."""

import dataclasses
import math
import re

from drfmcw_physics.settings import ConfigurationError, parameter

from .compression import CODECS
from .estimators.estimation import EstimatorSettings
from .sources.source import Source

SWEEP_TOPICS = ('topic', 'compressed')
"""How sweeps come from topics: if_samples or if_samples_compressed."""

SOURCES = (*SWEEP_TOPICS, *Source.registry)
"""Where sweeps come from; with a registered source the node stands for the hardware and publishes its settings too."""


@dataclasses.dataclass(frozen=True)
class StationSettings:
    """Settings of a station node."""

    station: str = parameter('', structural=True, description='name of the station; empty: last name of the namespace')
    frame_id: str = parameter('', description="frame of the antenna; empty: the sweep's, or <station>_antenna")
    source: str = parameter('topic', choices=SOURCES, structural=True, description='where sweeps come from')
    peer: str = parameter(
        '', structural=True, description='peers, separated by commas, of a digitiser (sources tcp and udp)'
    )
    time_offset: float = parameter(
        0.0, unit='s', bounds=(-10.0, 10.0), description='added to the stamps of the sweeps (latency correction)'
    )
    output: str = parameter(
        'results',
        choices=('results', 'compressed', 'both'),
        description='results only, or raw sweeps compressed for the radio link, or both',
    )
    state_directory: str = parameter(
        '',
        structural=True,
        description='where calibrations are stored; empty: $STATE_DIRECTORY, else $XDG_STATE_HOME/drfmcw',
    )
    codec: str = parameter('flac', choices=CODECS, description='lossless compression of the raw sweeps')

    @property
    def peers(self) -> tuple[str, ...]:
        """Names of the peers."""
        return _names(self.peer)

    @property
    def owns_sweep(self) -> bool:
        """True where no other process publishes the station's settings, calibration and status."""
        return self.source in Source.registry

    @property
    def has_feed(self) -> bool:
        """True where a digitiser feeds the node, which then holds the settings of the sweep."""
        return self.owns_sweep and not Source.registry[self.source].brings_settings

    def antenna_frame(self, station: str, given: str) -> str:
        """Return the frame of the antenna of `station`: as set, else as `given` with the sweep, else the default."""
        return self.frame_id or given or antenna_frame(station)


@dataclasses.dataclass(frozen=True)
class StationNames:
    """A station's names in the graph."""

    station: str
    prefix: str  # before its own topics' last names
    siblings: str  # before the names of its peers

    @classmethod
    def of(cls, station: str, namespace: str) -> 'StationNames':
        """Return the names of a station whose node lives in `namespace`, which ends in the station's name or not."""
        parent, _, last = namespace.rpartition('/')
        if last != station:
            return cls(station, f'{station}/', f'/{namespace}/' if namespace else '/')
        return cls(station, '', f'/{parent}/' if parent else '/')

    def own(self, topic: str) -> str:
        """Return the name of one of the station's own topics."""
        return self.prefix + topic

    def of_peer(self, peer: str, topic: str) -> str:
        """Return the name of a peer's topic."""
        return f'{self.siblings}{peer}/{topic}'


@dataclasses.dataclass(frozen=True)
class PairStationSettings:
    """Settings of a node that evaluates both stations of a pair."""

    first: str = parameter('', structural=True, description='name of the one station')
    second: str = parameter(
        '', structural=True, description='name of the other; several, separated by commas, where they take turns'
    )
    first_source: str = parameter(
        'topic', choices=SWEEP_TOPICS, structural=True, description='how the sweeps of `first` come'
    )
    second_source: str = parameter(
        'compressed', choices=SWEEP_TOPICS, structural=True, description='how the sweeps of `second` come'
    )

    @property
    def seconds(self) -> tuple[str, ...]:
        """Names of the other stations."""
        return _names(self.second)


@dataclasses.dataclass(frozen=True)
class SpectrumSettings:
    """Which spectra are published."""

    spectrum: bool = parameter(True, description='publish magnitude spectra')
    spectrum_decimation: int = parameter(
        1, bounds=(1, 1_000_000), description='publish the spectra of sweeps whose number is a multiple of this'
    )


@dataclasses.dataclass(frozen=True)
class PairEstimatorSettings(EstimatorSettings):
    """Settings of the estimation where both stations' sweeps are at hand."""

    estimator: str = parameter('pair', choices=('pair',), structural=True, description='both stations together')


@dataclasses.dataclass(frozen=True)
class Housekeeping:
    """A station's status; the fields of StationStatus."""

    station: str
    sweeps: int
    dropped: int
    link_quality: float
    temperature: float = math.nan
    pll_locked: bool = True
    stamp: int = 0
    frame_id: str = ''


def check_complete(settings: StationSettings) -> None:
    """Raise ConfigurationError where the station has no valid name, or a digitiser's source has no peer."""
    if not settings.station:
        raise ConfigurationError('station: give the name of the station (parameter station, or a namespace)')
    _check_name('station', settings.station)
    if settings.has_feed and not settings.peers:
        raise ConfigurationError(f'peer: source {settings.source} needs the name of at least one peer')


def check_pair(settings: PairStationSettings) -> None:
    """Raise ConfigurationError unless the names are those of two different stations or more."""
    for parameter_name, names in (('first', (settings.first,)), ('second', settings.seconds or ('',))):
        for name in names:
            if not name:
                raise ConfigurationError(
                    f'{parameter_name}: give the name of the station (parameters first and second)'
                )
            _check_name(parameter_name, name)
    if settings.first in settings.seconds:
        raise ConfigurationError(f"second: a pair needs two stations, both are '{settings.first}'")


def antenna_frame(station: str) -> str:
    """Return the default frame of a station's antenna."""
    return f'{station}_antenna'


def is_station_name(name: str) -> bool:
    """Return True for a name that can be part of a topic's name."""
    return re.fullmatch(r'[A-Za-z_][A-Za-z0-9_]*', name) is not None


def _check_name(parameter_name: str, name: str) -> None:
    if not is_station_name(name):
        raise ConfigurationError(
            f"{parameter_name}: '{name}' cannot be part of a topic's name: letters, digits and _, no digit first"
        )


def _names(listed: str) -> tuple[str, ...]:
    """Return the names in a list separated by commas, each once."""
    return tuple(dict.fromkeys(name.strip() for name in listed.split(',') if name.strip()))
