"""What a recording is made under: both stations as they are, distances, weather, temperatures."""

import dataclasses

from .phase_noise import NoiseShape


@dataclasses.dataclass(frozen=True)
class StationCondition:
    """One station: what its calibration reports, and how its noise really is."""

    name: str
    delay: float  # calibrated, one-way [s]
    alpha: float = 1.0
    sample_clock_alpha: float = 1.0
    calibration_temperature: float = 25.0  # [degC]
    noise_floor: float = -140.0  # [dBm/Hz]
    phase_noise_level: float = -90.0  # [dBc/Hz at 100 kHz]
    phase_noise_corner: float = 120e3  # [Hz]
    shape: NoiseShape = NoiseShape()


@dataclasses.dataclass(frozen=True)
class Condition:
    """A recording before anything is concealed in it. Tuples over settings have one length."""

    seed: int
    distances: tuple[float, ...]  # reference distance of each setting [m]
    air_temperature: tuple[float, ...]  # [degC]
    air_pressure: tuple[float, ...]  # [Pa]
    air_humidity: tuple[float, ...]  # [0..1]
    board_temperature: tuple[tuple[float, ...], tuple[float, ...]]  # of each station [degC]
    stations: tuple[StationCondition, StationCondition] = (
        StationCondition('master', 12e-9),
        StationCondition('slave', 15e-9),
    )
    sweeps: int = 24  # at each setting
    interval: float = 20e-3  # between sweeps [s]
    pause: float = 60.0  # between settings [s]
    start_frequency: float = 5.725e9
    bandwidth: float = 150e6
    ramp_duration: float = 1e-3
    sample_rate: float = 2.048e6
    sample_count: int = 2048
    short_start_delay: float = 3.41e-6
    long_start_delay: float = 0.6e-6
    mode_boundary: float = 650.0  # LD mode from here on [m]
    tx_eirp: float = 13.0  # [dBm]
    rx_antenna_gain: float = 21.0  # [dBi]
    full_scale: float = 8192.0  # [LSB]
    full_scale_power: float = -20.0  # [dBm]
    reference_std: float = 5e-3  # [m]
    start_delay_jitter: float = 2e-9  # [s]
    amplitude_scatter: float = 0.2  # of a sweep, common to both stations [dB]
    amplitude_drift: float = 0.0  # standard deviation of a slow wander of the power [dB]
    outlier_probability: float = 0.0  # of a sweep that is late, weak and noisy

    def __post_init__(self) -> None:
        """Refuse tuples of different lengths."""
        lengths = {
            len(self.distances),
            len(self.air_temperature),
            len(self.air_pressure),
            len(self.air_humidity),
            *map(len, self.board_temperature),
        }
        if len(lengths) != 1:
            raise ValueError(f'settings of different number: {sorted(lengths)}')

    @property
    def chirp_rate(self) -> float:
        """The nominal k [Hz/s]."""
        return self.bandwidth / self.ramp_duration

    @property
    def duration(self) -> float:
        """From the first sweep to the end of the last setting [s]."""
        return len(self.distances) * (self.pause + self.sweeps * self.interval)

    @property
    def names(self) -> tuple[str, str]:
        """The names of both stations."""
        return self.stations[0].name, self.stations[1].name
