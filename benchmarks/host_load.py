"""Publishes what one pair of stations and fusion do, as fast as asked, so that the host can be measured alone.

python host_load.py FIRST SECOND RATE, until it is interrupted.
"""

import array
import signal
import sys
import time
from typing import Any

import rclpy
from drfmcw_msgs.msg import BeatFrequency, IfSpectrum, RangeEstimate, SweepConfig
from rclpy.serialization import serialize_message

from drfmcw_ros import qos

_BINS = 1024
_BURST = 5e-3  # messages due within it are published together [s]


def _messages(first: str, second: str) -> dict[str, tuple[Any, Any]]:
    """Return topic: (type, message) of everything that is published at the full rate."""
    found: dict[str, tuple[Any, Any]] = {
        f'/{first}/{second}/range': (RangeEstimate, RangeEstimate(range=123.4, range_std=0.001, sweep_id=1))
    }
    for station, peer in ((first, second), (second, first)):
        beat = BeatFrequency(station=station, peer=peer, frequency=6e5, frequency_std=2.0, power=-60.0, snr=40.0)
        spectrum = IfSpectrum(station=station, peer=peer, frequency_step=1e3, window='hann')
        spectrum.magnitude = array.array('f', [-90.0] * _BINS)
        found[f'/{station}/beat_frequency'] = (BeatFrequency, beat)
        found[f'/{station}/if_spectrum'] = (IfSpectrum, spectrum)
    return found


def main() -> None:
    """Publish until interrupted."""
    first, second, rate = sys.argv[1], sys.argv[2], float(sys.argv[3])
    rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    node = rclpy.create_node(f'load_{first}_{second}')
    prepared = [
        (node.create_publisher(kind, topic, qos.RELIABLE), serialize_message(message))
        for topic, (kind, message) in _messages(first, second).items()
    ]
    for station, peer in ((first, second), (second, first)):
        settings = SweepConfig(station=station, peer=peer, role=1, bandwidth=150e6, ramp_duration=1e-3)
        settings.start_frequency, settings.sample_rate, settings.sample_count = 5.725e9, 2.048e6, 2048
        latched = node.create_publisher(SweepConfig, f'/{station}/sweep_config', qos.LATCHED)
        latched.publish(settings)
    began, rounds = time.monotonic(), 0
    try:
        while rclpy.ok():
            due = int((time.monotonic() - began) * rate)
            if due - rounds > rate * _BURST * 20:  # the machine is busy: what is late is left out
                rounds = due - 1
            for _ in range(due - rounds):
                for publisher, message in prepared:
                    publisher.publish(message)
            rounds = due
            time.sleep(_BURST)
    except KeyboardInterrupt:
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
