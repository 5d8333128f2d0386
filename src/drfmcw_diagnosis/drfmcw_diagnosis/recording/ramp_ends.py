"""Where a ramp does not run, at either end of the sweep: nothing there can be compared with a line.

In: samples and settings of a pair of stations. Out: settings whose analysis window leaves these ends out.
"""

import dataclasses

import numpy as np
from scipy.ndimage import uniform_filter1d

from drfmcw_physics.sweep import SweepSettings

from .limits import ENDS


def silent_ends(sweeps: tuple[SweepSettings, ...], samples: tuple[np.ndarray | None, ...]) -> tuple[float, float]:
    """Return what to leave out at the beginning and at the end of both stations' analysis windows [s].

    Args:
        sweeps: settings of both stations.
        samples: of the same, with these settings (n, N), with iq complex; None without any.
    """
    left_out = np.zeros(2)
    for sweep, x in zip(sweeps, samples, strict=True):
        if x is None or not len(x):
            continue
        power = np.abs(x * np.float32(1.0)) ** 2
        usual = power.mean(axis=1, keepdims=True)
        power = uniform_filter1d((power / np.maximum(usual, 1e-30)).mean(axis=0), ENDS.smooth, mode='nearest')
        present = np.flatnonzero(power > ENDS.silent * np.median(power))
        if not len(present):
            continue
        start, end = (t * sweep.sample_rate for t in sweep.analysis_window())
        early, late = present[0] - start, min(end, x.shape[1]) - 1 - present[-1]
        silent = np.array([n + ENDS.margin if n > ENDS.near else 0.0 for n in (early, late)])
        left_out = np.maximum(left_out, silent / sweep.sample_rate)
    start, end = sweeps[0].analysis_window()
    if left_out.sum() > ENDS.most * (end - start):
        return 0.0, 0.0
    return float(left_out[0]), float(left_out[1])


def without_silent_ends(
    sweeps: tuple[tuple[SweepSettings, ...], ...], setting: np.ndarray, samples: tuple[np.ndarray | None, ...], iq: bool
) -> tuple[tuple[SweepSettings, ...], ...]:
    """Return distinct settings without the ends of a ramp at which nothing is received, the same of all.

    Args:
        sweeps: distinct settings, each of both stations.
        setting: index of each sweep's (n,).
        samples: per station (n, N), I and Q interleaved (n, 2 N); None: not recorded.
        iq: whether I and Q are interleaved.
    """
    cut = np.zeros(2)
    for number, of_stations in enumerate(sweeps):
        rows = np.flatnonzero(setting == number)[: ENDS.sweeps]
        some = [None if x is None else x[rows] for x in samples]
        complete = tuple(x[:, ::2] + 1j * x[:, 1::2] if iq and x is not None else x for x in some)
        cut = np.maximum(cut, silent_ends(of_stations, complete))
    left_out = float(cut[0]), float(cut[1])
    return tuple(tuple(dataclasses.replace(s, cut=left_out) for s in of_stations) for of_stations in sweeps)
