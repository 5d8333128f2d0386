"""Calls of services from the pages' event loop; they run in the node's thread."""

import asyncio
from typing import Any

from ..node import HostNode

_LIMIT = 5.0  # for an answer [s]


class Unreachable(Exception):
    """A node does not answer."""


class Remote:
    """Calls services of other nodes."""

    def __init__(self, node: HostNode) -> None:
        """Use the host's node for the calls."""
        self._node = node

    async def _call(self, kind: Any, name: str, request: Any) -> Any:
        """Return the answer of the service of that name.

        Raises:
            Unreachable: there is none within 5 s.
        """
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def answer(future: Any) -> None:
            def take() -> None:
                if not answered.done():
                    answered.set_result(future.result())

            loop.call_soon_threadsafe(take)

        def call() -> Any:
            client = self._node.create_client(kind, name)
            client.call_async(request).add_done_callback(answer)
            return client

        client = await asyncio.wrap_future(self._node.do(call))
        try:
            return await asyncio.wait_for(answered, _LIMIT)
        except TimeoutError:
            raise Unreachable(name) from None
        finally:
            self._node.do(lambda: self._node.destroy_client(client))
