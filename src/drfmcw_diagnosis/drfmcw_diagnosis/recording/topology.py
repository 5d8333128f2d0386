"""Who measures with whom: a pair, one station of a pair, or a station that hears itself; real or I/Q samples."""

import dataclasses
import functools

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.sweep import Role, SweepSettings


@dataclasses.dataclass(frozen=True)
class Topology:
    """What follows from which stations take part and which of them have samples."""

    stations: tuple[str, ...]  # (first, second), or the one that hears itself
    heard: tuple[int, ...]  # numbers of the stations with samples
    iq: bool  # quadrature samples

    @property
    def hears_itself(self) -> bool:
        """One station receives its own sweep."""
        return len(self.stations) == 1

    @property
    def is_pair(self) -> bool:
        """Two stations measure with each other, whichever of them has samples."""
        return len(self.stations) == 2

    @property
    def both_heard(self) -> bool:
        """Both stations of a pair have samples, so T_off cancels in the range."""
        return len(self.heard) == 2

    @property
    def one_missing(self) -> bool:
        """One station of a pair has no samples, so T_off stands in the range."""
        return len(self.heard) < len(self.stations)

    @property
    def shares_noise(self) -> bool:
        """Both lines' phase noise is compared: not of quadrature samples, whose line may be at negative frequency."""
        return self.both_heard and not self.iq

    @property
    def receivers(self) -> tuple[str, ...]:
        """Names of the stations with samples."""
        return tuple(self.stations[i] for i in self.heard)

    @property
    def parts(self) -> int:
        """Parts of a sample: I and Q, or one real part."""
        return 2 if self.iq else 1

    @property
    def has_mirror(self) -> bool:
        """A real line has a mirror at negative frequency."""
        return not self.iq

    @property
    def line_share(self) -> float:
        """Power of the line at its frequency over its squared amplitude [1]."""
        return 0.25 if self.has_mirror else 1.0

    @property
    def amplitude_factor(self) -> float:
        """Amplitude of the line over that of its complex baseband [1]."""
        return 2.0 if self.has_mirror else 1.0

    @functools.cached_property
    def channels(self) -> tuple['Channel', ...]:
        """Series over the sweep: log amplitudes of each station, then phases; of a pair their sum and difference."""
        if self.both_heard:
            return (
                *(Channel(False, i, 'IF amplitude over the sweep') for i in range(2)),
                *(Channel(True, -1, f'{which} of both IF phases over the sweep') for which in ('sum', 'difference')),
            )
        return tuple(
            Channel(of_phase, 0, f'IF {what} over the sweep')
            for of_phase, what in ((False, 'amplitude'), (True, 'phase'))
        )

    def way_per_phase(self, sweeps: tuple[SweepSettings, ...]) -> float:
        """Return the movement per phase of the carrier [m/rad], 0 where T_off hides it.

        Args:
            sweeps: settings of all stations.
        """
        wave, own = SPEED_OF_LIGHT / sweeps[0].center_frequency, sweeps[self.heard[0]]
        if self.both_heard:
            return float(wave / (4.0 * np.pi))
        return float(own.line_sign() * wave / (2.0 * np.pi)) if own.hears_itself else 0.0

    def beat_per_start_delay(self, sweeps: tuple[SweepSettings, ...]) -> float:
        """Return the change of `SweepFeatures.beat` per T_off [Hz/s].

        Args:
            sweeps: settings of all stations.
        """
        own = sweeps[self.heard[0]]
        rate = abs(own.chirp_rate)
        if self.both_heard:
            return float(2.0 * rate)
        sign = sweeps[0].line_sign() * sweeps[-1].line_sign()
        return float(rate if own.role == Role.FIRST else sign * rate)


@dataclasses.dataclass(frozen=True)
class Channel:
    """What one of the ramp's series is."""

    of_phase: bool  # else log amplitude
    receiver: int  # number among the stations with samples, -1 for both
    words: str
