"""What each part of a calibration contributes to the uncertainty of a range, as a table."""

import dataclasses
import math
from collections.abc import Sequence

from drfmcw_fusion.combination import PathDelay, Station
from drfmcw_fusion.uncertainty import UNKNOWN, Contributions, Weather, contributions
from drfmcw_node.processing.records import Beat
from drfmcw_physics.air import MODELS, refractive_index
from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.sweep import Mode, Role, SweepSettings, beat_frequency

DISTANCES = (100.0, 1000.0)
"""Of the table in docs/sensors_and_flags.md [m]."""

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
    ]


def contribution(part: Part, distance: float) -> Contributions:
    """Return what a part contributes to a range of a pair at a distance [m]."""
    mode, late = (Mode.LONG_DISTANCE, 0.6e-6) if distance > _LIMIT else (Mode.SHORT_DISTANCE, 3.41e-6)
    air = part.weather
    delay = distance * float(refractive_index(air.temperature, air.pressure, air.humidity)) / SPEED_OF_LIGHT
    stations = []
    for role, own, peer in ((Role.FIRST, 'a', 'b'), (Role.SECOND, 'b', 'a')):
        sweep = SweepSettings(own, peer, role=role, mode=mode, start_delay=late)
        beat = Beat(own, peer, 0, 0, beat_frequency(sweep, delay, 1.0, 1.0), 1.0, 0.0, -60.0, 40.0, 0)
        stations.append(Station(beat, sweep, dataclasses.replace(part.calibration, station=own)))
    first, second = stations
    path = PathDelay(delay, delay, 0.0, math.nan, 0.0, first.sweep.center_frequency, math.nan)
    return contributions(first, second, path, part.weather, MODELS[0])


def table(distances: Sequence[float]) -> str:
    """Return the parts and what each contributes as a Markdown table."""
    lines = [
        '| known to | ' + ' | '.join(f'at {d:g} m [mm]' for d in distances) + ' |',
        '| - |' + ' -: |' * len(distances),
    ]
    for part in parts():
        cells = [f'{1e3 * contribution(part, distance).total:.2g}' for distance in distances]
        lines.append(f'| {part.name} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)
