"""What a field of a message can plausibly hold: one table of limits with units, for live nodes and offline replay.

Comes in: the name of a message type and the message. Goes out: nothing, or the reason why it is refused, which names
field, value, unit and range. A value that is right in another unit is named as such. Free of ROS.
"""

import dataclasses
import math
from typing import Any

from ..constants import ZERO_CELSIUS
from ..windows import WINDOWS
from .schedule import LARGEST_PRIORITY, LARGEST_RATE

_LONGEST_NAME = 100  # of stations and frames
_LARGEST_STAMP = 253_402_300_800  # the year 9999 [s]


@dataclasses.dataclass(frozen=True)
class Limits:
    """Smallest and largest plausible value of one field."""

    low: float
    high: float
    unit: str = ''
    nan: bool = False  # NaN stands for an unknown value
    infinite: bool = False  # infinite values stand for 'no signal'
    other: tuple[tuple[str, float, float], ...] = ()  # (unit, factor, offset) with value * factor + offset in ours

    def reason(self, field: str, value: Any) -> str:
        """Return why `value` is not plausible, '' where it is."""
        number = float(value)
        if math.isnan(number):
            return '' if self.nan else f'{field} is NaN'
        if self.low <= number <= self.high or (self.infinite and math.isinf(number)):
            return ''
        unit = f' {self.unit}' if self.unit else ''
        text = f'{field} = {number:.10g}{unit} is outside {self.low:.10g} ... {self.high:.10g}{unit}'
        for name, factor, offset in self.other:
            if self.low <= number * factor + offset <= self.high:
                return f'{text} (looks like {name})'
        return text


_SECONDS = {'milliseconds': 1e-3, 'microseconds': 1e-6, 'nanoseconds': 1e-9}
_TIME = tuple((name, factor, 0.0) for name, factor in _SECONDS.items())
_FREQUENCY = (('GHz', 1e9, 0.0), ('MHz', 1e6, 0.0), ('kHz', 1e3, 0.0))
_BOARD = Limits(-100.0, 150.0, 'degC', nan=True, other=(('K', 1.0, -ZERO_CELSIUS),))
_CLOCKS = ('alpha', 'sample_clock')
_CLOCK_STD = Limits(0.0, 1e-4, nan=True, other=(('ppm', 1e-6, 0.0),))
_CLOCK = Limits(1.0 - 5e-4, 1.0 + 5e-4, other=(('ppm of deviation', 1e-6, 1.0),))

LIMITS: dict[str, dict[str, Limits]] = {
    'Temperature': {'temperature': Limits(-90.0, 70.0, 'degC', nan=True, other=(('K', 1.0, -ZERO_CELSIUS),))},
    'FluidPressure': {
        'fluid_pressure': Limits(5e4, 1.1e5, 'Pa', nan=True, other=(('hPa', 1e2, 0.0), ('kPa', 1e3, 0.0)))
    },
    'RelativeHumidity': {'relative_humidity': Limits(0.0, 1.0, nan=True, other=(('%', 1e-2, 0.0),))},
    'ReferenceRange': {
        'range': Limits(-1e3, 1e7, 'm', nan=True),
        'range_std': Limits(0.0, 1e6, 'm', nan=True),
    },
    'StationStatus': {'temperature': _BOARD, 'link_quality': Limits(0.0, 1.0, nan=True, other=(('%', 1e-2, 0.0),))},
    'StationCalibration': {
        'alpha': _CLOCK,
        'sample_clock_alpha': _CLOCK,
        'temperature': dataclasses.replace(_BOARD, nan=False),
        'delay': Limits(-1e-6, 1e-4, 's', other=_TIME),
        'noise_floor': Limits(-180.0, -60.0, 'dBm/Hz', nan=True),
        'phase_noise_level': Limits(-180.0, -20.0, 'dBc/Hz', nan=True),
        'phase_noise_corner': Limits(1.0, 1e9, 'Hz', nan=True),
        'alpha_std': _CLOCK_STD,
        'sample_clock_alpha_std': _CLOCK_STD,
        'delay_std': Limits(0.0, 1e-6, 's', nan=True, other=_TIME),
        **{f'{clock}_linear': Limits(-5e-6, 5e-6, '1/K', nan=True) for clock in _CLOCKS},
        **{f'{clock}_quadratic': Limits(-1e-7, 1e-7, '1/K^2', nan=True) for clock in _CLOCKS},
        **{f'{clock}_cubic': Limits(-1e-9, 1e-9, '1/K^3', nan=True) for clock in _CLOCKS},
        'delay_slope': Limits(-1e-9, 1e-9, 's/K', nan=True, other=_TIME),
        'temperature_low': _BOARD,
        'temperature_high': _BOARD,
    },
    'SweepConfig': {
        'role': Limits(1, 2),
        'mode': Limits(0, 1),
        'start_frequency': Limits(1e6, 1e12, 'Hz', other=_FREQUENCY),
        'bandwidth': Limits(-1e11, 1e11, 'Hz'),
        'ramp_duration': Limits(1e-6, 100.0, 's', other=_TIME),
        'start_delay': Limits(0.0, 1.0, 's', other=_TIME),
        'sample_rate': Limits(1e2, 1e10, 'Hz'),
        'sample_count': Limits(16, 1 << 24),
        'tx_eirp': Limits(-200.0, 100.0, 'dBm', nan=True),
        'rx_antenna_gain': Limits(-100.0, 100.0, 'dBi', nan=True),
        'full_scale_power': Limits(-200.0, 100.0, 'dBm', nan=True),
    },
    'SweepSchedule': {
        'rate': Limits(0.0, LARGEST_RATE, 'Hz'),
        'priority': Limits(-LARGEST_PRIORITY, LARGEST_PRIORITY),
    },
    'BeatFrequency': {
        'frequency': Limits(0.0, 1e10, 'Hz', nan=True),
        'frequency_std': Limits(0.0, 1e10, 'Hz', nan=True, infinite=True),
        'independent_std': Limits(0.0, 1e10, 'Hz', nan=True, infinite=True),
        'phase': Limits(-7.0, 7.0, 'rad', nan=True),
        'power': Limits(-400.0, 100.0, 'dBm', nan=True, infinite=True),
        'snr': Limits(-400.0, 400.0, 'dB', nan=True, infinite=True),
    },
    'IfSamples': {'full_scale': Limits(1.0, 32768.0, 'LSB')},
    'CompressedIfSamples': {'full_scale': Limits(1.0, 32768.0, 'LSB'), 'sample_count': Limits(1, 1 << 25)},
}
"""Limits of every number that live nodes and the replay take from a message, by message type and field."""


