"""Where the fit of a bent ramp begins: as the effects bend it whose place it takes.

In: effects that shape a chirp, the conditions of a sweep. Out: coefficients of another effect that shapes it alike.
"""

from collections.abc import Sequence

import numpy as np

from drfmcw_sim.effects import Effect
from drfmcw_sim.measurements import Measurements

from ..limits import SEARCH
from .bank import Candidate


def bent_as(candidate: Candidate, effects: Sequence[Effect], m: Measurements) -> dict[str, float]:
    """Return the values with which an effect of many coefficients bends its station's chirp as others bend chirps.

    To first order, a chirp that one station of a pair sends beats as one bent the other way at the other station.

    Args:
        candidate: the effect of many coefficients.
        effects: at either station; of none, its values are those where it begins.
        m: conditions, of which the first count.
    """
    if not effects:
        return candidate.values
    m = m.rows(slice(0, 1))
    own = next(s for s in m.stations if s.name == candidate.station)
    phase = np.zeros(SEARCH.bend_points)
    for station in m.stations:
        u = np.linspace(0.0, station.sweep.ramp_duration, len(phase)) / station.alpha[:, None]
        added = np.zeros(u.shape)
        for effect in effects:
            if effect.applies_to(station.name):
                added += effect.chirp_phase(station, u)
        phase += added[0] if station is own else -added[0]
    rates = candidate.kind.imitating(phase, own.sweep, len(candidate.values))
    return dict(zip(candidate.values, rates, strict=True))
