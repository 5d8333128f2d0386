"""A frequency counter that speaks SCPI, over TCP or any other VISA resource."""

import math
import re
from typing import Any

import numpy as np
import pyvisa
from pyvisa.errors import VisaIOError

from drfmcw_physics.rules.plausible import printable_line
from drfmcw_physics.settings import ConfigurationError

from .readings import Reading

_TIMEOUT = 20.0  # of one answer: a counter may gate for ten seconds [s]
_SOCKET = re.compile(r'(?P<host>[\w.-]+):(?P<port>\d{1,5})', re.ASCII)
COMMAND = 'MEAS:FREQ? DEF,DEF,(@{channel})'
"""Query of one frequency [Hz], as Keysight 53220A and 53230A take it; {channel} is replaced."""


class Counter:
    """One counter, open from `with` to its end."""

    def __init__(self, address: str, command: str = COMMAND, timeout: float = _TIMEOUT) -> None:
        """Choose the instrument.

        Args:
            address: HOST:PORT of a raw socket, or a VISA resource name, as TCPIP::192.168.1.7::INSTR.
            command: query of a frequency, with {channel} for the input's number.
            timeout: of one answer [s].

        Raises:
            ConfigurationError: a command that is no query.
        """
        socket = _SOCKET.fullmatch(address)
        self.address = f'TCPIP0::{socket["host"]}::{socket["port"]}::SOCKET' if socket else address
        if '?' not in command:
            raise ConfigurationError(f"--scpi '{command}': a query contains a question mark")
        self._command, self._timeout = command, timeout
        self.name = ''
        """What the instrument says of itself."""

    def __enter__(self) -> 'Counter':
        """Open the instrument and ask for its name."""
        try:
            self._manager = pyvisa.ResourceManager('@py')
            self._instrument: Any = self._manager.open_resource(
                self.address, read_termination='\n', write_termination='\n', timeout=1e3 * self._timeout
            )
        except (VisaIOError, OSError, ValueError) as error:
            raise ConfigurationError(f'counter {self.address}: {_reason(error)}') from None
        try:
            self.name = printable_line(self._ask('*IDN?').strip())
        except ConfigurationError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        """Close the instrument."""
        self._instrument.close()
        self._manager.close()

    def frequencies(self, channel: int, count: int) -> np.ndarray:
        """Return `count` readings of an input, (count,) [Hz].

        Raises:
            ConfigurationError: no answer in time, or one that is no frequency.
        """
        values = []
        for _ in range(count):
            answer = self._ask(self._command.format(channel=channel))
            try:
                value = float(answer)
            except ValueError:
                value = math.nan
            if not 0.0 < value < 1e12:  # SCPI counts 9.91e37 as not a number
                said = f"input {channel} answers '{printable_line(answer)}'"
                raise ConfigurationError(f'counter {self.address}: {said}, which is no frequency')
            values.append(value)
        return np.array(values)

    def _ask(self, query: str) -> str:
        try:
            return str(self._instrument.query(query))
        except (VisaIOError, OSError, UnicodeDecodeError) as error:
            raise ConfigurationError(f"counter {self.address}: no answer to '{query}': {_reason(error)}") from None


def read_counter(counter: Counter, channels: dict[str, int], count: int, temperature: float) -> list[Reading]:
    """Return one reading of each clock: the mean of `count`, with the standard deviation of the mean where it is known.

    Args:
        counter: open.
        channels: input of each clock, by its name.
        count: readings to average.
        temperature: of the board [degC].
    """
    readings = []
    for clock, channel in channels.items():
        values = counter.frequencies(channel, count)
        std = float(np.std(values, ddof=1) / math.sqrt(count)) if count > 1 else math.nan
        readings.append(Reading(clock, float(np.mean(values)), temperature, std if std > 0.0 else math.nan))
    return readings


def _reason(error: Exception) -> str:
    return ' '.join(str(getattr(error, 'description', None) or getattr(error, 'strerror', None) or error).split())
