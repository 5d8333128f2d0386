"""Simulated measurements of one pair through the whole chain: IF samples, beat frequencies, ranges.

Free of ROS. A standing crane is measured again and again under the conditions of a scenario; the classes are those of
the simulator, the station node and the fusion node, so that what is found here holds for them.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from drfmcw_fusion.pipeline import RangeFusion, RangeResult
from drfmcw_fusion.settings import FusionSettings
from drfmcw_node.estimators.estimation import Estimates, EstimatorSettings
from drfmcw_node.estimators.pair import pair_estimator
from drfmcw_node.estimators.registry import estimator as make_estimator
from drfmcw_node.processing.records import Beat
from drfmcw_physics.air import refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.sweep import Mode, beat_frequency
from drfmcw_sim.measurements import Measurements
from drfmcw_sim.scenario import Scenario
from drfmcw_sim.synthesis.signal_model import draw_sweeps, synthesise
from drfmcw_sim.timeline import NANOSECONDS, Slots, Timeline

_WEATHER = ('temperature', 'pressure', 'humidity')
_SHARED_FIELDS = ('flags', 'frequency', 'frequency_std', 'phase', 'power', 'snr')  # of Estimates and Beat, in order


@dataclasses.dataclass(frozen=True)
class Trials:
    """Results of n measurements; arrays of shape (n,)."""

    sweep_id: np.ndarray
    true_range: np.ndarray  # antenna distance [m]
    range: np.ndarray  # estimated [m]
    range_std: np.ndarray  # one standard deviation as reported with the range [m]
    flags: np.ndarray  # of the range, bits of drfmcw_fusion.pipeline.Flag
    carrier_phase: np.ndarray  # sum of both stations' phases; 2 pi per half wavelength, NaN where not defined [rad]
    stations: tuple[Estimates, ...]  # of the first and the second station (of one, where it hears itself)
    synchronised_range: np.ndarray | None = None  # of station 2 alone, see `measure`; None where not asked for [m]

    def __len__(self) -> int:
        """Return the number of measurements."""
        return len(self.range)

    @property
    def error(self) -> np.ndarray:
        """Range minus true range [m]."""
        return self.range - self.true_range


def measure(
    scenario: Scenario,
    sweeps: range,
    *,
    mode: Mode,
    start_delay: float | None = None,
    estimator: EstimatorSettings | None = None,
    fusion: FusionSettings | None = None,
    synchronised: bool = False,
) -> Trials:
    """Simulate and evaluate measurements of the scenario's first pair.

    The crane stands where the trajectory begins. Sweep i happens at i times the scenario's sweep interval, with the
    noise, start delay, initial phases and amplitude of that sweep number; weather profiles and effects act as in the
    simulator. Its result depends on the scenario and on i only, whatever other sweeps are asked for.

    Args:
        scenario: what to simulate.
        sweeps: sweep numbers.
        mode: measurement mode, whatever the distance.
        start_delay: T_off [s]; None takes the scenario's for the mode.
        estimator: of the beat frequencies; None takes the defaults.
        fusion: None takes the defaults. The velocity is zero, the weather the true one.
        synchronised: also find the range of the "synchronised single-station" approach, which knows T_off of each
            sweep, both clocks and the air perfectly: R = c (T_off -/+ f_IF,2 / k) of station 2 alone (eqs. 2 and 4).

    Raises:
        ConfigurationError: settings that exclude each other.
    """
    estimator = estimator or EstimatorSettings()
    fusion = dataclasses.replace(fusion or FusionSettings(), velocity='standing')
    m = conditions(scenario, sweeps, mode, start_delay)
    samples = synthesise(m, scenario.seed, scenario.effects)
    estimates = station_estimates(scenario, m, samples, estimator)
    results = _ranges(scenario, m, estimates, fusion)
    return Trials(
        sweep_id=m.sweep_id,
        true_range=m.range,
        range=np.array([r.range for r in results]),
        range_std=np.array([r.range_std for r in results]),
        flags=np.array([r.flags for r in results], dtype=np.uint8),
        carrier_phase=np.array([r.carrier_phase for r in results]),
        stations=estimates,
        synchronised_range=_synchronised_range(scenario, m, estimates[1]) if synchronised else None,
    )


def conditions(scenario: Scenario, sweeps: range, mode: Mode, start_delay: float | None = None) -> Measurements:
    """Return what determines the IF signals of the first pair's measurements; arguments as for `measure`."""
    timeline = Timeline(scenario)
    timeline.change_mode(0, mode, start_delay)
    sweep_id = np.arange(sweeps.start, sweeps.stop, sweeps.step)
    n = len(sweep_id)
    distance, _, _ = scenario.pairs[0].trajectory.state(np.zeros(1, int), np.zeros(1))
    slots = Slots(
        sweep_id=sweep_id,
        time=sweep_id * scenario.timing.sweep_interval,
        pair=np.zeros(n, int),
        distance=np.full(n, distance[0]),
        velocity=np.zeros(n),
        acceleration=np.zeros(n),
    )
    return timeline.measurements(slots, 0)


