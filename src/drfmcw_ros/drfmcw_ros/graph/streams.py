"""Streams: subscriptions of many messages a second, served between two turns of rclpy's executor.

The executor makes a wait set of everything that a node has, and a task for each callback, whenever it wakes up. That
takes longer than a sweep takes to evaluate. So whoever spins a node serves its streams by themselves while they flow.
"""

import contextlib
import dataclasses
import time
import weakref
from collections.abc import Callable
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription


@dataclasses.dataclass(frozen=True)
class Stream:
    """A subscription and what is done with the messages that wait at it."""

    subscription: Subscription
    callback: Callable[[Any, Any], None]  # gets the first message and what the middleware says about it


_STREAMS: weakref.WeakKeyDictionary[Node, list[Stream]] = weakref.WeakKeyDictionary()


def add(node: Node, stream: Stream) -> None:
    """Let `serve` serve a stream of a node as well; the executor may do so at any time, too."""
    _STREAMS.setdefault(node, []).append(stream)


def has(node: Node, subscription: Any) -> bool:
    """Return whether a subscription is one of a node's streams."""
    return any(stream.subscription is subscription for stream in _STREAMS.get(node, []))


def serve(node: Node, seconds: float) -> bool:
    """Serve the streams of a node for so long; return False if no message came, at once if the node has none.

    Call it in the thread of the executor, between its turns.
    """
    end = time.monotonic() + seconds
    served = False
    while (left := end - time.monotonic()) > 0.0:
        alive = _awaited(node, left)
        if not alive:
            break
        # while they are served, others get messages: to ask them costs a tenth of waiting for them
        while any([_taken(stream) for stream in alive]):
            served = True
            if time.monotonic() > end:
                break
    return served


def _awaited(node: Node, seconds: float) -> list[Stream]:
    """Return the streams of a node as soon as a message waits at one of them; none if so many seconds are over."""
    streams = _STREAMS.get(node, [])
    alive = []
    with contextlib.ExitStack() as held:  # keeps subscriptions from being destroyed while they are waited for
        for stream in list(streams):
            try:
                held.enter_context(stream.subscription.handle)
            except InvalidHandle:
                streams.remove(stream)
                continue
            alive.append(stream)
        if not alive:
            return []
        context: Any = node.context.handle
        held.enter_context(context)
        wait_set = rclpy_implementation.WaitSet(len(alive), 0, 0, 0, 0, 0, context)
        wait_set.clear_entities()
        for stream in alive:
            wait_set.add_subscription(stream.subscription.handle)
        wait_set.wait(max(1, round(seconds * 1e9)))
        return alive if wait_set.get_ready_entities('subscription') else []


def _taken(stream: Stream) -> bool:
    """Pass on what waits at a stream; return False if nothing did."""
    subscription = stream.subscription
    try:
        with subscription.handle:
            first = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    except InvalidHandle:
        return False
    if first is None:
        return False
    stream.callback(*first)
    return True
