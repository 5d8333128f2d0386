"""A calibration as a document: values, covariance, range, date, instrument, note, checksum. docs/calibration.md."""

import dataclasses
import datetime
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.rules.plausible import LIMITS
from drfmcw_physics.settings import ConfigurationError, from_mapping, parameter, parse_yaml, read_yaml

SCHEMA = 2
"""Version of the format that is written; older ones are read."""

_NOT_MEASURED = 'not measured'
_TRIANGLE = 10  # numbers in the upper triangle of a covariance (4, 4)
_FLAT = {  # where schema 1, which named values as StationCalibration does, stands in schema 2
    'alpha': ('reference_clock', 'value'),
    'sample_clock_alpha': ('sample_clock', 'value'),
    'temperature': ('temperature', 'reference'),
    'delay': ('delay', 'value'),
    'noise_floor': ('noise', 'floor'),
    'phase_noise_level': ('noise', 'phase_level'),
    'phase_noise_corner': ('noise', 'phase_corner'),
}


@dataclasses.dataclass(frozen=True)
class Clock:
    """A clock over nominal: value + linear d + quadratic d^2 + cubic d^3, d = board temperature - reference."""

    value: float = parameter(1.0, description='at the reference temperature')
    std: float = parameter(0.0, description='one standard deviation anywhere in the temperature range; 0: not stated')
    linear: float = parameter(0.0, unit='1/K', description='factor of d')
    quadratic: float = parameter(0.0, unit='1/K^2', description='factor of d^2')
    cubic: float = parameter(0.0, unit='1/K^3', description='factor of d^3')
    covariance: list[float] = parameter(
        [], description='of the four numbers: rows of the upper triangle, ten numbers; empty: not stated'
    )


