"""Settings of the fusion of two stations' beat frequencies."""

import dataclasses

from drfmcw_physics import air
from drfmcw_physics.settings import ConfigurationError, parameter


@dataclasses.dataclass(frozen=True)
class FusionSettings:
    """How beat frequencies become ranges; each field is a ROS parameter and a key of the site file."""

    pair_time_limit: float = parameter(
        1.0, unit='s', bounds=(1e-3, 60.0), description='how long a result waits for its partner of the same sweep'
    )
    alpha_correction: bool = parameter(True, description="correct for the stations' reference clocks (eq. 19)")
    atmosphere: str = parameter(
        'itu_r_p453', choices=(*air.MODELS, 'vacuum'), description='model of the refractive index of air'
    )
    default_temperature: float = parameter(
        15.0, unit='degC', bounds=(-80.0, 80.0), description='air temperature until a reading arrives'
    )
    default_pressure: float = parameter(
        101325.0, unit='Pa', bounds=(3e4, 1.2e5), description='air pressure until a reading arrives'
    )
    default_humidity: float = parameter(0.5, bounds=(0.0, 1.0), description='relative humidity until a reading arrives')
    environment_time_limit: float = parameter(
        900.0, unit='s', bounds=(1.0, 1e6), description='age beyond which a weather reading counts as stale'
    )
    calibration_temperature_limit: float = parameter(
        40.0,
        unit='K',
        bounds=(0.0, 200.0),
        description='distance of the board temperature from that of the calibration beyond which it counts as stale',
    )
    minimum_range: float = parameter(0.0, unit='m', bounds=(-10.0, 1e6), description='shortest valid range')
    maximum_range: float = parameter(2000.0, unit='m', bounds=(1.0, 1e7), description='longest valid range')
    velocity: str = parameter(
        'tracked',
        choices=('tracked', 'standing'),
        description="'tracked' estimates the velocity and corrects its Doppler shift, 'standing' assumes none",
    )
    maximum_velocity: float = parameter(
        10.0,
        unit='m/s',
        bounds=(1e-3, 1e4),
        description='a faster range rate is a jump, after which tracking starts anew',
    )
    maximum_acceleration: float = parameter(
        0.3, unit='m/s^2', bounds=(1e-3, 100.0), description='what the crane can accelerate; decides how phases unwrap'
    )

    def __post_init__(self) -> None:
        """Refuse limits that exclude each other."""
        if self.minimum_range >= self.maximum_range:
            raise ConfigurationError(
                f'minimum_range = {self.minimum_range:g} m is not below maximum_range = {self.maximum_range:g} m'
            )