def station_estimates(
    scenario: Scenario, m: Measurements, samples: Sequence[np.ndarray], settings: EstimatorSettings
) -> tuple[Estimates, ...]:
    """Return what each station estimates, alone or with its peer as set; both calibrations are known."""
    if settings.estimator == 'pair' and len(m.stations) == 2:
        first, second = m.stations
        pair = pair_estimator(
            first.sweep,
            second.sweep,
            settings,
            first.iq,
            scenario.calibration(first.name),
            scenario.calibration(second.name),
        )
        return pair(samples[0], samples[1], (first.full_scale, second.full_scale))
    return tuple(
        make_estimator(
            station.sweep,
            settings,
            station.iq,
            scenario.calibration(station.sweep.station),
            scenario.calibration(station.sweep.peer),
        )(codes, station.full_scale)
        for station, codes in zip(m.stations, samples, strict=True)
    )


def _ranges(
    scenario: Scenario, m: Measurements, estimates: Sequence[Estimates], settings: FusionSettings
) -> list[RangeResult]:
    """Return the range of each measurement, from `RangeFusion` with the true weather."""
    fusion = RangeFusion(settings)
    start = round(scenario.timing.start_time * NANOSECONDS)
    stamps = [start + round(t * NANOSECONDS) for t in m.time.tolist()]
    for quantity in _WEATHER:
        _on_change(stamps, getattr(scenario.weather, quantity).at(m.time), fusion.add_weather, quantity)
    beats: list[list[Beat]] = []
    for station, result in zip(m.stations, estimates, strict=True):
        sweep = station.sweep
        fusion.add_sweep_config(sweep)
        fusion.add_calibration(scenario.calibration(sweep.station))
        _on_change(stamps, station.temperature, fusion.add_board_temperature, sweep.station)
        late = round((sweep.start_delay if beats else 0.0) * NANOSECONDS)
        columns = [getattr(result, name).tolist() for name in _SHARED_FIELDS]
        rows = zip(
            m.sweep_id.tolist(), stamps, result.independent_std.tolist(), zip(*columns, strict=True), strict=True
        )
        own = []
        for sweep_id, stamp, independent, (flags, frequency, frequency_std, phase, power, snr) in rows:
            numbers = flags, frequency, frequency_std, phase, power, snr, stamp + late
            about = sweep.frame_id, independent, result.window
            own.append(Beat(sweep.station, sweep.peer, sweep_id, *numbers, *about))
        beats.append(own)
    found = (fusion.add_beat(beat) for measured in zip(*beats, strict=True) for beat in measured)
    return [result for result in found if result is not None]


def _on_change(stamps: Sequence[int], values: np.ndarray, add: Callable[[str, int, float], None], name: str) -> None:
    """Call ``add(name, stamp, value)`` for the first value and for each that differs from the one before."""
    changes = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    for row in changes.tolist():
        add(name, stamps[row], float(values[row]))


def _synchronised_range(scenario: Scenario, m: Measurements, estimates: Estimates) -> np.ndarray:
    """Return the range that station 2 alone gives with everything but the delay known [m], as `measure` says.

    The line is linear in the delay, so its distance from the line expected at the true range gives the delay exactly.
    """
    first, second = m.stations
    drawn = m.rows(slice(None))
    draw_sweeps(drawn, scenario.seed)
    weather = [getattr(scenario.weather, quantity).at(m.time) for quantity in _WEATHER]
    slowness = refractive_index(*weather) / SPEED_OF_LIGHT
    a1, a2 = (scenario.calibration(s.name).alpha for s in m.stations)
    clock = scenario.calibration(second.name).sample_clock_alpha
    sign = second.sweep.line_sign()
    slope = second.sweep.chirp_rate * a1**2  # d f / d T_off and -d f / d tau (eqs. 16, 17)
    expected = np.array([sign * beat_frequency(second.sweep, tau, a2, a1) for tau in m.paths[0].delay])
    expected += a1 * (first.sweep.start_frequency - second.sweep.start_frequency)
    expected += slope * (drawn.start_delay - second.sweep.start_delay)
    return m.range - (sign * clock * estimates.frequency - expected) / slope / slowness
