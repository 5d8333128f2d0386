"""From the numbers of a file to codes of the ADC."""

import dataclasses
import math
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from ..formats.base import Numbers
from .settings import SampleSettings

_STORED = 16  # bits of a recording's samples


@dataclasses.dataclass
class Coder:
    """Turns numbers into codes of a bipolar ADC, -2^(bits - 1) ... 2^(bits - 1) - 1, and notes how well they fit."""

    bits: int
    coding: str
    factor: float  # codes per number of the file
    integer: bool  # the file's numbers are whole and codes already
    roundings: float = 0.0  # largest distance of a number from a whole code [LSB]

    @property
    def shift(self) -> int:
        """Lowest bits that a recording has no room for."""
        return max(0, self.bits - _STORED)

    @property
    def full_scale(self) -> float:
        """Full scale of the codes [LSB]."""
        return float(2 ** (self.bits - self.shift - 1))

    def codes(self, numbers: Numbers, name: str) -> Numbers:
        """Return int16 codes.

        Args:
            numbers: of the file, any shape.
            name: of the file, for messages.

        Raises:
            ConfigurationError: a number is not finite or beyond the ADC's range.
        """
        if self.integer:
            codes = numbers.astype(np.int64)
        else:
            scaled = np.asarray(numbers, np.float64) * self.factor
            if not np.isfinite(scaled).all():
                raise ConfigurationError(f'{name}: {int(np.sum(~np.isfinite(scaled)))} numbers are not finite')
            rounded = np.rint(scaled)
            self.roundings = max(self.roundings, float(np.abs(scaled - rounded).max(initial=0.0)))
            codes = rounded.astype(np.int64)
        half = 1 << (self.bits - 1)
        low, high = int(codes.min(initial=0)), int(codes.max(initial=0))
        if self.coding == 'offset_binary':
            self._require(low >= 0 and high < 2 * half, low, high, 0, 2 * half - 1, name)
            codes -= half
        elif self.coding == 'wrapped':
            self._require(low >= -half and high < 2 * half, low, high, -half, 2 * half - 1, name)
            codes = (codes + half) % (2 * half) - half
        else:
            self._require(low >= -half and high < half, low, high, -half, half - 1, name)
        return (codes >> self.shift).astype(np.int16)

    def _require(self, fits: bool, low: int, high: int, first: int, last: int, name: str) -> None:
        if fits:
            return
        needed = max(abs(low), abs(high) + 1).bit_length()
        if self.coding == 'signed':
            advice = f'set bits: {needed + 1}, or coding: offset_binary or wrapped, or span and span_codes'
        else:
            advice = 'set coding: signed' if low < 0 else f'set bits: {needed}'
        raise ConfigurationError(
            f'{name}: numbers from {low} to {high} are beyond the codes {first} ... {last} of samples: bits = '
            f'{self.bits}, coding = {self.coding}: {advice}'
        )


def coder(settings: SampleSettings, dtype: Any) -> Coder:
    """Return what turns numbers of a type into codes.

    Args:
        settings: of the samples.
        dtype: of the file's numbers; of a structure, its first field's.
    """
    dtype = np.dtype(dtype)
    if dtype.names is not None:
        dtype = dtype[0]
    whole = dtype.kind in 'iub'
    bits = settings.bits or (8 * dtype.itemsize if whole else _STORED)
    coding = settings.coding
    if coding == 'auto':
        coding = 'offset_binary' if dtype.kind == 'u' else 'signed'
    span_codes = 2.0**bits if math.isnan(settings.span_codes) else settings.span_codes
    scaled = math.isfinite(settings.span)
    return Coder(bits, coding, span_codes / settings.span if scaled else 1.0, whole and not scaled)
