"""Settings of the integrity monitor."""

import dataclasses

from drfmcw_physics.settings import parameter


@dataclasses.dataclass(frozen=True)
class IntegritySettings:
    """What the site's hardware and crane do when all is well; each field is a ROS parameter."""

    monitor: bool = parameter(True, description='test every range; false leaves only the flags of the stations')
    start_delay_tolerance: float = parameter(
        10e-9, unit='s', bounds=(1e-12, 1e-3), description='how far T_off strays from its nominal value'
    )
    clock_tolerance: float = parameter(
        15.0,
        unit='ppm',
        bounds=(0.0, 1000.0),
        description='difference of the references, beyond their calibrations, that is doubted and not refused',
    )
    gain_tolerance: float = parameter(
        8.0, unit='dB', bounds=(0.0, 200.0), description='received power above that of free space that is refused'
    )
    loss_tolerance: float = parameter(
        30.0, unit='dB', bounds=(0.0, 200.0), description='received power below that of free space that is refused'
    )
    balance_tolerance: float = parameter(
        2.5,
        unit='dB',
        bounds=(0.1, 200.0),
        description='difference of both powers that is doubted; twice it is refused',
    )
    noise_tolerance: float = parameter(
        10.0, unit='dB', bounds=(0.1, 200.0), description='noise above the calibrated floor that is doubted'
    )
    restart_pause: float = parameter(
        5.0, unit='s', bounds=(0.1, 1e5), description='without sweeps, after which the distance may be any'
    )
    shorter_time: float = parameter(
        2.0,
        unit='s',
        bounds=(0.0, 1e5),
        description='after which a steady range shorter than the tracked one is taken for the direct path',
    )
    longer_time: float = parameter(
        30.0,
        unit='s',
        bounds=(0.0, 1e5),
        description='after which a steady range longer than the tracked one is followed, in doubt; 0: never',
    )
