"""From the numbers of a file to codes of the ADC."""

import dataclasses
import math
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError

from ..formats.base import Numbers
from .settings import SampleSettings

_STORED = 16  # bits of a recording's samples
ACROSS, LARGE = 1.8, 1.4  # full scales of a step across the whole range, and of one that may be one
_RAIL = 16  # codes at either end that a limiter's rail takes
_SMOOTHER = 0.5  # times the bends that codes half a range off have where that is their right reading
_UNSIGNED = {'int8': 'uint8', 'int16': 'uint16', 'int32': 'uint32'}


@dataclasses.dataclass
class Coder:
    """Turns numbers into codes of a bipolar ADC, -2^(bits - 1) ... 2^(bits - 1) - 1, and notes how well they fit."""

    bits: int
    coding: str
    factor: float  # codes per number of the file
    integer: bool  # the file's numbers are whole and codes already
    stored: str  # type of the file's numbers
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
            self._require(low >= 0 and high < 2 * half, codes, 0, 2 * half - 1, name)
            codes -= half
        elif self.coding == 'wrapped':
            self._require(low >= -half and high < 2 * half, codes, -half, 2 * half - 1, name)
            codes = (codes + half) % (2 * half) - half
        else:
            self._require(low >= -half and high < half, codes, -half, half - 1, name)
        return (codes >> self.shift).astype(np.int16)

    @property
    def other_coding(self) -> str:
        """What to set where codes are half the range off."""
        if self.coding == 'offset_binary':
            return 'negative codes have 2^bits added: set samples: coding: wrapped'
        if self.stored in _UNSIGNED:
            return f'unsigned codes are read as signed: {self._unsigned}'
        return 'mid-scale is 2^(bits - 1): set samples: coding: offset_binary'

    @property
    def _unsigned(self) -> str:
        kind = _UNSIGNED[self.stored]
        return f'set options: type: {kind} (of a raw file; convert another one), and coding: offset_binary'

    def _wraps(self, numbers: Numbers) -> bool:
        """Return whether signed numbers (..., samples, iq) jump across the range where unsigned ones do not."""
        half = float(1 << (8 * np.dtype(self.stored).itemsize - 1))
        return are_half_a_range_off(numbers, half)

    def _require(self, fits: bool, codes: Numbers, first: int, last: int, name: str) -> None:
        low, high = int(codes.min(initial=0)), int(codes.max(initial=0))
        if fits:
            return
        needed = max(abs(low), abs(high) + 1).bit_length()
        if self.coding == 'signed':
            advice = f'set bits: {needed + 1}, or coding: offset_binary or wrapped, or span and span_codes'
        elif low >= 0:
            advice = f'set bits: {needed}'
        elif self.stored in _UNSIGNED and self._wraps(codes):
            advice = self._unsigned
        else:
            advice = 'set coding: signed'
        raise ConfigurationError(
            f'{name}: numbers from {low} to {high} are beyond the codes {first} ... {last} of samples: bits = '
            f'{self.bits}, coding = {self.coding}: {advice}'
        )


def jumps(codes: Numbers, full_scale: float, least: float = ACROSS) -> float:
    """Return the share of the steps along the samples of codes (..., samples, iq) of `least` full scales and more.

    A limiter makes such steps as well: 0 where most of them lead from one rail, a few codes wide, to the other one.
    """
    if codes.shape[-2] < 2:
        return 0.0
    codes = codes.astype(np.int64)
    low, high = int(codes.min()), int(codes.max())
    inside = (codes > low + _RAIL) & (codes < high - _RAIL)
    across = np.abs(np.diff(codes, axis=-2)) > least * full_scale
    other = across & (inside[..., 1:, :] | inside[..., :-1, :])
    return float(np.mean(across)) if 2 * other.sum() > across.sum() else 0.0


def are_half_a_range_off(codes: Numbers, full_scale: float) -> bool:
    """Return whether codes (..., samples, iq) go on smoothly with their highest bit inverted, where they jump as is."""
    other = half_a_range_off(codes, full_scale)
    bends, others = (float(np.mean(np.abs(np.diff(c.astype(float), 2, axis=-2)))) for c in (codes, other))
    return jumps(other, full_scale, LARGE) < 0.1 * jumps(codes, full_scale, LARGE) and others < _SMOOTHER * bends


def half_a_range_off(codes: Numbers, full_scale: float) -> Numbers:
    """Return the same bits with the highest one inverted, signed."""
    return np.asarray(codes % (2 * int(full_scale)) - int(full_scale))


def byte_swapped(codes: Numbers) -> Numbers:
    """Return 16-bit codes with their bytes exchanged."""
    return codes.astype(np.int16).byteswap()


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
    return Coder(bits, coding, span_codes / settings.span if scaled else 1.0, whole and not scaled, dtype.name)
