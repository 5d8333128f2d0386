"""Measurements of a pair as the simulator's signal model sees them, for the tests."""

import numpy as np

from drfmcw_physics.sweep import SweepSettings
from drfmcw_sim.measurements import Measurements, Path, Station
from drfmcw_sim.synthesis.signal_model import PHASE_UNIT, geometry, if_phase

SILENT = -400.0
"""Additive noise below any rounding [dBm/Hz]."""


def station(name, peer, role, n, alpha=1.0, clock=None, power=-60.0, floor=SILENT, noise=None, iq=False, **sweep):
    """Return one station's state in n equal measurements."""
    full = [alpha, alpha if clock is None else clock, power, floor, 25.0]
    alpha, clock, power, floor, temperature = (np.full(n, float(v)) for v in full)
    return Station(SweepSettings(name, peer, role=role, **sweep), alpha, clock, power, floor, noise, temperature, iq=iq)


def pair(
    n=1, delay=700e-9, rate=0.0, acceleration=0.0, alphas=(1.0, 1.0), clocks=(None, None), start_delay=3.41e-6, **kwargs
):
    """Return n equal measurements of a pair."""
    stations = (
        station('a', 'b', 1, n, alphas[0], clocks[0], start_delay=start_delay, **kwargs),
        station('b', 'a', 2, n, alphas[1], clocks[1], start_delay=start_delay, **kwargs),
    )
    path = Path(*(np.full(n, float(v)) for v in (delay, rate, acceleration, 1.0)))
    zeros = np.zeros(n)
    return Measurements(stations, np.arange(n), zeros, zeros, zeros, np.full(n, start_delay), np.zeros((2, n)), [path])


def if_turns(m, receiver):
    """Return the noise-free IF phase over the direct path, within +-1/2 turn, float64 [n, samples]."""
    return if_phase(m, receiver, geometry(m, receiver, m.paths[0])) * PHASE_UNIT
