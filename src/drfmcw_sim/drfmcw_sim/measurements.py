"""True state of stations and paths in a batch of measurements: what effects change, and IF signals are made from."""

import dataclasses
import functools
import math

import numpy as np
import scipy

from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.sweep import SweepSettings


@dataclasses.dataclass(frozen=True)
class Modulation:
    """A sine on the frequency of a transmitter, its phase random in each of n sweeps."""

    deviation: float  # peak of the frequency error [Hz]
    rate: float  # [Hz]
    phase: np.ndarray  # [n] of the sine as the sweep starts [rad]

    def chirp_phase(self, u: np.ndarray) -> np.ndarray:
        """Return the integral of the frequency error over the true time u [n, samples] since the sweep start [rad]."""
        half = (np.pi * self.rate) * u  # a difference of cosines, without cancellation where it is slow
        integral: np.ndarray = 2.0 * (self.deviation / self.rate) * np.sin(half) * np.sin(half + self.phase[:, None])
        return integral


@dataclasses.dataclass(frozen=True)
class Response:
    """Factor on all that a station hears of others in each of n sweeps, over the time in the sweep."""

    time: np.ndarray  # (K,) since the sweep's start on the station's own clock [s]
    log_amplitude: np.ndarray  # (n, K) [Np]
    phase: np.ndarray  # (n, K) of the IF [rad]

    def over_samples(self, count: int, rate: float) -> tuple[np.ndarray, np.ndarray]:
        """Return log amplitude [Np] and phase [rad] (n, count) at samples of a rate [Hz], constant beyond the grid."""
        matrix = _interpolation(self.time.tobytes(), count, rate)
        return self.log_amplitude @ matrix, self.phase @ matrix


@functools.lru_cache(maxsize=16)
def _interpolation(grid: bytes, count: int, rate: float) -> np.ndarray:
    """Return the matrix (K, count) that makes samples of a curve's values on a grid (K,) [s]."""
    at = np.frombuffer(grid)
    if len(at) < 2:
        return np.ones((1, count))
    time = np.clip(np.arange(count) / rate, at[0], at[-1])
    matrix: np.ndarray = scipy.interpolate.CubicSpline(at, np.eye(len(at)), bc_type='natural')(time).T
    return matrix


@dataclasses.dataclass
class Station:
    """True state of one station in a batch of n measurements; effects may change the arrays."""

    sweep: SweepSettings
    alpha: np.ndarray  # [n] reference / nominal
    sample_clock: np.ndarray  # [n] ADC clock / nominal
    received_power: np.ndarray  # [n] of the direct path at the antenna port [dBm]
    noise_density: np.ndarray  # [n] at the antenna port [dBm/Hz]
    phase_noise: PhaseNoise | None
    temperature: np.ndarray  # [n] board [degC]
    calibration_temperature: float = 25.0  # [degC]
    full_scale: float = 8192.0  # [LSB]
    iq: bool = False
    slope: float = 0.0  # by which the received signal falls, linearly in dB, from the ramp's start to its end [dB]
    straight: tuple[float, float] = (0.0, math.inf)  # when the ramp is straight, since its start in own time [s]
    noise_behind: bool = False  # the additive noise enters behind the filters of the IF path
    modulations: tuple[Modulation, ...] = ()  # of the transmitter
    responses: tuple[Response, ...] = ()  # of the receiver

    @property
    def name(self) -> str:
        """The station's name."""
        return self.sweep.station

    def amplitude(self, power: np.ndarray) -> np.ndarray:
        """Return the amplitude [LSB] of a sine of `power` [dBm] at the antenna port."""
        return self.full_scale * 10.0 ** ((power - self.sweep.full_scale_power) / 20.0)

    @property
    def on(self) -> tuple[np.ndarray, np.ndarray]:
        """The true times since the sweep start between which the ramp can be received, ([n], [n]) [s]."""
        first, last = self.straight
        return first / self.alpha, min(last, self.sweep.ramp_duration) / self.alpha

    def noise_std(self) -> np.ndarray:
        """Return the standard deviation of the additive noise in each real or I or Q sample [LSB].

        The density spreads over f_s/2 of a real IF, over f_s of a quadrature one; both then have the same noise power
        per line power in a bin.
        """
        bandwidth = self.sweep.sample_rate * (1.0 if self.iq else 0.5)
        return self.amplitude(self.noise_density + 10.0 * np.log10(bandwidth)) / np.sqrt(2.0)


