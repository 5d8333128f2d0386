"""What the settings file of an import says; a file that states some of it itself fills what is left out."""

import dataclasses
import datetime
import math
from collections.abc import Mapping
from typing import Any

from drfmcw_physics.settings import ConfigurationError, nearest, parameter
from drfmcw_physics.sweep import SweepSettings

AXES = ('frame', 'chirp', 'transmitter', 'ramp', 'receiver', 'sample', 'iq')
"""Names of axes, in the order into which the file's are brought."""

EPOCH = '2000-01-01T00:00:00'
"""Start of a recording whose time is not known."""


@dataclasses.dataclass(frozen=True)
class RadarSettings:
    """What the radar did."""

    start_frequency: float = parameter(unit='Hz', bounds=(1e6, 1e12), description='at which the (first) ramp starts')
    ramp_duration: float = parameter(unit='s', bounds=(1e-6, 100.0), description='of one ramp')
    sample_rate: float = parameter(unit='Hz', bounds=(1e2, 1e10), description='of the ADC')
    bandwidth: float = parameter(
        math.nan, unit='Hz', bounds=(1.0, 1e11), nan_means='from `rate`', description='covered by one ramp, positive'
    )
    rate: float = parameter(
        math.nan, unit='Hz/s', bounds=(1.0, 1e17), nan_means='from `bandwidth`', description='of the ramp, positive'
    )
    ramp: str = parameter(
        'up', choices=('up', 'down', 'triangle'), description='triangle: up, then down, as two stations of a recording'
    )
    down_duration: float = parameter(
        math.nan,
        unit='s',
        bounds=(1e-6, 100.0),
        nan_means='as `ramp_duration`',
        description="of a triangle's second ramp",
    )
    first_sample: float = parameter(
        0.0, unit='s', bounds=(0.0, 100.0), description='instant of the first sample after the start of its ramp'
    )
    repetition_time: float = parameter(
        math.nan,
        unit='s',
        bounds=(1e-6, 1e5),
        nan_means='one ramp after the other',
        description='between the starts of successive chirps (of one transmitter)',
    )
    frame_time: float = parameter(
        math.nan,
        unit='s',
        bounds=(1e-6, 1e6),
        nan_means='one frame after the other',
        description='between the starts of successive frames',
    )
    start_time: str = parameter('', description='of the first sweep, UTC, as 2024-05-31T12:00:00; empty: not known')
    delay: float = parameter(
        0.0, unit='s', bounds=(-1e-3, 1e-3), description="calibrated delay of the radar's own path"
    )
    station: str = parameter('radar', description='name of the station in the recording')
    up_station: str = parameter('up', description="name of the station of a triangle's rising ramps")
    down_station: str = parameter('down', description="name of the station of a triangle's falling ramps")

    def __post_init__(self) -> None:
        """Refuse what is stated twice or not at all."""
        if math.isnan(self.bandwidth) == math.isnan(self.rate):
            given = 'neither is' if math.isnan(self.rate) else 'both are'
            raise ConfigurationError(f'radar: one of bandwidth and rate is needed, {given} given')
        if self.first_sample >= self.ramp_duration:
            raise ConfigurationError(
                f'radar: first_sample = {self.first_sample:g} s is not within ramp_duration = {self.ramp_duration:g} s'
            )
        self.start  # noqa: B018 - an unreadable time is refused now

    @property
    def start(self) -> int:
        """Stamp of the first sweep [ns]."""
        try:
            when = datetime.datetime.fromisoformat((self.start_time or EPOCH).replace('Z', '+00:00'))
        except ValueError:
            raise ConfigurationError(f"radar: start_time '{self.start_time}' is no time like {EPOCH}") from None
        when = when if when.tzinfo else when.replace(tzinfo=datetime.UTC)
        whole = when.replace(microsecond=0)
        return int(whole.timestamp()) * 1_000_000_000 + when.microsecond * 1000

    def sweeps(self, sample_count: int) -> list[SweepSettings]:
        """Return the settings of each ramp as a recording holds them, sample 0 at the start.

        What the ramp covers before its first sample is left out of bandwidth and duration.
        """
        sign = -1.0 if self.ramp == 'down' else 1.0
        width = self.bandwidth if math.isnan(self.rate) else self.rate * self.ramp_duration
        ramps = [(self.station, self.start_frequency, sign * width, self.ramp_duration)]
        if self.ramp == 'triangle':
            down = self.ramp_duration if math.isnan(self.down_duration) else self.down_duration
            ramps = [
                (self.up_station, self.start_frequency, width, self.ramp_duration),
                (self.down_station, self.start_frequency + width, -width, down),
            ]
        return [
            SweepSettings(
                station=name,
                peer=name,
                mode=1,
                start_frequency=start + change / duration * self.first_sample,
                bandwidth=change / duration * (duration - self.first_sample),
                ramp_duration=duration - self.first_sample,
                start_delay=0.0,
                sample_rate=self.sample_rate,
                sample_count=sample_count,
                tx_eirp=math.nan,
                rx_antenna_gain=math.nan,
                full_scale_power=math.nan,
                stamp=self.start,
                frame_id=name,
            )
            for name, start, change, duration in ramps
        ]

    def period(self) -> float:
        """Return the time between successive chirps [s]."""
        if math.isfinite(self.repetition_time):
            return self.repetition_time
        second = self.ramp_duration if math.isnan(self.down_duration) else self.down_duration
        return self.ramp_duration + (second if self.ramp == 'triangle' else 0.0)


