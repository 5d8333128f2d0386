"""The frequency sweep and the beat frequencies of a pair of stations.

Equation numbers are those of the paper (see docs/architecture.md for the analysis window).
"""

import dataclasses
import enum
import functools
import math

from .settings import ConfigurationError, parameter


class Mode(enum.IntEnum):
    """Measurement mode: which of delay and T_off is larger (values of SweepConfig.MODE_*)."""

    SHORT_DISTANCE = 0
    LONG_DISTANCE = 1

    @property
    def short_name(self) -> str:
        """'SD' or 'LD'."""
        return 'SD' if self is Mode.SHORT_DISTANCE else 'LD'


class Role(enum.IntEnum):
    """Which station starts first (values of SweepConfig.ROLE_*)."""

    FIRST = 1
    SECOND = 2


@dataclasses.dataclass(frozen=True)
class SweepSettings:
    """Settings of one station for the measurement between it and one peer; the fields of SweepConfig."""

    station: str
    peer: str
    role: int = parameter(Role.FIRST, description='1 starts first, 2 starts start_delay later', bounds=(1, 2))
    mode: int = parameter(Mode.SHORT_DISTANCE, description='0 short distance, 1 long distance', bounds=(0, 1))
    start_frequency: float = parameter(
        5725e6, unit='Hz', bounds=(1e6, 1e12), description='nominal sweep start frequency f_0'
    )
    bandwidth: float = parameter(
        150e6, unit='Hz', bounds=(-1e11, 1e11), description='nominal sweep bandwidth B_sw, negative for a falling ramp'
    )
    ramp_duration: float = parameter(1e-3, unit='s', bounds=(1e-6, 100.0), description='nominal ramp duration T_sw')
    start_delay: float = parameter(
        3.41e-6, unit='s', bounds=(0.0, 1.0), description='nominal T_off between the two sweep starts'
    )
    sample_rate: float = parameter(2.048e6, unit='Hz', bounds=(1e2, 1e10), description='nominal ADC rate')
    sample_count: int = parameter(
        2048, bounds=(16, 1 << 24), description="samples per sweep, the first at this station's own sweep start"
    )
    tx_eirp: float = parameter(
        13.0, unit='dBm', bounds=(-200.0, 100.0), nan_means='unknown', description='transmitted EIRP'
    )
    rx_antenna_gain: float = parameter(
        21.0, unit='dBi', bounds=(-100.0, 100.0), nan_means='unknown', description='receive antenna gain'
    )
    full_scale_power: float = parameter(
        -20.0,
        unit='dBm',
        bounds=(-200.0, 100.0),
        nan_means='unknown',
        description='power of a sine at ADC full scale, at the receive antenna port',
    )
    stamp: int = 0
    frame_id: str = ''
    cut: tuple[float, float] = (0.0, 0.0)
    """Left out at either end of the analysis window, where a recording shows that the ramp does not run [s]."""

    def __post_init__(self) -> None:
        """Refuse what no radar can sweep."""
        if self.bandwidth == 0 or not math.isfinite(self.bandwidth):
            raise ConfigurationError(f'bandwidth = {self.bandwidth:g} Hz: a sweep needs one')
        if self.start_delay >= self.ramp_duration:
            raise ConfigurationError(
                f'start_delay = {self.start_delay:g} s is not shorter than ramp_duration = {self.ramp_duration:g} s'
            )

    @property
    def chirp_rate(self) -> float:
        """Nominal chirp rate k = B_sw / T_sw [Hz/s]."""
        return self.bandwidth / self.ramp_duration

    @property
    def center_frequency(self) -> float:
        """Nominal frequency at mid-sweep [Hz]."""
        return self.start_frequency + self.bandwidth / 2

    @property
    def hears_itself(self) -> bool:
        """True where the station receives its own chirp (reflector, cable loop)."""
        return self.peer == self.station

    @property
    def record_duration(self) -> float:
        """Time that the samples of one sweep cover [s]."""
        return self.sample_count / self.sample_rate

    def analysis_window(self) -> tuple[float, float]:
        """Return (start, end) of the analysis window in the station's own time since its sweep start [s].

        Both stations' windows cover the same absolute time, from T_off and the largest delay on, when each hears the
        other at any distance, to T_sw; T_off then cancels as in eqs. 16-18.
        """
        return self._analysis_window

    @functools.cached_property
    def _analysis_window(self) -> tuple[float, float]:
        start = min(max(largest_delay(self), 0.0), self.ramp_duration / 64) + self.cut[0]
        end = min(self.ramp_duration, self.record_duration) - self.cut[1]
        if self.hears_itself:
            return start, end
        if self.role == Role.FIRST:
            return start + self.start_delay, end
        return start, end - self.start_delay

    def window_center(self) -> float:
        """Return the centre of the analysis window, in the station's own time since its sweep start [s]."""
        start, end = self.analysis_window()
        return (start + end) / 2

    def line_sign(self) -> int:
        """Return +1 where the positive beat frequency counts phi_1 - phi_2 (eqs. 1, 2, 3), -1 where reversed (eq. 4).

        A falling ramp reverses all signs; a station that hears itself counts like station 1.
        """
        sign = -1 if (self.role == Role.SECOND and self.mode == Mode.LONG_DISTANCE and not self.hears_itself) else 1
        return sign if self.bandwidth > 0 else -sign


def beat_frequency(sweep: SweepSettings, delay: float, alpha_own: float, alpha_peer: float) -> float:
    """Return the beat frequency at the centre of the analysis window, positive as a real IF shows it [Hz].

    Args:
        sweep: the station's settings.
        delay: of the whole path, hardware and air [s].
        alpha_own: the station's reference frequency / nominal [1].
        alpha_peer: the peer's [1].

    Returns:
        Frequency in true time (eqs. 16, 17 differentiated, at the window centre).
    """
    k = sweep.chirp_rate
    if sweep.hears_itself:
        return abs(k) * alpha_own**2 * delay
    first, second = (alpha_own, alpha_peer) if sweep.role == Role.FIRST else (alpha_peer, alpha_own)
    start, end = sweep.analysis_window()
    # absolute time of the window centre since station 1's start: both stations' windows share it
    t = (start + end) / 2 + (sweep.start_delay if sweep.role == Role.SECOND else 0.0)
    common = (
        sweep.start_frequency * (first - second) + k * t * (first**2 - second**2) + k * second**2 * sweep.start_delay
    )
    line = common + k * second**2 * delay if sweep.role == Role.FIRST else common - k * first**2 * delay
    return abs(line)


def residual_chirp(sweep: SweepSettings, alpha_own: float, alpha_peer: float) -> float:
    """Return the chirp rate left on the IF line by different references, of the positive line [Hz/s] (eqs. 16, 17)."""
    if sweep.hears_itself:
        return 0.0
    first, second = (alpha_own, alpha_peer) if sweep.role == Role.FIRST else (alpha_peer, alpha_own)
    return sweep.line_sign() * sweep.chirp_rate * (first**2 - second**2)


def largest_delay(sweep: SweepSettings) -> float:
    """Return the delay at which station 1's line reaches the Nyquist frequency, equal references [s]."""
    return sweep.sample_rate / 2 / abs(sweep.chirp_rate) - sweep.start_delay


def largest_range(sweep: SweepSettings, velocity: float) -> float:
    """Return the range at which station 1's line reaches the Nyquist frequency, equal references [m]."""
    return largest_delay(sweep) * velocity
