"""Recording the running graph for a survey, with a line that says how far it is."""

import signal
import time
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.live import Live

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.bag.record import RecorderNode, RecorderSettings
from drfmcw_ros.graph.topics import split_station_topic
from drfmcw_ros.nodes.runner import run

_REFRESH = 0.5  # of the line on a terminal [s]
_LOG_REFRESH = 5.0  # of the line in a log [s]


def record_live(path: str, duration: float, console: Console) -> int:
    """Record what the running graph measures, for `duration` [s] or until Ctrl-C; return the exit status.

    Raises:
        ConfigurationError: the duration is not above zero.
    """
    if not duration > 0.0:
        raise ConfigurationError(f'--duration = {duration:g} s must be above zero')
    began = time.monotonic()
    with Live(console=console, auto_refresh=False, transient=True) as live:

        def recorder(**settings: Any) -> RecorderNode:
            node = RecorderNode(**settings)

            def show() -> None:
                text = progress(time.monotonic() - began, duration, node.counts)
                if console.is_terminal:
                    live.update(text, refresh=True)
                else:
                    console.print(text, highlight=False)

            node.create_timer(_REFRESH if console.is_terminal else _LOG_REFRESH, show)
            return node

        status = run(recorder, [], path=path, settings=RecorderSettings(measured_only=True, duration=duration))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # `run` ignores further ones; the evaluation need not
    return status


def progress(elapsed: float, duration: float, counts: Mapping[str, int]) -> str:
    """Return one line: how long [s] of how long has been recorded, and how many sweeps of each station."""
    sweeps = {}
    for topic, count in sorted(counts.items()):
        station, name = split_station_topic(topic)
        if name == 'if_samples':
            sweeps[station] = count
    of = f' of {duration:.0f} s' if duration < float('inf') else ' s, until Ctrl-C'
    found = ', '.join(f'{count} of {station}' for station, count in sweeps.items())
    return f'recording: {elapsed:.0f}{of}; ' + (f'sweeps: {found}' if found else 'no sweep yet')
