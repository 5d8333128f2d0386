"""Phase noise of one oscillator, of the shape that its station reports or another one."""

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class NoiseShape:
    """Phase noise that differs from the one-pole shape a station reports.

    `kind`: 'one_pole' (as reported), 'corner' (corner times `value`, level at 100 kHz kept), 'flank' (1/f^3 in L below
    `value` [Hz]), 'bump' (servo bump of `value` [dB] at 1.5 times the corner), 'plateau' (all of it raised by `value`
    [dB]), 'aliased' (offsets beyond Nyquist fold back, as without an anti-aliasing filter).
    """

    kind: str = 'one_pole'
    value: float = 0.0


def phase_noise_density(frequency: np.ndarray, level: float, corner: float, shape: NoiseShape) -> np.ndarray:
    """Return L(f) [1/Hz] of one oscillator, single side-band; `frequency` [Hz], `level` [dBc/Hz at 100 kHz]."""
    if shape.kind == 'corner':
        corner = corner * shape.value
    density = 10.0 ** (level / 10.0) * (1.0 + (1e5 / corner) ** 2) / (1.0 + (frequency / corner) ** 2)
    if shape.kind == 'flank':
        density = density * (1.0 + (shape.value / np.maximum(frequency, 900.0)) ** 3)
    elif shape.kind == 'bump':
        centre = 1.5 * corner
        density = density * (1.0 + (10.0 ** (shape.value / 10.0) - 1.0) / (1.0 + ((frequency - centre) / 4e4) ** 2))
    elif shape.kind == 'plateau':
        density = density * 10.0 ** (shape.value / 10.0)
    elif shape.kind not in ('one_pole', 'corner', 'aliased'):
        raise ValueError(f"no phase-noise shape '{shape.kind}'")
    return density
