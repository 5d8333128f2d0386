"""A graph of one's own gets a domain in which nobody else is."""

import contextlib
import socket

from drfmcw_bringup.graph import free_domain_id


def test_domain_is_taken_while_any_of_its_participants_runs():
    """The participant of the lowest port may have ended before the others (RTPS 2.2, 9.6.1.1: 7410 + 250 d + 2 p)."""
    quiet = set(range(71, 102))
    with contextlib.ExitStack() as stack:
        for domain in set(range(1, 102)) - quiet:
            later = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            with contextlib.suppress(OSError):  # another test's participant is as good
                later.bind(('', 7410 + 250 * domain + 2 * 3))
        found = [free_domain_id() for _ in range(6)]
        assert set(found) <= quiet
        assert len(set(found)) == len(found)
