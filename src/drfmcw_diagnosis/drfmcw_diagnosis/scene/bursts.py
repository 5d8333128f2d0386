"""Another transmitter that crosses the band: in some sweeps the power rises where in the others it does not."""

import dataclasses
import math

import numpy as np
from scipy import stats

from .limits import BURSTS
from .material import Material


@dataclasses.dataclass(frozen=True)
class Bursts:
    """Bursts of power in some sweeps."""

    probability: float  # of a burst in a sweep [1]
    amplitude: float  # of a line with the burst's power [LSB]
    duration: float  # [s]
    hit: np.ndarray  # (n,) sweeps with a burst
    at: np.ndarray  # (n, N) samples in a burst
    share: float  # of the samples [1]
    excess: float  # power of what cannot be predicted in a burst over that beside it [1]
    chance: float  # of so many blocks so loud in white noise


def unpredicted(signal: np.ndarray) -> tuple[np.ndarray, float]:
    """Return what a linear prediction from the samples before leaves, (n, N - order), and by how much it raises noise.

    Lines are predicted, white noise is not: its power is raised by the sum of the squared weights.
    """
    order = min(BURSTS.order, signal.shape[1] // 8)
    spans = np.lib.stride_tricks.sliding_window_view(signal, order + 1, axis=1)
    flat = spans.reshape(-1, order + 1)
    thin = flat[:: max(1, len(flat) // 40_000)]
    normal = thin[:, :-1].conj().T @ thin[:, :-1]
    normal += np.eye(order) * (1e-9 * np.trace(normal).real / order + 1e-12)
    weights = np.linalg.solve(normal, thin[:, :-1].conj().T @ thin[:, -1])
    rest: np.ndarray = spans[..., -1] - spans[..., :-1] @ weights
    return rest, 1.0 + float(np.sum(np.abs(weights) ** 2))


def bursts(m: Material) -> Bursts | None:
    """Return the bursts of some sweeps, None where there are none."""
    if len(m.signal) < BURSTS.fewest or m.signal.shape[1] < 8 * BURSTS.block:
        return None
    rest, amplified = unpredicted(m.signal)
    block = BURSTS.block
    blocks = rest.shape[1] // block
    power = np.mean(np.abs(rest[:, : blocks * block].reshape(len(rest), blocks, block)) ** 2, axis=2)
    usual = np.maximum(np.median(power, axis=0), max(float(np.median(power)), 1.0 / 12.0))  # quantisation at least
    loud = power > BURSTS.peak * usual
    hit = loud.any(axis=1)
    quiet = (power / usual)[~loud]
    if not BURSTS.hit <= hit.sum() <= BURSTS.often * len(hit) or np.mean(quiet) > BURSTS.contrast * np.median(quiet):
        return None
    lead = m.signal.shape[1] - rest.shape[1]
    at = np.zeros(m.signal.shape, bool)
    at[:, lead : lead + blocks * block] = np.repeat(loud, block, axis=1)
    excess = float(np.mean(power[loud]) / np.mean(power[~loud]))
    extra = float(np.mean(power[loud]) - np.mean(power[~loud])) / amplified  # a burst is white
    amplitude = math.sqrt(max(extra, 1.0 / 12.0) * (1.0 if m.iq else 2.0))
    per_sweep = loud[hit].sum(axis=1) * block / m.rate
    freedom = block * (2 if m.iq else 1)
    loudest = BURSTS.peak * float(stats.chi2.median(freedom))
    chance = float(stats.binom.sf(int(loud.sum()) - 1, loud.size, stats.chi2.sf(loudest, freedom)))
    return Bursts(float(hit.mean()), amplitude, float(np.mean(per_sweep)), hit, at, float(at.mean()), excess, chance)
