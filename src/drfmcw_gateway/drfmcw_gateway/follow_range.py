"""Example of a controller in ROS 2: follows one pair's range and decides whether the crane may move.

Copy it, and replace `_announce` by what moves the crane. It shows four defences against a range that is wrong or
missing: the flags, a time-out of its own, the middleware's deadline, and the liveliness of the publisher.
"""

import dataclasses
import enum
import functools
import math
import sys
import time
from collections.abc import Sequence
from typing import Any

from drfmcw_msgs.msg import RangeEstimate
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node

from drfmcw_physics.settings import parameter
from drfmcw_ros.commands.cli import Parser, guarded, split_ros_arguments
from drfmcw_ros.graph import qos
from drfmcw_ros.graph.messages import from_message
from drfmcw_ros.nodes.diagnostics import ERROR, WARN, Diagnostics, Status
from drfmcw_ros.nodes.parameters import SettingsParameters
from drfmcw_ros.nodes.runner import run

from .reading import Estimate, PairState, Quality, Reading


@dataclasses.dataclass(frozen=True)
class FollowerSettings:
    """What the controller asks of a range before the crane moves."""

    pair: str = parameter('master/slave', description="pair of stations as 'first/second'", structural=True)
    timeout: float = parameter(
        0.2, unit='s', bounds=(0.02, 60.0), description='without a range, after which the crane stops'
    )
    age_limit: float = parameter(
        1.0,
        unit='s',
        bounds=(0.02, 1e6),
        nan_means='stamps are not compared with the clock',
        description='difference of a stamp from the clock beyond which a range is not used',
    )
    margin: float = parameter(
        0.1,
        unit='m',
        bounds=(0.0, 1e6),
        description='protection level up to which the crane moves at full speed; beyond it, it creeps',
    )
    deadline: float = parameter(
        qos.RANGE_DEADLINE,
        unit='s',
        bounds=(0.001, 60.0),
        description='between two ranges, asked of the middleware; not below what fusion offers',
        structural=True,
    )
    lease: float = parameter(
        qos.RANGE_LEASE,
        unit='s',
        bounds=(0.01, 600.0),
        description='without a sign of life, after which fusion counts as dead, likewise',
        structural=True,
    )

    @property
    def period(self) -> float:
        """Return how often the time-out is looked at [s]."""
        return min(0.05, self.timeout / 5.0)


class Speed(enum.Enum):
    """What the crane may do."""

    DRIVE = 'drive'
    CREEP = 'creep'
    STOP = 'stop'


@dataclasses.dataclass(frozen=True)
class Decision:
    """What the crane may do, and why."""

    speed: Speed
    reason: str


def decide(reading: Reading, settings: FollowerSettings) -> Decision:
    """Return what the crane may do with what is known of the range."""
    if reading.state == Quality.NO_RANGE:
        return Decision(Speed.STOP, 'no range yet')
    if reading.state == Quality.STALE:
        if reading.quality & Quality.LATE:
            return Decision(Speed.STOP, f"the range's stamp is {reading.age:.1f} s old")
        return Decision(Speed.STOP, f'no range within {settings.timeout:g} s')
    if reading.state == Quality.REFUSED:
        return Decision(Speed.STOP, 'the range is refused')
    level = reading.value('protection_level')
    if level > settings.margin:
        return Decision(Speed.CREEP, f'the protection level is beyond {settings.margin:g} m')
    if math.isnan(reading.value('velocity')):
        return Decision(Speed.CREEP, 'the velocity is not known yet')
    if reading.state == Quality.DOUBTFUL:
        return Decision(Speed.CREEP, 'the range is doubtful')
    return Decision(Speed.DRIVE, 'the range is valid')