@dataclasses.dataclass(frozen=True)
class LayoutSettings:
    """How the samples lie in the file."""

    axes: list[str] = parameter(
        [],
        choices=AXES,
        description='what each axis counts, the slowest first; one that is split stands twice; empty: `[sample]`, '
        '`[chirp, sample]`',
    )
    shape: list[int] = parameter(
        [], bounds=(-1, 1e12), description='sizes of the axes where the file has not as many; -1 once: what is left'
    )
    receiver: int = parameter(0, bounds=(0, 1023), description='receiver to take, counted from 0')
    average: bool = parameter(False, description='average all receivers instead (rounded to whole codes)')
    transmitter: int = parameter(0, bounds=(0, 1023), description='transmitter to take, counted from 0')
    skip_samples: int = parameter(
        0,
        bounds=(0, 1e9),
        description='samples to leave out at the beginning of each sweep; the ramp starts later then',
    )
    sample_count: int = parameter(0, bounds=(0, 1 << 24), description='samples to keep of each sweep; 0: all')
    swap_iq: bool = parameter(False, description='Q stands before I')
    drop_incomplete: bool = parameter(False, description='leave out an incomplete sweep at the end of a file')

    def __post_init__(self) -> None:
        """Refuse axes that cannot be."""
        if self.axes and 'sample' not in self.axes:
            raise ConfigurationError(f'layout: axes = {self.axes} has no axis sample')
        if self.axes.count('iq') > 1:
            raise ConfigurationError(f'layout: axes = {self.axes} has the axis iq twice')
        if self.shape and len(self.shape) != len(self.axes):
            raise ConfigurationError(f'layout: shape has {len(self.shape)} sizes for {len(self.axes)} axes')
        if self.shape.count(-1) > 1 or 0 in self.shape:
            raise ConfigurationError(f'layout: shape = {self.shape}: -1 at most once, no 0')


@dataclasses.dataclass(frozen=True)
class SampleSettings:
    """How the ADC's codes are written."""

    bits: int = parameter(0, bounds=(0, 32), description="of the ADC; 0: those of the file's integers, 16 for floats")
    coding: str = parameter(
        'auto',
        choices=('auto', 'signed', 'offset_binary', 'wrapped'),
        description='offset_binary: mid-scale is 2^(bits - 1); wrapped: negative codes have 2^bits added; auto: signed '
        'for signed integers and floats, offset_binary for unsigned ones',
    )
    span: float = parameter(
        math.nan,
        bounds=(1e-12, 1e12),
        nan_means='they are codes',
        description='difference of two numbers in the file that is `span_codes` codes: of volts, or of 0..1',
    )
    span_codes: float = parameter(
        math.nan, bounds=(1e-12, 1e12), nan_means='2^bits', description='codes that `span` covers'
    )


@dataclasses.dataclass(frozen=True)
class ImportSettings:
    """A settings file."""

    radar: RadarSettings
    layout: LayoutSettings = LayoutSettings()
    samples: SampleSettings = SampleSettings()
    format: str = parameter('', description="name of the file's format; empty: what the file's name says")
    description: str = parameter('', description='of the measurement, for the reader')
    options: dict[str, Any] = parameter({}, description='options of the format')


def filled(given: Mapping[str, Any], stated: Mapping[str, Mapping[str, Any]]) -> tuple[dict[str, Any], list[str]]:
    """Return a settings file's mapping with what the files state where it says nothing, and what was filled in.

    Args:
        given: as read from the settings file.
        stated: {section: {key: value}} of the files.

    Raises:
        ConfigurationError: a section is no mapping, or is not known.
    """
    known = [f.name for f in dataclasses.fields(ImportSettings)]
    for key in given:
        if key not in known:
            raise ConfigurationError(f"unknown key '{key}'{nearest(key, known)}")
    result, notes = dict(given), []
    for section, values in stated.items():
        own = dict(_mapping(result.get(section), section))
        for key, value in values.items():
            if key in own or (section == 'radar' and {key, *own} >= {'bandwidth', 'rate'}):
                continue
            own[key] = value
            notes.append(f'{key} = {_shown(value)}')
        result[section] = own
    return result, notes


def _mapping(section: Any, name: str) -> Mapping[str, Any]:
    if section is None:
        return {}
    if not isinstance(section, Mapping):
        raise ConfigurationError(f'{name}: expected a mapping of settings, not {section!r}')
    return section


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f'[{", ".join(map(_shown, value))}]'
    return f'{value:.10g}' if isinstance(value, float) else str(value)
