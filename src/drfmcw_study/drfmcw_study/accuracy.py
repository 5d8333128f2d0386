"""How near the chain comes to the Cramer-Rao bound: cells of distance, mode, reference difference and noise floor."""

import dataclasses
import itertools
import math
from collections.abc import Iterator

import numpy as np

from drfmcw_node.estimators.estimation import EstimatorSettings
from drfmcw_node.estimators.noise import QUANTISATION
from drfmcw_physics.air import refractive_index
from drfmcw_physics.bounds import LineNoise, coloured_bound
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.settings import ConfigurationError
from drfmcw_physics.sweep import Mode, SweepSettings
from drfmcw_sim.scenario import Scenario, scenario_from_mapping

from .measurement import conditions, measure

FLOORS = {'A': -97.7, 'B': -80.6}
"""Noise floors within Table 1's IF band [dBm] (16 dB and 33 dB noise figure)."""

DISTANCES = (15.0, 50.0, 200.0, 500.0, 1000.0)
"""Distances of the grid [m]."""

DIFFERENCES = (0.0, 2.0, 20.0, -20.0, 40.0, -40.0)
"""Reference of station 1 over that of station 2 [ppm]."""

_PHASE_NOISE = PhaseNoise(-90.0, 200e3)
_MARGIN = 12  # bins that both lines keep from DC and Nyquist, two more than what is flagged


@dataclasses.dataclass(frozen=True)
class Accuracy:
    """Result of one cell."""

    trials: int
    std: float  # of the range [m]
    bias: float  # mean range error [m]
    chi_square: float  # mean squared error over reported variance [1]
    bound: float  # smallest standard deviation an unbiased estimator can have [m]
    carrier_std: float  # of the range by both stations' carrier phases, its ambiguity known [m]
    carrier_bound: float  # smallest possible one [m]
    flagged: float  # share of ranges with a flag [1]


@dataclasses.dataclass(frozen=True)
class Cell:
    """One condition of Table 1's waveform: 14-bit ADC, calibrated references, start delays with 2 ns of jitter."""

    floor: str  # key of FLOORS
    distance: float  # [m]
    mode: Mode
    difference: float  # of the references [ppm]

    def __str__(self) -> str:
        """Return a short name."""
        return f'{self.floor} {self.distance:g} m {self.mode.short_name} {self.difference:+g} ppm'

    def scenario(self, seed: int = 5) -> Scenario:
        """Return the condition as scenario; equal amplitudes, so that one bound holds for all sweeps."""
        band = SweepSettings('', '').sample_rate / 2
        station = {
            'noise_floor': FLOORS[self.floor] - 10.0 * math.log10(band),
            'phase_noise_level': _PHASE_NOISE.level,
            'phase_noise_corner': _PHASE_NOISE.corner,
        }
        return scenario_from_mapping(
            {
                'stations': {'master': station | {'alpha': 1.0 + self.difference * 1e-6}, 'slave': dict(station)},
                'pairs': [{'first': 'master', 'second': 'slave', 'standing': {'distances': [self.distance]}}],
                'timing': {'amplitude_scatter': 0.0},
                'seed': seed,
            },
            str(self),
        )

    def lines(self) -> tuple[float, float] | None:
        """Return both beat frequencies [Hz], None where they do not lie within the band as the mode wants them."""
        scenario = self.scenario()
        first, second = conditions(scenario, range(1), self.mode).stations
        sweep, band = first.sweep, first.sweep.sample_rate / 2
        delay = self._delay(scenario)
        common = 1e-6 * self.difference * (sweep.start_frequency + sweep.bandwidth / 2)
        k = sweep.chirp_rate
        one = common + k * (sweep.start_delay + delay)
        two = second.sweep.line_sign() * (common + k * (sweep.start_delay - delay))
        margin = _MARGIN / sweep.ramp_duration
        usual = delay < sweep.start_delay if self.mode == Mode.SHORT_DISTANCE else delay > sweep.start_delay
        inside = all(margin <= f <= band - margin for f in (one, two))
        return (one, two) if usual and inside else None

    def bound(self) -> tuple[float, float]:
        """Return the smallest standard deviation of the range by beat frequencies and by carrier phases [m].

        Quantisation counts as additive noise.

        Raises:
            ConfigurationError: a line lies outside the IF band, so that nothing can be measured.
        """
        frequencies = self.lines()
        if frequencies is None:
            raise ConfigurationError(f'{self}: a line lies outside the IF band')
        scenario = self.scenario()
        m = conditions(scenario, range(1), self.mode)
        sweep, delay = m.stations[0].sweep, self._delay(scenario)
        lines = []
        for station, frequency in zip(m.stations, frequencies, strict=True):
            variance = float(station.noise_std()[0]) ** 2 + QUANTISATION
            power = float(station.amplitude(station.received_power)[0]) ** 2 / 2.0
            carrier_to_noise = power / variance * sweep.sample_rate / 2.0
            lines.append(LineNoise(carrier_to_noise, frequency, sweep.sample_rate))
        duration = sweep.ramp_duration - max(sweep.start_delay + delay, 0.0)
        best = coloured_bound(tuple(lines), (_PHASE_NOISE, _PHASE_NOISE), duration, delay)
        velocity = SPEED_OF_LIGHT / self._index(scenario)
        by_phase = best.phase / (4.0 * math.pi * sweep.center_frequency) * velocity
        return best.frequency / (2.0 * sweep.chirp_rate) * velocity, by_phase

    def measure(self, estimator: str, sweeps: range) -> Accuracy:
        """Return what an estimator makes of simulated sweeps.

        Args:
            estimator: name, as `EstimatorSettings.estimator`.
            sweeps: sweep numbers.
        """
        scenario = self.scenario()
        trials = measure(scenario, sweeps, mode=self.mode, estimator=EstimatorSettings(estimator=estimator))
        error = trials.error
        phase = trials.carrier_phase - trials.carrier_phase[0]
        turned = np.angle(np.exp(1j * (phase - np.angle(np.exp(1j * phase).mean()))))
        bound, carrier_bound = self.bound()
        center_frequency = conditions(scenario, range(1), self.mode).stations[0].sweep.center_frequency
        half_wave = SPEED_OF_LIGHT / self._index(scenario) / (2.0 * center_frequency)
        return Accuracy(
            trials=len(error),
            std=float(error.std(ddof=1)),
            bias=float(error.mean()),
            chi_square=float(np.mean((error / trials.range_std) ** 2)),
            bound=bound,
            carrier_std=float(turned.std(ddof=1)) / (2.0 * math.pi) * half_wave,
            carrier_bound=carrier_bound,
            flagged=float(np.mean(trials.flags != 0)),
        )

    def _index(self, scenario: Scenario) -> float:
        weather = scenario.weather
        return float(refractive_index(weather.temperature.at(0.0), weather.pressure.at(0.0), weather.humidity.at(0.0)))

    def _delay(self, scenario: Scenario) -> float:
        return self.distance * self._index(scenario) / SPEED_OF_LIGHT


def grid() -> Iterator[Cell]:
    """Yield all cells whose lines lie within the band."""
    cells = (Cell(*values) for values in itertools.product(FLOORS, DISTANCES, Mode, DIFFERENCES))
    return (cell for cell in cells if cell.lines() is not None)


def left_out() -> list[str]:
    """Return the names of the conditions that `grid` leaves out at any noise floor."""
    cells = (Cell('A', *values) for values in itertools.product(DISTANCES, Mode, DIFFERENCES))
    return [str(cell)[2:] for cell in cells if cell.lines() is None]
