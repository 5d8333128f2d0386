"""Signs of life for systemd (sd_notify(3)): ready, alive, stopping; nothing where no service manager asks.

The node sends them from its own timer, so that a node whose callbacks hang is restarted.
"""

import os
import socket
from collections.abc import Mapping
from typing import Any

_SHORTEST = 0.05  # [s]


class Watchdog:
    """Says to the service manager that a process is ready, alive or stopping."""

    def __init__(self, environ: Mapping[str, str]) -> None:
        """Read NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID, which systemd sets for services of Type=notify."""
        self._address = environ.get('NOTIFY_SOCKET', '')
        of = environ.get('WATCHDOG_PID', '')
        limit = environ.get('WATCHDOG_USEC', '')
        mine = not of or of == str(os.getpid())
        self.interval = max(int(limit) * 1e-6 / 4.0, _SHORTEST) if mine and limit.isdecimal() and int(limit) else 0.0
        """Seconds between two signs of life, a quarter of what the service manager grants; 0 where it wants none."""

    def attach(self, node: Any) -> None:
        """Say that a node is ready, and let its executor send signs of life."""
        self.say('READY=1')
        if self.interval > 0.0 and self._address:
            node.create_timer(self.interval, self.alive)

    def alive(self) -> None:
        """Send a sign of life."""
        self.say('WATCHDOG=1')

    def stopping(self) -> None:
        """Say that the process ends by intention."""
        self.say('STOPPING=1')

    def say(self, text: str) -> None:
        """Send a state; a service manager that does not listen is no reason to fail."""
        if not self._address:
            return
        address = '\0' + self._address[1:] if self._address.startswith('@') else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.setblocking(False)
                sender.sendto(text.encode(), address)
        except OSError:
            pass