def refusal(kind: str, message: Any) -> str:
    """Return why a message is not plausible, '' where it is.

    Args:
        kind: name of its type without package, e.g. 'SweepConfig'.
        message: of rclpy or of a recording; anything with the fields of `LIMITS` and a header.
    """
    for field, limits in LIMITS.get(kind, {}).items():
        reason = limits.reason(field, getattr(message, field))
        if reason:
            return reason
    for field in ('station', 'peer'):
        name = getattr(message, field, 'x')
        if not name or len(name) > _LONGEST_NAME or not name.isprintable():
            return f'{field} = {printable(name)} is no name of a station'
    if len(message.header.frame_id) > _LONGEST_NAME or not message.header.frame_id.isprintable():
        return f'frame_id = {printable(message.header.frame_id)} is no name of a frame'
    stamp = message.header.stamp
    if not (0 <= stamp.sec < _LARGEST_STAMP and 0 <= stamp.nanosec < 1_000_000_000):
        return f'stamp = {stamp.sec} s and {stamp.nanosec} ns is no time'
    return _JOINT[kind](message) if kind in _JOINT else ''


def printable(text: str, longest: int = 40) -> str:
    """Return text from outside in quotes, on one line and short enough for a message."""
    return repr(text if len(text) <= longest else text[:longest] + '...')


def printable_line(text: str, longest: int = 200) -> str:
    """Return text that names from outside are part of, on one line of printable letters, short enough for a key."""
    line = ''.join(c if c.isprintable() else '?' for c in text)
    return line if len(line) <= longest else line[: longest - 3] + '...'


def _sweep_config(message: Any) -> str:
    if abs(message.bandwidth) < 1e3:
        return f'bandwidth = {message.bandwidth:g} Hz is no sweep'
    lowest = min(message.start_frequency, message.start_frequency + message.bandwidth)
    if lowest <= 0.0:
        return f'bandwidth = {message.bandwidth:g} Hz leads below 0 Hz'
    if message.start_delay >= message.ramp_duration:
        return f'start_delay = {message.start_delay:g} s is not shorter than the ramp of {message.ramp_duration:g} s'
    record = message.sample_count / message.sample_rate
    if not message.ramp_duration / 16.0 <= record <= 16.0 * message.ramp_duration:
        return (
            f'sample_count = {message.sample_count} at {message.sample_rate:g} Hz takes {record:g} s, '
            f'but the ramp {message.ramp_duration:g} s'
        )
    return ''


def _calibration(message: Any) -> str:
    if message.temperature_high < message.temperature_low:
        return (
            f'temperature_low = {message.temperature_low:g} degC is above '
            f'temperature_high = {message.temperature_high:g} degC'
        )
    if len(message.delay_peer) > _LONGEST_NAME or not message.delay_peer.isprintable():
        return f'delay_peer = {printable(message.delay_peer)} is no name of a station'
    return ''


def _beat(message: Any) -> str:
    if message.window and message.window not in WINDOWS:  # '' is unknown
        return f'window = {printable(message.window)} is none of {", ".join(WINDOWS)}'
    if not math.isfinite(message.frequency):
        return ''
    if not (math.isfinite(message.frequency_std) and message.frequency_std > 0.0):
        return f'frequency_std = {message.frequency_std:g} Hz of a finite frequency'
    if message.independent_std > message.frequency_std * (1.0 + 1e-9):
        return f'independent_std = {message.independent_std:g} Hz exceeds frequency_std = {message.frequency_std:g} Hz'
    return ''


_JOINT = {'StationCalibration': _calibration, 'SweepConfig': _sweep_config, 'BeatFrequency': _beat}
