"""Rising and falling ramps of one radar: the Doppler shift raises one line and lowers the other."""

import dataclasses
import math
from collections.abc import Sequence

from drfmcw_physics.settings import ConfigurationError, nearest

from ..pipeline import Flag, RangeResult


def up_and_down(results: Sequence[RangeResult], pair: str, scale: float = math.nan) -> list[RangeResult]:
    """Return ranges and velocities of the sweeps that two stations which hear themselves have in common.

    With f_up = k tau + f_c dtau/dt and f_down = k tau - f_c dtau/dt, the mean of both ranges is free of the Doppler
    shift: it is the range in the middle of both ramps. Their difference is twice `scale` times the velocity, less the
    way between them.

    Args:
        results: of both stations.
        pair: 'up/down', their names.
        scale: range that a velocity adds to a rising ramp's, f_c / k [s]; NaN: velocities are not known.

    Raises:
        ConfigurationError: a station without results, or no sweep of one number.
    """
    names = pair.split('/')
    present = sorted({r.first_station for r in results})
    if len(names) != 2 or names[0] == names[1]:
        raise ConfigurationError(f"--pair '{pair}': expected the names of two stations, as up/down")
    for name in names:
        if name not in present:
            raise ConfigurationError(f"--pair '{pair}': no ranges of station '{name}'{nearest(name, present)}")
    up, down = ({r.sweep_id: r for r in results if r.first_station == name} for name in names)
    common = [(up[i], down[i]) for i in sorted(up.keys() & down.keys())]
    if not common:
        raise ConfigurationError(f"--pair '{pair}': no sweep of both stations has one number")
    return [_combined(a, b, scale) for a, b in common]


def _combined(up: RangeResult, down: RangeResult, scale: float) -> RangeResult:
    half = 0.5 * (up.range - down.range)
    free = [math.sqrt(max(r.range_std**2 - r.doppler_std**2, 0.0)) for r in (up, down)]
    later = (down.stamp - up.stamp) * 1e-9
    velocity = 2.0 * half / (2.0 * scale - later) if math.isfinite(scale) else math.nan
    flags = up.flags | down.flags
    if math.isfinite(velocity):
        flags &= ~Flag.UNKNOWN_VELOCITY
    return dataclasses.replace(
        up,
        second_station=down.first_station,
        stamp=min(up.stamp, down.stamp),
        flags=int(flags),
        range=0.5 * (up.range + down.range),
        range_std=0.5 * math.hypot(*free),
        doppler_std=0.0,
        velocity=velocity,
        velocity_correction=-half,
        uncorrected_range=0.5 * (up.uncorrected_range + down.uncorrected_range),
        path_delay=0.5 * (up.path_delay + down.path_delay),
        failed_tests=up.failed_tests | down.failed_tests,
    )
