"""Nominal measurements of a pair: sweep settings, calibrations, weather and distance, without any effect.

The simulator applies its effects to them; the diagnosis compares recordings with them.
"""

from collections.abc import Sequence

import numpy as np

from drfmcw_physics.constants import SPEED_OF_LIGHT
from drfmcw_physics.link_budget import received_power
from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.phase_noise import PhaseNoise
from drfmcw_physics.sweep import SweepSettings

from .measurements import Measurements, Path, Station

NEAREST = 0.1
"""Distance below which the received power does not grow any more [m]."""


def link_budget(sweep: SweepSettings, peer: SweepSettings, distance: np.ndarray) -> np.ndarray:
    """Return the power of `peer` at the antenna port of `sweep`'s station in free space, shape of `distance` [dBm]."""
    distance = np.maximum(distance, NEAREST)
    return received_power(peer.tx_eirp, sweep.rx_antenna_gain, distance, sweep.center_frequency)


def nominal_measurements(
    sweeps: Sequence[SweepSettings],
    calibrations: Sequence[Calibration],
    powers: Sequence[np.ndarray],
    temperatures: Sequence[np.ndarray],
    full_scales: Sequence[float],
    iq: bool,
    sweep_id: np.ndarray,
    time: np.ndarray,
    distance: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
    refractive_index: np.ndarray,
    setting: np.ndarray,
) -> Measurements:
    """Return n measurements of one pair with one set of sweep settings, without effects and without scatter.

    Args:
        sweeps: settings of the first and the second station, or of the one that hears itself.
        calibrations: of the same stations, with their curves over the board temperature; without noise floor the noise
            is NaN, without phase noise there is none.
        powers: received by each, (n,) [dBm].
        temperatures: of their boards, (n,) [degC].
        full_scales: of their ADCs [LSB].
        iq: quadrature receivers.
        sweep_id: (n,).
        time: of the first station's sweep start since the recording's start, (n,) [s].
        distance: (n,) [m].
        velocity: (n,) [m/s].
        acceleration: (n,) [m/s^2].
        refractive_index: of the air, (n,).
        setting: number of the distance at which the crane stands, (n,).
    """
    n = len(sweep_id)
    slowness = refractive_index / SPEED_OF_LIGHT
    hardware = sum(c.delay_at(t) for c, t in zip(calibrations, temperatures, strict=True))
    direct = Path(hardware + distance * slowness, velocity * slowness, acceleration * slowness, np.ones(n))
    stations = []
    for sweep, calibration, power, temperature, full_scale in zip(
        sweeps, calibrations, powers, temperatures, full_scales, strict=True
    ):
        noise = PhaseNoise(calibration.phase_noise_level, calibration.phase_noise_corner)
        stations.append(
            Station(
                sweep=sweep,
                alpha=np.broadcast_to(calibration.alpha_at(temperature), n).copy(),
                sample_clock=np.broadcast_to(calibration.sample_clock_at(temperature), n).copy(),
                received_power=power,
                noise_density=np.full(n, calibration.noise_floor),
                phase_noise=noise if noise.known else None,
                temperature=temperature,
                calibration_temperature=calibration.temperature,
                full_scale=full_scale,
                iq=iq,
            )
        )
    return Measurements(
        stations=tuple(stations),
        sweep_id=sweep_id,
        time=time,
        range=distance,
        velocity=velocity,
        start_delay=np.full(n, sweeps[0].start_delay),
        initial_phase=np.zeros((len(stations), n)),
        paths=[direct],
        refractive_index=refractive_index,
        setting=setting,
    )