class Follower(Node):
    """Follows one pair's range; logs each change of its decision."""

    def __init__(self, given: FollowerSettings | None = None, **kwargs: Any) -> None:
        """Subscribe; `given` replaces the parameters' defaults, `kwargs` go to rclpy's Node."""
        super().__init__('follow_range', **kwargs)
        self._settings = SettingsParameters(self, FollowerSettings, given, on_change=self._change)
        settings = self._settings.value
        self._state = PairState(settings.timeout, settings.age_limit)
        self._decision = Decision(Speed.STOP, '')
        self._deadlines = self._deaths = 0
        self._alive = 0
        self._incompatible = ''
        events = SubscriptionEventCallbacks(
            deadline=self._deadline_missed, liveliness=self._liveliness_changed, incompatible_qos=self._refused
        )
        profile = qos.range_profile(settings.deadline, settings.lease)
        topic = f'/{settings.pair}/range'
        qos.subscription(self, RangeEstimate, topic, self._take, profile, batch=True, events=events)
        self._timer = self.create_timer(settings.period, self._look)
        diagnostics = Diagnostics(self, 'follow_range')
        diagnostics.add(f'Range {settings.pair}', self._diagnose)

    def _change(self, settings: FollowerSettings) -> None:
        self._state.timeout, self._state.age_limit = settings.timeout, settings.age_limit

    def _take(self, messages: list[RangeEstimate]) -> None:
        arrival = time.monotonic()
        for message in messages:
            self._state.take(from_message(message, Estimate), arrival)
        self._look()

    def _look(self) -> None:
        """Decide anew; the time until the next look counts as silence, so that the time-out is kept."""
        settings = self._settings.value
        clock = self.get_clock().now().nanoseconds
        reading = self._state.reading(time.monotonic(), clock, margin=settings.period)
        decision = decide(reading, settings)
        if self._alive == 0 and reading.state != Quality.NO_RANGE:
            decision = Decision(Speed.STOP, 'fusion gives no sign of life')
        if decision != self._decision:
            self._decision = decision
            self._announce(decision)

    def _announce(self, decision: Decision) -> None:
        self.get_logger().info(f'{self._settings.value.pair}: {decision.speed.value}: {decision.reason}')

    # --- events of the middleware ---

    def _deadline_missed(self, event: Any) -> None:
        """Look at once: the middleware noticed the silence before the timer did."""
        self._deadlines += event.total_count_change
        self._look()

    def _liveliness_changed(self, event: Any) -> None:
        """Stop without waiting for the time-out when the last publisher died, hangs or was deactivated."""
        self._alive = event.alive_count
        self._deaths += max(0, -event.alive_count_change)
        self._look()

    def _refused(self, event: Any) -> None:
        """Report a publisher that offers less than was asked for: nothing will ever arrive from it."""
        policy = event.last_policy_kind.name.lower().rpartition('policy_')[2]
        self._incompatible = f'the publisher offers a longer {policy} than is asked for'
        self.get_logger().error(f'/{self._settings.value.pair}/range: {self._incompatible}')

    def _diagnose(self, status: Status) -> None:
        level = {Speed.DRIVE: None, Speed.CREEP: WARN, Speed.STOP: ERROR}[self._decision.speed]
        if level is not None:
            status.report(level, f'{self._decision.speed.value}: {self._decision.reason}')
        if self._incompatible and not self._alive:
            status.report(ERROR, self._incompatible)
        status.value('publishers alive', self._alive)
        status.value('deadlines missed', self._deadlines)
        status.value('publishers that died', self._deaths)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node; return the exit status."""
    own, ros = split_ros_arguments(argv)
    parser = Parser(prog='follow_range', description=__doc__)
    parser.add_argument(
        '--pair', default='master/slave', metavar='FIRST/SECOND', help='pair of stations (master/slave)'
    )
    arguments = parser.parse_args(own)
    given = FollowerSettings(pair=arguments.pair)
    return guarded(parser.prog, functools.partial(run, Follower, ros, given=given))


if __name__ == '__main__':
    sys.exit(main())
