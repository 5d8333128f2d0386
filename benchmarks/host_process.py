"""The host as a process that is measured, and its streams, taken as browsers take them.

python host_process.py ADDRESS SECONDS VIEW ... takes streams in a process of its own.
"""

import asyncio
import contextlib
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import websockets

from drfmcw_bringup.graph import HOST, Graph, Member
from drfmcw_physics.settings import ConfigurationError

_START_LIMIT = 60.0  # [s]
_TICKS = os.sysconf('SC_CLK_TCK')
_PAGE = os.sysconf('SC_PAGE_SIZE')


def start_host(graph: Graph, folder: Path) -> tuple[Member, str]:
    """Start a host that only shows; return it and its address 'http://...' without a slash at the end.

    Raises:
        ConfigurationError: it does not serve.
    """
    host = graph.start('host', HOST, '--port', '0', '--state', str(folder), '--read-only')
    end = time.monotonic() + _START_LIMIT
    while not graph.last_words(host).startswith('host: '):
        if host.process.poll() is not None or time.monotonic() > end:
            raise ConfigurationError(f'host: {graph.last_words(host)}')
        time.sleep(0.1)
    return host, graph.last_words(host).removeprefix('host: ').rstrip('/')


def cpu(member: Member) -> float:
    """Return the CPU time of a process [s]."""
    fields = Path(f'/proc/{member.process.pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def memory(member: Member) -> float:
    """Return the resident memory of a process [MB]."""
    return int(Path(f'/proc/{member.process.pid}/statm').read_text().split()[1]) * _PAGE / 1e6


async def _watch(address: str, view: str, seconds: float) -> tuple[int, float]:
    target = address.replace('http', 'ws', 1)
    async with websockets.connect(f'{target}/live?view={view}', origin=address, max_size=None) as stream:  # type: ignore[arg-type]
        end, count, rate = time.monotonic() + seconds, 0, 0.0
        while (left := end - time.monotonic()) > 0.0:
            with contextlib.suppress(TimeoutError):
                message = await asyncio.wait_for(stream.recv(), left)
                count += 1
                text = json.loads(message).get('text', {}).get('hero.rate', '')
                with contextlib.suppress(ValueError):  # no range yet, or another view
                    rate = float(text.partition(' ')[0])
        return count, rate


async def streams(address: str, views: Sequence[str], seconds: float) -> list[tuple[int, float]]:
    """Take the streams of some views for a time, as browsers do.

    Returns:
        For each: messages, and the ranges per second that the last one showed.
    """
    return list(await asyncio.gather(*(_watch(address, view, seconds) for view in views)))


if __name__ == '__main__':
    os.nice(19)  # real browsers run on another machine
    asyncio.run(streams(sys.argv[1], sys.argv[3:], float(sys.argv[2])))
