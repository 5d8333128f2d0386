"""What has happened to the samples of a sweep before the ADC: a limiter, a burst."""

import numpy as np

_BLOCK = 32  # samples whose energy is compared
_SETTLING_SHARE = 16  # of the sweep, at its start
_BURST = 4.0  # times the median block's energy


def clipped(samples: np.ndarray, full_scale: np.ndarray) -> np.ndarray:
    """Return which sweeps (B, n) were clipped: samples at full scale, or an extreme code too frequent for a wave.

    A sine of amplitude A spends at most sqrt(2 / A) / pi of its time within the last code. Three times as much, at
    either extreme, shows a limiter below full scale.
    """
    highest, lowest = samples.max(axis=1), samples.min(axis=1)
    amplitude = (highest.astype(float) - lowest) / 2
    at_limit = (highest >= full_scale - 1.0) | (lowest <= 1.0 - full_scale)
    count = np.maximum(_counted(samples == highest[:, None]), _counted(samples == lowest[:, None]))
    usual = np.sqrt(2.0 / np.maximum(amplitude, 1.0)) / np.pi
    return at_limit | ((amplitude >= 4.0) & (count > 3.0 * usual * samples.shape[1]))


def _counted(mask: np.ndarray) -> np.ndarray:
    """Return the number of True in each row (B,); a sum along an axis takes ten times as long."""
    return np.array([np.count_nonzero(row) for row in mask])


def has_burst(record: np.ndarray, windowed: bool) -> np.ndarray:
    """Return which sweeps (B, N) hold a burst: a few blocks with far more energy than the median one.

    A line, a second one 6 dB weaker and white noise together stay below twice the median; a block of white noise alone
    reaches 2.4 times the median once in 1e6 sweeps. Where a window (`windowed`) weighs the sweep's start with next to
    nothing, its first sixteenth, in which a receiver settles, does not count.
    """
    count = record.shape[1] // _BLOCK
    if count < 2 * _SETTLING_SHARE:
        return np.zeros(len(record), bool)
    used = record[:, : count * _BLOCK]
    squared = used.real**2 + used.imag**2 if np.iscomplexobj(used) else used * used
    energy = squared.reshape(len(record), count, _BLOCK)[:, count // _SETTLING_SHARE if windowed else 0 :].sum(axis=2)
    energy.partition(energy.shape[1] // 2, axis=1)
    return energy.max(axis=1) > _BURST * np.maximum(energy[:, energy.shape[1] // 2], _BLOCK)