@dataclasses.dataclass(frozen=True)
class Delay:
    """Hardware delay: value + slope d."""

    value: float = parameter(0.0, unit='s', description='at the reference temperature')
    std: float = parameter(0.0, unit='s', description='one standard deviation; with a peer that of both delays')
    slope: float = parameter(0.0, unit='s/K', description='factor of d')
    slope_std: float = parameter(0.0, unit='s/K', description='one standard deviation of the slope; 0: not stated')
    peer: str = parameter('', description='station together with which it was measured, the only one it holds for')


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of receiver and oscillator."""

    floor: float = parameter(math.nan, unit='dBm/Hz', nan_means=_NOT_MEASURED, description='at the antenna port')
    floor_std: float = parameter(0.0, unit='dB', description='one standard deviation; 0: not stated')
    phase_level: float = parameter(
        math.nan, unit='dBc/Hz', nan_means=_NOT_MEASURED, description='phase noise at 100 kHz, single side-band'
    )
    phase_level_std: float = parameter(0.0, unit='dB', description='one standard deviation; 0: not stated')
    phase_corner: float = parameter(
        math.nan, unit='Hz', nan_means=_NOT_MEASURED, description='corner of the one-pole shape'
    )
    phase_corner_std: float = parameter(0.0, unit='Hz', description='one standard deviation; 0: not stated')


@dataclasses.dataclass(frozen=True)
class Temperatures:
    """Board temperatures."""

    reference: float = parameter(25.0, unit='degC', description='at which values hold')
    low: float = parameter(0.0, unit='degC', description='coldest in the calibration')
    high: float = parameter(0.0, unit='degC', description='warmest; equal to `low`: range not stated')


@dataclasses.dataclass(frozen=True)
class StartDelay:
    """T_off between this station and a peer, for information: each range determines it anew."""

    nominal: float = parameter(math.nan, unit='s', nan_means=_NOT_MEASURED, description='as set')
    excess: float = parameter(math.nan, unit='s', nan_means=_NOT_MEASURED, description='measured minus nominal')
    std: float = parameter(0.0, unit='s', description='one standard deviation of the excess')
    jitter: float = parameter(0.0, unit='s', description='standard deviation from sweep to sweep')


@dataclasses.dataclass(frozen=True)
class IfResponse:
    """Gain of the receiver over the intermediate frequency, for information: the range does not use it."""

    frequency: list[float] = parameter([], unit='Hz', description='centres of bands')
    gain: list[float] = parameter([], unit='dB', description='in each band, relative to their median')
    std: list[float] = parameter([], unit='dB', description='one standard deviation of each')
    of: str = parameter(
        'noise',
        choices=('noise', 'line'),
        description='what was measured: noise, which passes what lies behind its source, or the line of a known path',
    )


_SECTIONS: dict[str, type] = {
    'temperature': Temperatures,
    'reference_clock': Clock,
    'sample_clock': Clock,
    'delay': Delay,
    'noise': Noise,
    'start_delay': StartDelay,
    'if_response': IfResponse,
}


@dataclasses.dataclass(frozen=True)
class Document:
    """One version of a station's calibration."""

    station: str = parameter(description='name of the station')
    version: int = parameter(0, bounds=(0, 2**32 - 1), description='counts up with each stored document; 0: not stored')
    date: str = parameter('', description='when it was stored, UTC')
    operator: str = parameter('', description='who stored it')
    instrument: str = parameter('', description='with what it was measured')
    note: str = parameter('', description='what the operator wants to be known')
    temperature: Temperatures = dataclasses.field(default_factory=Temperatures)
    reference_clock: Clock = dataclasses.field(default_factory=Clock)
    sample_clock: Clock = dataclasses.field(default_factory=Clock)
    delay: Delay = dataclasses.field(default_factory=Delay)
    noise: Noise = dataclasses.field(default_factory=Noise)
    start_delay: StartDelay = dataclasses.field(default_factory=StartDelay)
    if_response: IfResponse = dataclasses.field(default_factory=IfResponse)

    def calibration(self) -> Calibration:
        """Return the calibration that a station publishes."""
        clocks: dict[str, Any] = {}
        for name, clock in (('alpha', self.reference_clock), ('sample_clock', self.sample_clock)):
            clocks |= {f'{name}_{part}': getattr(clock, part) for part in ('linear', 'quadratic', 'cubic')}
        return Calibration(
            station=self.station,
            alpha=self.reference_clock.value,
            alpha_std=self.reference_clock.std,
            sample_clock_alpha=self.sample_clock.value,
            sample_clock_alpha_std=self.sample_clock.std,
            **clocks,
            temperature=self.temperature.reference,
            temperature_low=self.temperature.low,
            temperature_high=self.temperature.high,
            delay=self.delay.value,
            delay_std=self.delay.std,
            delay_slope=self.delay.slope,
            delay_peer=self.delay.peer,
            noise_floor=self.noise.floor,
            phase_noise_level=self.noise.phase_level,
            phase_noise_corner=self.noise.phase_corner,
            version=self.version,
        )

    def text(self) -> str:
        """Return the document as YAML, with its checksum."""
        content = _content(self)
        content['checksum'] = _checksum(content)
        return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=110)


def from_calibration(calibration: Calibration) -> Document:
    """Return the document of a calibration that a station publishes, to be changed and stored."""
    c = calibration
    return Document(
        station=c.station,
        version=c.version,
        temperature=Temperatures(c.temperature, c.temperature_low, c.temperature_high),
        reference_clock=Clock(c.alpha, c.alpha_std, c.alpha_linear, c.alpha_quadratic, c.alpha_cubic),
        sample_clock=Clock(
            c.sample_clock_alpha,
            c.sample_clock_alpha_std,
            c.sample_clock_linear,
            c.sample_clock_quadratic,
            c.sample_clock_cubic,
        ),
        delay=Delay(c.delay, c.delay_std, c.delay_slope, peer=c.delay_peer),
        noise=Noise(c.noise_floor, phase_level=c.phase_noise_level, phase_corner=c.phase_noise_corner),
    )


def read_document(path: Path | str) -> Document:
    """Return the document of a file.

    Raises:
        ConfigurationError: not readable, not of the format, checksum of another content, or implausible.
    """
    return from_content(read_yaml(path), str(path))


def parse_document(text: str, where: str) -> Document:
    """Return the document that a text holds; errors as `read_document`, with `where` instead of the file."""
    return from_content(parse_yaml(text, where), where)


