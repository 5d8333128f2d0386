"""Which oscillator is noisier: the coherence of the phase noise of both stations' lines.

Each line contains its own station's oscillator noise, and that of the other station as it was one path delay tau ago.
Let S_1 and S_2 be the oscillators' noise densities. The phases of both lines, each station's own less the received one,
then have the cross spectrum -(S_1 exp(j w tau) + S_2 exp(-j w tau)). The power of the lines' skirts depends on
S_1 + S_2 alone. The imaginary part of the cross spectrum, -(S_1 - S_2) sin(w tau), shows which one is larger. It is
compared relative to the root of the powers of the phases' sum and difference, so that the shape of the noise cancels:
(S_1 - S_2) / (S_1 + S_2) remains if there is no other noise.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy.fft

from drfmcw_physics.phase_noise import PhaseNoise, components_around_line, components_between_lines
from drfmcw_physics.sweep import SweepSettings

from .limits import SIDEBANDS
from .spectra import phasor


@dataclasses.dataclass(frozen=True)
class Sidebands:
    """Which sidebands of both lines are compared in a group, or in each of several (...), over F offsets in C bands."""

    offset: np.ndarray  # (F,) [Hz]
    upper: np.ndarray  # (..., 2, F) those of each station within its spectrum
    lower: np.ndarray  # (..., 2, F)
    edges: np.ndarray  # (C + 1,) first offset of each band and the end
    present: np.ndarray  # (..., C) bands in which both stations have one

    def summed(self, values: np.ndarray) -> np.ndarray:
        """Return sums over each band (..., C) of a spectrum (..., F), over offsets at which both have one."""
        both = np.all(self.upper | self.lower, axis=-2)
        return np.add.reduceat(np.where(both, values, 0.0), self.edges[:-1], axis=-1)


def sidebands(line: np.ndarray, sweep: SweepSettings) -> Sidebands:
    """Return which sidebands of lines at the frequencies `line` (..., 2) [Hz] are compared."""
    width = sweep.sample_rate / sweep.sample_count
    offset = np.arange(SIDEBANDS.nearest, int(SIDEBANDS.farthest * sweep.sample_count)) * width
    upper = line[..., None] + offset < sweep.sample_rate / 2 - SIDEBANDS.clear * width
    lower = line[..., None] - offset > SIDEBANDS.clear * width
    edges = np.linspace(0, len(offset), SIDEBANDS.bands + 1).astype(int)
    present = np.add.reduceat(np.all(upper | lower, axis=-2).astype(int), edges[:-1], axis=-1) >= SIDEBANDS.nearest
    return Sidebands(offset, upper, lower, edges, present)


def measured(
    samples: Sequence[np.ndarray],
    line: np.ndarray,
    chirp: np.ndarray,
    later: np.ndarray,
    weights: Sequence[np.ndarray],
    sweeps: Sequence[SweepSettings],
) -> np.ndarray:
    """Return each sweep's share in a group's imaginary coherence (n, C), 0 in bands that are not present.

    The mean of the shares is the group's.

    Args:
        samples: real, of both stations (n, N) [LSB].
        line: frequencies of their lines (n, 2) [Hz].
        chirp: residual chirp rate of each station's line (2,) [Hz/s].
        later: delay of the second station's sweep start after the first one's (n,) [s].
        weights: window of each station (N,).
        sweeps: settings of both.
    """
    used = sidebands(line.mean(axis=0), sweeps[0])
    phases = []
    for number, (x, window, sweep) in enumerate(zip(samples, weights, sweeps, strict=True)):
        time = np.arange(x.shape[1]) / sweep.sample_rate
        bend = 0.5 * chirp[number] * (time - np.average(time, weights=window)) ** 2
        turns = line[:, number, None] * time + bend
        still = x * window.astype(np.float32) * phasor(-turns)
        spectrum = scipy.fft.fft(still, axis=1)
        spectrum /= spectrum[:, :1]
        bins = np.arange(SIDEBANDS.nearest, SIDEBANDS.nearest + len(used.offset))
        above, below = -1j * spectrum[:, bins], 1j * spectrum[:, -bins].conj()
        both = np.where(used.upper[number], above, 0.0) + np.where(used.lower[number], below, 0.0)
        phases.append(sweep.line_sign() * both)
    one, two = phases[0], -phases[1]  # both as the first station's phase less the second's
    two = two * np.exp(-2j * np.pi * later[:, None] * used.offset)
    # what all sweeps share is no noise; the scaling keeps a spur at some offset from counting more than noise
    one, two = ((x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-30) for x in (one, two))
    return _imaginary(used, one * two.conj())


def predicted(
    used: Sidebands,
    oscillators: Sequence[PhaseNoise],
    sweeps: Sequence[SweepSettings],
    floors: np.ndarray,
    responses: np.ndarray,
    delay: np.ndarray | float,
) -> np.ndarray:
    """Return the imaginary coherence of groups (..., C), 0 in bands that are not present.

    Both sidebands of a line together show sin phi of its phase, one alone cos phi as well.

    Args:
        used: sidebands compared.
        oscillators: of both stations.
        sweeps: settings of both.
        floors: density of additive noise over the line's power (..., 2, upper and lower, F) [1/Hz].
        responses: each receiver's complex gain of a sideband over that of the line (..., 2, upper and lower, F).
        delay: of the path (...) [s].
    """
    there = np.stack([used.upper, used.lower], axis=-2)
    # the lower sideband is the conjugate of the spectrum of exp(j phi)
    passed = np.where(there, np.stack([responses[..., 0, :], responses[..., 1, :].conj()], axis=-2), 0.0)
    sine = np.sum(passed, axis=-2)
    signs = np.array([sweeps[0].line_sign(), -sweeps[1].line_sign()])
    cosine = -1j * (passed[..., 0, :] - passed[..., 1, :]) * signs[:, None]
    rate, count = sweeps[0].sample_rate, sweeps[0].sample_count
    bins = np.rint(used.offset * count / rate).astype(int)
    quadrature, in_phase = (d[bins] for d in components_around_line(oscillators, rate, count))
    power = quadrature * np.abs(sine) ** 2 + in_phase * np.abs(cosine) ** 2 + np.sum(np.where(there, floors, 0.0), -2)
    shared = components_between_lines(oscillators[0], oscillators[1], delay, rate, count)
    cross = sum(d[..., bins] * x[..., 0, :] * x[..., 1, :].conj() for d, x in zip(shared, (sine, cosine), strict=True))
    return _imaginary(used, (cross / np.sqrt(np.maximum(power[..., 0, :] * power[..., 1, :], 1e-60)))[None])[0]


def _imaginary(used: Sidebands, cross: np.ndarray) -> np.ndarray:
    """Return shares in the imaginary coherence (n, ..., C) from cross spectra of unit-power phases (n, ..., F).

    Relative to the root of the mean powers of both phases' sum and difference; 0 in bands that are not present.
    """
    total, difference = (used.summed(1.0 + s * cross.real).mean(axis=0) for s in (1.0, -1.0))
    power = np.where(used.present, total * difference, np.inf)
    return used.summed(-cross.imag) / np.sqrt(np.maximum(power, 1e-30))
