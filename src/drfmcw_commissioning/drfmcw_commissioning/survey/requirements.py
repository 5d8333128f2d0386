"""What a customer requires of a site, declared once: keys of the requirement file, their units and their meaning."""

import dataclasses
import math

from drfmcw_physics.settings import ConfigurationError, from_mapping, parameter, read_yaml

_NOT_REQUIRED = 'not required'


@dataclasses.dataclass(frozen=True)
class Requirements:
    """What the ranges of every pair must fulfil on the whole travel. NaN: not required."""

    accuracy: float = parameter(
        0.02,
        unit='m',
        bounds=(1e-6, 1e3),
        nan_means=_NOT_REQUIRED,
        description='error against the reference that `accuracy_share` of the usable ranges stay within',
    )
    accuracy_share: float = parameter(0.997, bounds=(0.5, 1.0), description='share of ranges within `accuracy`')
    bias: float = parameter(
        0.01,
        unit='m',
        bounds=(1e-6, 1e3),
        nan_means=_NOT_REQUIRED,
        description='largest mean error of a distance bin',
    )
    rate: float = parameter(
        10.0,
        unit='Hz',
        bounds=(1e-3, 1e5),
        nan_means=_NOT_REQUIRED,
        description='usable ranges in each second of measuring',
    )
    availability: float = parameter(
        0.999, bounds=(0.0, 1.0), nan_means=_NOT_REQUIRED, description='share of the sweeps with a usable range'
    )
    longest_gap: float = parameter(
        1.0,
        unit='s',
        bounds=(1e-3, 1e5),
        nan_means=_NOT_REQUIRED,
        description='longest time without a usable range while sweeps go on',
    )
    fading_margin: float = parameter(
        10.0,
        unit='dB',
        bounds=(-50.0, 100.0),
        nan_means=_NOT_REQUIRED,
        description='of each distance bin: what the weaker line has above detection in 99 % of the sweeps',
    )
    disturbed: float = parameter(
        0.01,
        bounds=(0.0, 1.0),
        nan_means=_NOT_REQUIRED,
        description='largest share of sweeps with bursts or a second line, in a distance bin',
    )
    clock_difference: float = parameter(
        5.0,
        unit='ppm',
        bounds=(0.0, 1e3),
        nan_means=_NOT_REQUIRED,
        description="difference of the stations' references that their calibrations do not explain",
    )
    board_temperature: float = parameter(
        40.0,
        unit='K',
        bounds=(0.0, 300.0),
        nan_means=_NOT_REQUIRED,
        description="largest distance of a board's temperature from that of its calibration; where the calibration "
        'states a range, the board must be within it instead',
    )
    wrong: float = parameter(
        0.0,
        bounds=(0.0, 1.0),
        nan_means=_NOT_REQUIRED,
        description='largest share of usable ranges whose error exceeds the protection level and three standard '
        'deviations of the reference',
    )
    travel_begin: float = parameter(
        math.nan,
        unit='m',
        bounds=(0.0, 1e6),
        nan_means='the shortest recorded distance',
        description='shortest distance of the travel',
    )
    travel_end: float = parameter(
        math.nan,
        unit='m',
        bounds=(0.0, 1e6),
        nan_means='the longest recorded distance',
        description='longest distance of the travel',
    )
    coverage: float = parameter(
        0.9,
        bounds=(0.0, 1.0),
        nan_means=_NOT_REQUIRED,
        description='share of the travel that lies in distance bins with at least `bin_count` usable ranges',
    )
    bin_width: float = parameter(25.0, unit='m', bounds=(0.1, 1e5), description='width of a distance bin')
    bin_count: int = parameter(20, bounds=(1, 1_000_000), description='usable ranges that a bin needs to be judged')

    def __post_init__(self) -> None:
        """Refuse a travel that ends before it begins."""
        if self.travel_end <= self.travel_begin:
            raise ConfigurationError(
                f'travel_end = {self.travel_end:g} m is not beyond travel_begin = {self.travel_begin:g} m'
            )


def read_requirements(path: str) -> Requirements:
    """Return the requirements in a YAML file.

    Raises:
        ConfigurationError: it cannot be read, or a key or value is wrong.
    """
    return from_mapping(Requirements, read_yaml(path), path)
