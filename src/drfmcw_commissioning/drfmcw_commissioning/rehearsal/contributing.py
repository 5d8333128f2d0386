"""What parts of a calibration, and noise, contribute to the uncertainty of a range, as a table."""

import dataclasses
import math
from collections.abc import Sequence

from drfmcw_fusion.combination import PathDelay, Station
from drfmcw_fusion.uncertainty import UNKNOWN, Weather, contributions
from drfmcw_node.estimators.noise import QUANTISATION
from drfmcw_node.processing.records import Beat
from drfmcw_physics.air import MODELS, refractive_index
from drfmcw_physics.bounds import LineNoise, coloured_bound
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.link_budget import received_power
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.sweep import Mode, Role, SweepSettings, beat_frequency

from ..indoors.noise import density

DISTANCES = (100.0, 1000.0)
"""Of the table in docs/sensors_and_flags.md [m]."""

_PHASE_NOISE = PhaseNoise(-90.0, 200e3)
_FULL_SCALE = 8192.0  # of the 14-bit ADC [LSB]
_LIMIT = 650.0  # beyond which stations measure in the long-distance mode, as ModeSettings [m]


@dataclasses.dataclass(frozen=True)
class Part:
    """One part of what is not known, at both stations alike."""

    name: str
    calibration: Calibration
    weather: Weather


def parts() -> list[Part]:
    """Return the parts of the table: a good calibration, and what is often met instead."""
    air, none = Weather(15.0, 101325.0, 0.5), Calibration('')
    return [
        Part('reference clocks, 0.02 ppm each', Calibration('', alpha_std=2e-8), air),
        Part('reference clocks, 1 ppm each (no curve over the temperature)', Calibration('', alpha_std=1e-6), air),
        Part('ADC clocks, 0.02 ppm each', Calibration('', sample_clock_alpha_std=2e-8), air),
        Part('ADC clocks, 1 ppm each', Calibration('', sample_clock_alpha_std=1e-6), air),
        Part('hardware delay, cable known to 5 mm', Calibration('', delay_std=5e-3 / SPEED_OF_LIGHT / 2**0.5), air),
        Part('air temperature, 0.2 K', none, dataclasses.replace(air, temperature_std=0.2)),
        Part('air pressure, 20 Pa', none, dataclasses.replace(air, pressure_std=20.0)),
        Part('humidity, 1 %', none, dataclasses.replace(air, humidity_std=0.01)),
        Part(
            'no weather sensors at all',
            none,
            dataclasses.replace(air, **{f'{name}_std': std for name, std in UNKNOWN.items()}),
        ),
        *(
            Part(f'noise of one sweep, {floor:g} dBm/Hz and {_PHASE_NOISE.level:g} dBc/Hz (averages)',
                 Calibration('', noise_floor=floor, phase_noise_level=_PHASE_NOISE.level,
                             phase_noise_corner=_PHASE_NOISE.corner), air)
            for floor in (-157.8, -140.7)
        ),
    ]  # fmt: skip


def contribution(part: Part, distance: float) -> float:
    """Return what a part contributes to a range of a pair at a distance, one standard deviation [m]."""
    first, second, path = _pair(part, distance)
    constant = contributions(first, second, path, part.weather, MODELS[0]).total
    return math.hypot(constant, _noise(first, second, path, distance))


def _pair(part: Part, distance: float) -> tuple[Station, Station, PathDelay]:
    """Return two stations at a distance [m], and the path between them."""
    mode, late = (Mode.LONG_DISTANCE, 0.6e-6) if distance > _LIMIT else (Mode.SHORT_DISTANCE, 3.41e-6)
    air = part.weather
    delay = distance * float(refractive_index(air.temperature, air.pressure, air.humidity)) / SPEED_OF_LIGHT
    stations = []
    for role, own, peer in ((Role.FIRST, 'a', 'b'), (Role.SECOND, 'b', 'a')):
        sweep = SweepSettings(own, peer, role=role, mode=mode, start_delay=late)
        beat = Beat(own, peer, 0, 0, beat_frequency(sweep, delay, 1.0, 1.0), 1.0, 0.0, -60.0, 40.0, 0)
        stations.append(Station(beat, sweep, dataclasses.replace(part.calibration, station=own)))
    first, second = stations
    return first, second, PathDelay(delay, delay, 0.0, math.nan, 0.0, first.sweep.center_frequency, math.nan)


def _noise(first: Station, second: Station, path: PathDelay, distance: float) -> float:
    """Return the smallest standard deviation of a range that noise lets a sweep have, 0 where none is stated [m].

    The ADC's rounding counts as additive noise; of the oscillators' noise, what the combination leaves.
    """
    if not math.isfinite(first.calibration.noise_floor):
        return 0.0
    lines, noises = [], []
    for own, peer in ((first, second), (second, first)):
        sweep, calibration = own.sweep, own.calibration
        power = received_power(peer.sweep.tx_eirp, sweep.rx_antenna_gain, distance, sweep.center_frequency)
        levels = (calibration.noise_floor, density(sweep, _FULL_SCALE, QUANTISATION, False))
        noise = sum(10.0 ** (level / 10.0) for level in levels)
        lines.append(LineNoise(10.0 ** (power / 10.0) / noise, own.beat.frequency, sweep.sample_rate))
        noises.append(PhaseNoise(calibration.phase_noise_level, calibration.phase_noise_corner))
    sweep = first.sweep
    bound = coloured_bound(
        tuple(lines), tuple(noises), sweep.ramp_duration - sweep.start_delay - path.delay, path.delay
    )
    return bound.frequency / (2.0 * abs(sweep.chirp_rate)) * distance / path.delay


def table(distances: Sequence[float]) -> str:
    """Return the parts and what each contributes as a Markdown table."""
    lines = [
        '| known to | ' + ' | '.join(f'at {d:g} m [mm]' for d in distances) + ' |',
        '| - |' + ' -: |' * len(distances),
    ]
    for part in parts():
        cells = [f'{1e3 * contribution(part, distance):.2g}' for distance in distances]
        lines.append(f'| {part.name} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)
