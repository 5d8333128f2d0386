"""Publishes what one pair of stations and fusion do, as fast as asked, so that the host can be measured alone.

python host_load.py FIRST SECOND RATE, until it is interrupted.
"""

import array
import dataclasses
import signal
import sys
import time
from typing import Any

import rclpy
from drfmcw_msgs.msg import BeatFrequency, IfSpectrum, RangeBatch, RangeEstimate, SweepConfig
from rclpy.serialization import serialize_message

from drfmcw_fusion.batch import Gathering
from drfmcw_fusion.pipeline import RangeResult
from drfmcw_node.processing import excerpt
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import publish
from drfmcw_ros.graph.topics import DISPLAYED

_BINS = 1024
_BURST = 5e-3  # messages due within it are published together [s]


def _streams(first: str, second: str) -> dict[str, Any]:
    """Return topic: message of everything that is published at the full rate."""
    found: dict[str, Any] = {f'/{first}/{second}/range': RangeEstimate(range=123.4, range_std=0.001, sweep_id=1)}
    for station, peer in ((first, second), (second, first)):
        beat = BeatFrequency(station=station, peer=peer, frequency=6e5, frequency_std=2.0, power=-60.0, snr=40.0)
        spectrum = IfSpectrum(station=station, peer=peer, frequency_step=1e3, window='hann')
        spectrum.magnitude = array.array('f', [-90.0] * _BINS)
        found[f'/{station}/beat_frequency'] = beat
        found[f'/{station}/if_spectrum'] = spectrum
    return found


def _result(first: str, second: str, number: int) -> RangeResult:
    """Return a range as fusion gathers it for displays."""
    values: dict[str, Any] = dict.fromkeys(
        (f.name for f in dataclasses.fields(RangeResult) if f.default is dataclasses.MISSING), 0
    )
    stated = {'frame_id': '', 'first_station': first, 'second_station': second, 'range': 123.4, 'range_std': 0.001}
    return RangeResult(**values | stated | {'stamp': time.time_ns(), 'sweep_id': number})


def main() -> None:
    """Publish until interrupted."""
    first, second, rate = sys.argv[1], sys.argv[2], float(sys.argv[3])
    rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = rclpy.create_node(f'load_{first}_{second}')
    prepared, excerpts = [], []
    for topic, message in _streams(first, second).items():
        serialised = serialize_message(message)
        prepared.append((node.create_publisher(type(message), topic, qos.RELIABLE), serialised))
        space, _, last = topic.rpartition('/')
        if last != 'range':
            shown = node.create_publisher(type(message), f'{space}/{DISPLAYED[last]}', qos.RELIABLE)
            excerpts.append((shown, serialised))
    batches = node.create_publisher(RangeBatch, f'/{first}/{second}/{DISPLAYED["range"]}', qos.RELIABLE)
    for station, peer in ((first, second), (second, first)):
        settings = SweepConfig(station=station, peer=peer, role=1, bandwidth=150e6, ramp_duration=1e-3)
        settings.start_frequency, settings.sample_rate, settings.sample_count = 5.725e9, 2.048e6, 2048
        latched = node.create_publisher(SweepConfig, f'/{station}/sweep_config', qos.LATCHED)
        latched.publish(settings)
    began, rounds, shown_at, gathering = time.monotonic(), 0, 0.0, Gathering()
    try:
        while rclpy.ok():
            now = time.monotonic()
            due = int((now - began) * rate)
            if due - rounds > rate * _BURST * 20:  # the machine is busy: what is late is left out
                rounds = due - 1
            for number in range(rounds, due):
                for publisher, message in prepared:
                    publisher.publish(message)
                gathering.add(_result(first, second, number), now)
            rounds = due
            if gathering.due(now):
                publish(batches, gathering.take(now))
            if now - shown_at >= excerpt.INTERVAL:
                shown_at = now
                for publisher, message in excerpts:
                    publisher.publish(message)
            time.sleep(_BURST)
    except KeyboardInterrupt:
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
