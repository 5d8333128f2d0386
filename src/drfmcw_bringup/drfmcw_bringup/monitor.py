"""Watching the ranges of a graph from a process that does something else too."""

import collections
import contextlib
import dataclasses
import functools
import time
from collections.abc import Iterator, Sequence

import rclpy
from drfmcw_msgs.msg import RangeEstimate
from rclpy.node import Node

from drfmcw_fusion.pipeline import flag_names
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import stamp_ns
from drfmcw_ros.graph.publishers import Publishers
from drfmcw_ros.nodes.runner import spinning

_RATE_TIME = 2.0  # over which the rate is counted [s]


@dataclasses.dataclass(frozen=True)
class Arrival:
    """One range as it arrived."""

    pair: str
    sweep_id: int
    stamp: int  # [ns]
    received: int  # wall clock [ns]
    message: RangeEstimate


class RangeMonitor(Node):
    """Keeps the newest range of each pair, the number of ranges, and, if asked, all of them."""

    def __init__(self, pairs: Sequence[str], keep: bool = False) -> None:
        """Subscribe to the ranges of `pairs` ('first/second')."""
        super().__init__('range_monitor')
        self.newest: dict[str, RangeEstimate] = {}
        self.counts: collections.Counter[str] = collections.Counter()
        self.arrivals: list[Arrival] = []
        self._keep = keep
        self._times: collections.deque[tuple[float, int]] = collections.deque()
        self._sources = {pair: Publishers(f'/{pair}/range') for pair in pairs}
        self._subscriptions_of_pairs = [
            qos.subscription(
                self,
                RangeEstimate,
                sources.topic,
                functools.partial(self._take, pair),
                qos.RELIABLE,
                batch=True,
                numbers=sources.add,
            )
            for pair, sources in self._sources.items()
        ]

    def _take(self, pair: str, messages: list[RangeEstimate]) -> None:
        now = time.time_ns()
        self.newest[pair] = messages[-1]
        self.counts[pair] += len(messages)
        self._times.append((time.monotonic(), len(messages)))
        if self._keep:
            self.arrivals.extend(Arrival(pair, m.sweep_id, stamp_ns(m.header.stamp), now, m) for m in messages)

    def wait_for_publishers(self, limit: float) -> bool:
        """Wait at most `limit` seconds until somebody publishes each pair's range; return whether they do."""
        end = time.monotonic() + limit
        while time.monotonic() < end:
            if all(s.get_publisher_count() for s in self._subscriptions_of_pairs):
                return True
            time.sleep(0.02)
        return False

    @property
    def total(self) -> int:
        """Number of ranges of all pairs so far."""
        return sum(self.counts.values())

    def rate(self) -> float:
        """Return ranges per second over the last two seconds."""
        begin = time.monotonic() - _RATE_TIME
        while self._times and self._times[0][0] < begin:
            self._times.popleft()
        return sum(count for _, count in list(self._times)) / _RATE_TIME

    def describe(self, pair: str) -> str:
        """Return one short line about the newest range of a pair."""
        m = self.newest.get(pair)
        if m is None:
            return f'{pair}: waiting for the first range'
        mode = 'LD' if m.mode == 1 else 'SD'
        doubt = f' {", ".join(flag_names(m.flags))}' if m.flags else ''
        if self._sources[pair].several:
            doubt += f' MIXED: {self._sources[pair].doubt}'
        return f'{pair}: {m.range:9.3f} m +- {m.range_std * 1e3:5.2f} mm {m.velocity:+6.3f} m/s {mode}{doubt}'


@contextlib.contextmanager
def monitored(pairs: Sequence[str], domain_id: int | None = None, keep: bool = False) -> Iterator[RangeMonitor]:
    """Run a RangeMonitor in the background.

    Args:
        pairs: 'first/second' each.
        domain_id: ROS domain; None takes the environment's.
        keep: keep every range in `arrivals`.
    """
    rclpy.init(args=[], domain_id=domain_id, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    try:
        node = RangeMonitor(pairs, keep)
        try:
            with spinning(node):
                yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.utilities.try_shutdown()
