"""Response of a receiver over the IF, from its line through a cable at several T_off."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from drfmcw_node.processing.records import Beat

_APART = 10e3  # between lines that count as two; jitter of T_off spreads one over some hundred hertz [Hz]
_FEWEST_SWEEPS = 3  # of a line
_FEWEST_LINES = 3  # which separate a response from a gain


@dataclasses.dataclass(frozen=True)
class LineResponse:
    """Amplitude of one line over the frequency that T_off gives it."""

    frequency: np.ndarray  # (n,) increasing [Hz]
    gain: np.ndarray  # (n,) over the median of all [dB]
    gain_std: np.ndarray  # (n,) of each [dB]
    sweeps: int


def line_response(beats: Sequence[Beat]) -> LineResponse | None:
    """Return what the levels of a station's line say of its receiver, None where it has too few frequencies.

    The path, and so the power at the antenna port, is the same for all: what differs with the frequency is the
    receiver's, from the antenna port to the ADC. Noise that enters on the way shows only what lies behind.

    Args:
        beats: of one station over one path, at several T_off; those with flags are left out.
    """
    clean = sorted((b for b in beats if not b.flags and math.isfinite(b.power)), key=lambda beat: beat.frequency)
    frequency, power = (np.array([getattr(beat, name) for beat in clean]) for name in ('frequency', 'power'))
    lines = np.split(np.arange(len(clean)), np.flatnonzero(np.diff(frequency) > _APART) + 1)
    lines = [line for line in lines if len(line) >= _FEWEST_SWEEPS]
    if len(lines) < _FEWEST_LINES:
        return None
    levels = np.array([float(np.mean(power[line])) for line in lines])
    return LineResponse(
        frequency=np.array([float(np.mean(frequency[line])) for line in lines]),
        gain=levels - float(np.median(levels)),
        gain_std=np.array([float(np.std(power[line], ddof=1)) / math.sqrt(len(line)) for line in lines]),
        sweeps=sum(len(line) for line in lines),
    )
