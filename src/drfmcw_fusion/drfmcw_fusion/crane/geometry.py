"""Where the crane stands on its rail, from the range between two antennas whose places are known; no ROS.

Frames (REP 103, REP 105): the rail frame has x along the rail, z up; the crane frame has the same axes and moves in x.
"""

import dataclasses
import math

from drfmcw_physics.settings import ConfigurationError, parameter

_FRAME = 'name of the frame that is fixed to the rail, x along it'


@dataclasses.dataclass(frozen=True)
class SiteGeometry:
    """Where the antennas of a pair are: the first one in the rail's frame, the second one in the crane's."""

    pair: str = parameter('master/slave', structural=True, description="pair 'fixed station/station on the crane'")
    rail_frame: str = parameter('rail', structural=True, description=_FRAME)
    crane_frame: str = parameter('crane', structural=True, description='name of the frame that moves with the crane')
    forward: bool = parameter(
        True, structural=True, description='the crane stands at larger x than the fixed antenna; false: at smaller x'
    )
    fixed_x: float = parameter(0.0, unit='m', structural=True, description='antenna of the fixed station, rail frame')
    fixed_y: float = parameter(0.0, unit='m', structural=True, description='the same, to the left of the rail')
    fixed_z: float = parameter(0.0, unit='m', structural=True, description='the same, above the rail')
    crane_x: float = parameter(0.0, unit='m', structural=True, description='antenna on the crane, crane frame')
    crane_y: float = parameter(0.0, unit='m', structural=True, description='the same, to the left')
    crane_z: float = parameter(0.0, unit='m', structural=True, description='the same, up')

    def __post_init__(self) -> None:
        """Refuse names that are no pair of two stations, and frames that are one."""
        names = self.pair.split('/')
        if len(names) != 2 or not all(names) or names[0] == names[1]:
            raise ConfigurationError(f"pair: '{self.pair}' is not 'fixed station/station on the crane'")
        if not self.rail_frame or not self.crane_frame or self.rail_frame == self.crane_frame:
            raise ConfigurationError('rail_frame, crane_frame: give two different names')

    @property
    def fixed_antenna(self) -> tuple[float, float, float]:
        """Place of the fixed antenna in the rail frame [m]."""
        return self.fixed_x, self.fixed_y, self.fixed_z

    @property
    def crane_antenna(self) -> tuple[float, float, float]:
        """Place of the crane's antenna in the crane frame [m]."""
        return self.crane_x, self.crane_y, self.crane_z

    @property
    def lateral(self) -> float:
        """Distance of the antennas across the rail, which the range includes [m]."""
        return math.hypot(self.crane_y - self.fixed_y, self.crane_z - self.fixed_z)

    def position(self, distance: float, std: float) -> tuple[float, float] | None:
        """Return where the crane is, None where it cannot be.

        Args:
            distance: between the antennas [m].
            std: its standard deviation [m].

        Returns:
            x of the crane frame in the rail frame and its standard deviation [m]. None for a distance that is shorter
            than the antennas are apart across the rail, or that is no number.
        """
        if not math.isfinite(distance) or distance <= self.lateral:
            return None
        along = math.sqrt(distance**2 - self.lateral**2)
        sign = 1.0 if self.forward else -1.0
        return self.fixed_x + sign * along - self.crane_x, std * distance / along
