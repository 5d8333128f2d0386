"""Writes a scene as a recording of the measured topics, and seals what it conceals."""

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_ros.bag.files import BagWriter, typestore

from .model import FIRST, SECOND, Scene, chunks, render_chunk

_BEGIN = 1_700_000_000_000_000_000  # stamp of the first sweep [ns]
_NANOSECONDS = 1_000_000_000


class SealError(ValueError):
    """A truth that is not the one that was sealed."""


@dataclasses.dataclass(frozen=True)
class Seal:
    """What may be known of a truth before the tool has spoken."""

    path: Path
    sha256: str


def seal(truth: dict[str, Any], path: Path | str) -> Seal:
    """Write a truth, canonical JSON, and return its seal; equal truths have equal bytes."""
    path = Path(path)
    data = (json.dumps(truth, sort_keys=True, indent=1, allow_nan=False) + '\n').encode()
    partial = path.with_name(f'.{path.name}.partial-{os.getpid()}')
    path.parent.mkdir(parents=True, exist_ok=True)
    partial.write_bytes(data)
    partial.rename(path)
    return Seal(path, hashlib.sha256(data).hexdigest())


def open_seal(seal: Seal) -> dict[str, Any]:
    """Return the truth.

    Raises:
        SealError: the file is not what was sealed.
    """
    data = seal.path.read_bytes()
    found = hashlib.sha256(data).hexdigest()
    if found != seal.sha256:
        raise SealError(f'{seal.path}: SHA-256 is {found}, sealed was {seal.sha256}')
    return json.loads(data)


_NOT_STATED: dict[str, Any] = {
    **dict.fromkeys(('alpha_std', 'sample_clock_alpha_std', 'delay_std', 'delay_slope'), 0.0),
    **dict.fromkeys((f'alpha_{order}' for order in ('linear', 'quadratic', 'cubic')), 0.0),
    **dict.fromkeys((f'sample_clock_{order}' for order in ('linear', 'quadratic', 'cubic')), 0.0),
    **dict.fromkeys(('temperature_low', 'temperature_high'), 0.0),
    'delay_peer': '',
    'version': 0,
}
"""Fields of StationCalibration that the generator's stations leave open."""


class _Messages:
    """Messages of rosbags by short names."""

    def __init__(self, bag: BagWriter) -> None:
        self._bag, self._types = bag, typestore().types

    def header(self, stamp: int, frame: str) -> Any:
        seconds, nanoseconds = divmod(stamp, _NANOSECONDS)
        time = self._types['builtin_interfaces/msg/Time'](sec=seconds, nanosec=nanoseconds)
        return self._types['std_msgs/msg/Header'](stamp=time, frame_id=frame)

    def write(self, topic: str, kind: str, stamp: int, frame: str, received: int | None = None, **fields: Any) -> None:
        message = self._types[kind](header=self.header(stamp, frame), **fields)
        self._bag.write(topic, kind, stamp if received is None else received, message)


def write_recording(scene: Scene, path: Path | str, progress: Callable[[int], None] | None = None) -> None:
    """Render a scene into a rosbag2 recording (mcap), like those of `recordings/practice`.

    Raises:
        BagError: it exists already, or its directory cannot be written.
    """
    with BagWriter(path) as bag:
        out = _Messages(bag)
        stamps = _BEGIN + np.rint(scene.time * 1e9).astype(np.int64)
        _write_calibrations(out, scene, int(stamps[0]))
        readings = scene.reference()
        for rows in chunks(scene):
            samples = render_chunk(scene, rows)
            for index, row in enumerate(rows):
                _write_settings(out, scene, int(row), stamps)
                _write_sweep(out, scene, int(row), int(stamps[row]), (samples[0][index], samples[1][index]), readings)
            if progress is not None:
                progress(int(rows[-1]) + 1)


def _write_calibrations(out: _Messages, scene: Scene, start: int) -> None:
    for station in scene.condition.stations:
        out.write(
            f'/{station.name}/calibration',
            'drfmcw_msgs/msg/StationCalibration',
            start - 1_000_000,
            station.name,
            station=station.name,
            alpha=station.alpha,
            sample_clock_alpha=station.sample_clock_alpha,
            temperature=station.calibration_temperature,
            delay=station.delay,
            noise_floor=station.noise_floor,
            phase_noise_level=station.phase_noise_level,
            phase_noise_corner=station.phase_noise_corner,
            **_NOT_STATED,
        )


def _write_settings(out: _Messages, scene: Scene, row: int, stamps: np.ndarray) -> None:
    """Write what is published once in a setting, and the sweep's settings where they change."""
    c, setting = scene.condition, int(scene.setting[row])
    if row > 0 and scene.setting[row - 1] == setting:
        return
    stamp = int(stamps[row])
    start_delay = float(scene.nominal_start_delay[row])
    if row == 0 or scene.nominal_start_delay[row - 1] != start_delay:
        for station, peer, role in (FIRST, SECOND, 1), (SECOND, FIRST, 2):
            out.write(
                f'/{c.names[station]}/sweep_config',
                'drfmcw_msgs/msg/SweepConfig',
                stamp - 500_000,
                c.names[station],
                station=c.names[station],
                peer=c.names[peer],
                role=role,
                mode=int(c.distances[setting] >= c.mode_boundary),
                start_frequency=c.start_frequency,
                bandwidth=c.bandwidth,
                ramp_duration=c.ramp_duration,
                start_delay=start_delay,
                sample_rate=c.sample_rate,
                sample_count=c.sample_count,
                tx_eirp=c.tx_eirp,
                rx_antenna_gain=c.rx_antenna_gain,
                full_scale_power=c.full_scale_power,
            )
    weather = (
        ('temperature', 'Temperature', 'temperature', c.air_temperature, 0.04),
        ('pressure', 'FluidPressure', 'fluid_pressure', c.air_pressure, 400.0),
        ('humidity', 'RelativeHumidity', 'relative_humidity', c.air_humidity, 1e-4),
    )
    for topic, kind, field, values, variance in weather:
        value: dict[str, Any] = {field: float(values[setting]), 'variance': variance}
        out.write(f'/site/{topic}', f'sensor_msgs/msg/{kind}', stamp, 'site', **value)
    for station in (FIRST, SECOND):
        out.write(
            f'/{c.names[station]}/status',
            'drfmcw_msgs/msg/StationStatus',
            stamp,
            c.names[station],
            station=c.names[station],
            temperature=float(scene.board[station, row]),
            pll_locked=True,
            sweeps=row,
            dropped=0,
            link_quality=1.0,
        )


def _write_sweep(
    out: _Messages, scene: Scene, row: int, stamp: int, samples: tuple[np.ndarray, np.ndarray], readings: np.ndarray
) -> None:
    c = scene.condition
    out.write(
        '/reference/range',
        'drfmcw_msgs/msg/ReferenceRange',
        stamp,
        'reference',
        range=float(readings[row]),
        range_std=c.reference_std,
    )
    for station, peer in (FIRST, SECOND), (SECOND, FIRST):
        # both headers state when the first station starts; the second one's record arrives its start delay later
        received = stamp + (0 if station == FIRST else round(1e9 * float(scene.nominal_start_delay[row])))
        out.write(
            f'/{c.names[station]}/if_samples',
            'drfmcw_msgs/msg/IfSamples',
            stamp,
            f'{c.names[station]}_antenna',
            received,
            station=c.names[station],
            peer=c.names[peer],
            sweep_id=row,
            full_scale=c.full_scale,
            iq=False,
            samples=np.ascontiguousarray(samples[station], np.int16),
        )