def from_content(content: Mapping[str, Any], where: str) -> Document:
    """Return the document that a mapping read from YAML holds; older schemas are migrated.

    Raises:
        ConfigurationError: not of the format, checksum of another content, or implausible.
    """
    content = dict(content)
    checksum = content.pop('checksum', None)
    if checksum is not None and checksum != _checksum(content):
        raise ConfigurationError(
            f'{where}: the checksum does not match the content: damaged, or changed by hand (then delete the checksum)'
        )
    schema = content.pop('schema', None)
    if schema not in (1, SCHEMA):
        raise ConfigurationError(f"{where}: 'schema' must be 1 to {SCHEMA}, not {schema!r}")
    if schema == 1:
        content = _migrated(content, where)
    document: Document = from_mapping(Document, content, where)
    refusal = implausible(document)
    if refusal:
        raise ConfigurationError(f'{where}: {refusal}')
    return document


def implausible(document: Document) -> str:
    """Return why no station can have this calibration, '' where one can; bounds: drfmcw_physics.rules.plausible."""
    calibration = document.calibration()
    for field, limits in LIMITS['StationCalibration'].items():
        reason = limits.reason(field, getattr(calibration, field))
        if reason:
            return reason
    low, high = document.temperature.low, document.temperature.high
    if high < low:
        return f'temperature: low = {low:g} degC is above high = {high:g} degC'
    if calibration.depends_on_temperature and not high > low:
        return 'temperature: a curve over the temperature needs the range, low and high, in which it holds'
    if high > low and not low <= document.temperature.reference <= high:
        return f'temperature: reference = {document.temperature.reference:g} degC is outside {low:g} ... {high:g} degC'
    for name, at in (('alpha', calibration.alpha_at), ('sample_clock_alpha', calibration.sample_clock_at)):
        for temperature in np.linspace(low, high, 12):
            reason = LIMITS['StationCalibration'][name].reason(f'{name} at {temperature:g} degC', at(temperature))
            if reason:
                return reason
    for name, clock in (('reference_clock', document.reference_clock), ('sample_clock', document.sample_clock)):
        if len(clock.covariance) not in (0, _TRIANGLE):
            return f'{name}: covariance has {len(clock.covariance)} numbers, not {_TRIANGLE}'
        if clock.covariance and np.linalg.eigvalsh(matrix(clock.covariance))[0] < -1e-9 * max(clock.covariance):
            return f'{name}: covariance is not that of any four numbers: a negative variance'
    return ''


def matrix(triangle: list[float]) -> np.ndarray:
    """Return the symmetric matrix (4, 4) with this upper triangle; zeros for an empty one."""
    full = np.zeros((4, 4))
    if triangle:
        full[np.triu_indices(4)] = triangle
        full += np.triu(full, 1).T
    return full


def triangle(full: np.ndarray) -> list[float]:
    """Return the upper triangle of a symmetric matrix (4, 4), row by row."""
    return [float(value) for value in full[np.triu_indices(4)]]


def now() -> str:
    """Return the time as documents state it."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec='seconds')


def _content(document: Document) -> dict[str, Any]:
    """Return what is written: the sections that say something."""
    content: dict[str, Any] = {'schema': SCHEMA}
    for field in dataclasses.fields(document):
        value = getattr(document, field.name)
        if field.name not in _SECTIONS:
            content[field.name] = value
            continue
        given = {key: v for key, v in dataclasses.asdict(value).items() if not _is_default(field.name, key, v)}
        if given or field.name in ('temperature', 'reference_clock', 'sample_clock', 'delay'):
            required = {'temperature': 'reference'}.get(field.name, 'value')
            content[field.name] = ({required: getattr(value, required)} if hasattr(value, required) else {}) | given
    return content


def _is_default(section: str, key: str, value: Any) -> bool:
    default = getattr(_SECTIONS[section](), key)
    return value == default or (isinstance(value, float) and math.isnan(value))


def _checksum(content: Mapping[str, Any]) -> str:
    """Return the digest of a document without its checksum, whatever the order of its keys and the form of numbers."""
    return hashlib.sha256(json.dumps(_plain(content), sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value if isinstance(value, str | bool | int | float) or value is None else str(value)


def _migrated(content: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return a document of schema 1 as one of schema 2."""
    result: dict[str, Any] = {}
    for key, value in content.items():
        if key in _FLAT:
            section, name = _FLAT[key]
            result.setdefault(section, {})[name] = value
        elif key in ('station', 'version', 'date', 'operator', 'instrument', 'note'):
            result[key] = value
        else:
            raise ConfigurationError(f"{where}: unknown key '{key}' of schema 1")
    return result
