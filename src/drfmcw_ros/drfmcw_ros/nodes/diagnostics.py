"""Diagnostics of a node on /diagnostics at 1 Hz (REP 107)."""

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from ..commands.versions import SOFTWARE, release, running
from ..graph.qos import RELIABLE, publisher
from .runner import failures

OK, WARN, ERROR, STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE


class Status:
    """What one diagnostic task says: the worst level so far, its messages and its values."""

    def __init__(self) -> None:
        """Start with OK and nothing to say."""
        self.level = OK
        self.messages: list[str] = []
        self.values: dict[str, Any] = {}

    def report(self, level: bytes, message: str) -> None:
        """Add a message; the level only ever rises."""
        self.level = max(self.level, level)
        self.messages.append(message)

    def value(self, key: str, value: Any) -> None:
        """Add a value; floats are shown with six digits."""
        self.values[key] = f'{value:.6g}' if isinstance(value, float) else str(value)


class Diagnostics:
    """Publishes the node's diagnostic tasks once a second, named ``/namespace/node: Task``: unique in an aggregator."""

    def __init__(self, node: Node, hardware_id: str, state: Callable[[], str] = lambda: '') -> None:
        """Create the publisher and its 1 Hz timer.

        Args:
            node: owner.
            hardware_id: serial number, or name of the station or pair.
            state: returns why the node rests by intention ('inactive'), '' where it works; tasks then say only that.
        """
        self._state = state
        self._node = node
        self._hardware_id = hardware_id
        self._tasks: list[tuple[str, Callable[[Status], None]]] = []
        self._software = self._running()
        self._publisher = publisher(node, DiagnosticArray, '/diagnostics', RELIABLE)
        self._reported = 0  # failures of callbacks
        self._timer = node.create_timer(1.0, self._publish)

    def add(self, name: str, task: Callable[[Status], None]) -> None:
        """Add a task that fills a `Status` each second."""
        self._tasks.append((name, task))

    def _failing(self) -> list[tuple[str, Callable[[Status], None]]]:
        """Return the task that reports exceptions in callbacks, none while there was no exception."""
        found = failures(self._node)
        return [('Callbacks', self._report_failures)] if found.count else []

    def _report_failures(self, status: Status) -> None:
        found = failures(self._node)
        new, self._reported = found.count - self._reported, found.count
        if new:
            status.report(ERROR, f'{new} callbacks failed, last: {found.last}')
        status.value('failed callbacks', found.count)
        status.value('last failure', found.last)

    def _publish(self) -> None:
        message = DiagnosticArray()
        message.header.stamp = self._node.get_clock().now().to_msg()
        for name, task in (*self._tasks, *self._failing()):
            status = Status()
            if resting := self._state():
                status.report(OK, resting)
            try:
                if not resting:
                    task(status)
            except Exception as error:
                failures(self._node).add(error)
                status.report(ERROR, f'cannot be diagnosed: {failures(self._node).last}')
            message.status.append(self._message(name, status))
        message.status.append(self._software)
        self._publisher.publish(message)

    def _message(self, name: str, status: Status) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=status.level,
            name=f'{self._node.get_fully_qualified_name()}: {name}',
            message='; '.join(status.messages) or 'OK',
            hardware_id=self._hardware_id,
            values=[KeyValue(key=k, value=v) for k, v in status.values.items()],
        )

    def _running(self) -> DiagnosticStatus:
        """Return what runs here, which stays as it was at the start."""
        status = Status()
        status.report(OK, f'drfmcw {release()}')
        for name, version in running().items():
            status.value(name, version)
        return self._message(SOFTWARE, status)