@dataclasses.dataclass
class Path:
    """One propagation path: tau(t) = delay + rate t + acceleration t^2 / 2, t since station 1's sweep start."""

    delay: np.ndarray  # [n] of the whole path, hardware and air [s]
    rate: np.ndarray  # [n] [s/s]
    acceleration: np.ndarray  # [n] [s/s^2]
    amplitude: np.ndarray  # [n] relative to the direct path, negative where the sign is reversed [1]
    phase: float = 0.0  # by which a reflector turns the carrier back, as a longer way does [turns]

    def rows(self, rows: slice | np.ndarray) -> 'Path':
        """Return a copy for some of the measurements."""
        delay, rate, acceleration, amplitude = (
            x[rows].copy() for x in (self.delay, self.rate, self.acceleration, self.amplitude)
        )
        return Path(delay, rate, acceleration, amplitude, self.phase)


@dataclasses.dataclass
class Measurements:
    """Everything that determines the IF signals of n measurements of one pair with one set of sweep settings."""

    stations: tuple[Station, ...]  # first and second, or the one station that hears itself
    sweep_id: np.ndarray  # [n]
    time: np.ndarray  # [n] station 1's sweep start since the scenario's start [s]
    range: np.ndarray  # [n] true antenna distance at that time [m]
    velocity: np.ndarray  # [n] [m/s]
    start_delay: np.ndarray  # [n] true T_off [s]
    initial_phase: np.ndarray  # [stations, n] phi_0 [turns]
    paths: list[Path]  # the direct one first
    start_delay_jitter: float = 0.0  # standard deviation from sweep to sweep [s]
    amplitude_scatter: float = 0.0  # standard deviation from sweep to sweep [dB]
    refractive_index: np.ndarray | float = 1.0  # [n] of the air on the path
    setting: np.ndarray | int = 0  # [n] number of the distance at which the crane stands

    def __len__(self) -> int:
        """Return the number of measurements."""
        return len(self.sweep_id)

    def rows(self, rows: slice | np.ndarray) -> 'Measurements':
        """Return a copy of some of the measurements."""
        stations = tuple(
            dataclasses.replace(
                s,
                alpha=s.alpha[rows].copy(),
                sample_clock=s.sample_clock[rows].copy(),
                received_power=s.received_power[rows].copy(),
                noise_density=s.noise_density[rows].copy(),
                temperature=s.temperature[rows].copy(),
                modulations=tuple(dataclasses.replace(x, phase=x.phase[rows].copy()) for x in s.modulations),
                responses=tuple(Response(x.time, x.log_amplitude[rows], x.phase[rows]) for x in s.responses),
            )
            for s in self.stations
        )
        paths = [path.rows(rows) for path in self.paths]
        return dataclasses.replace(
            self,
            stations=stations,
            paths=paths,
            initial_phase=self.initial_phase[:, rows].copy(),
            sweep_id=self.sweep_id[rows].copy(),
            time=self.time[rows].copy(),
            range=self.range[rows].copy(),
            velocity=self.velocity[rows].copy(),
            start_delay=self.start_delay[rows].copy(),
            refractive_index=_each(self.refractive_index, len(self))[rows].copy(),
            setting=_each(self.setting, len(self))[rows].copy(),
        )


def _each(values: np.ndarray | float, count: int) -> np.ndarray:
    """Return values of `count` measurements, which one number may stand for."""
    return np.asarray(values) if np.ndim(values) else np.full(count, values)
