"""Security of the middleware: whether it is there, and what each node may do with it (SROS2). docs/security.md."""

import dataclasses
import mmap
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

from drfmcw_physics.settings import ConfigurationError

from ..graph.topics import DISPLAYED

_REQUESTS = ('sweep_request', 'schedule_request')  # of fusion to a station
_LIBRARY = 'libfastrtps.so'
_PLUGIN = b'builtin.PKI-DH'
"""Name of the authentication plugin; a Fast DDS that was built with security contains it."""

_PARAMETER_SERVICES = (
    'describe_parameters',
    'get_parameter_types',
    'get_parameters',
    'get_type_description',
    'list_parameters',
    'set_parameters',
    'set_parameters_atomically',
)

_LIFECYCLE_SERVICES = (
    'change_state',
    'get_available_states',
    'get_available_transitions',
    'get_state',
    'get_transition_graph',
)


def uses_fast_dds(environ: Mapping[str, str]) -> bool:
    """Return whether a node will load Fast DDS, not another middleware."""
    return environ.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp').startswith('rmw_fastrtps')


def fast_dds_is_secure(environ: Mapping[str, str]) -> bool | None:
    """Return whether the Fast DDS that a node will load has security; None where another middleware is asked for."""
    if not uses_fast_dds(environ):
        return None
    folders = environ.get('LD_LIBRARY_PATH', '').split(os.pathsep)
    for path in (Path(folder) / _LIBRARY for folder in folders if folder):
        if path.is_file():
            with path.open('rb') as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                return content.find(_PLUGIN) >= 0
    return None


def refuse_pretence(environ: Mapping[str, str]) -> None:
    """Raise ConfigurationError where SROS2 is switched on and the middleware would start without it."""
    if environ.get('ROS_SECURITY_ENABLE', '').lower() == 'true' and fast_dds_is_secure(environ) is False:
        raise ConfigurationError(
            'ROS_SECURITY_ENABLE is true, but this Fast DDS was built without security: every node would start open. '
            'Use an installed ROS 2 Jazzy, or unset it and isolate the network (docs/security.md)'
        )


@dataclasses.dataclass(frozen=True)
class NodeRights:
    """What one node may do; names are absolute."""

    namespace: str
    node: str
    publish: tuple[str, ...]
    subscribe: tuple[str, ...]
    reply: tuple[str, ...] = ()  # services
    managed: bool = True  # has a life cycle

    @property
    def enclave(self) -> str:
        """Return the path of its enclave."""
        return f'/drfmcw{self.namespace.rstrip("/")}/{self.node}'


def rights(pairs: Sequence[tuple[str, str]], feed: bool = False) -> list[NodeRights]:
    """Return what the nodes of some pairs need, and nothing else: stations, fusion, recorder, gateway, example.

    Args:
        pairs: names of the first and the second station of each; equal where a station hears itself.
        feed: the stations own their sweeps (a digitiser's feed), which hardware drivers publish otherwise.
    """
    stations = sorted({name for pair in pairs for name in pair})
    found = []
    for station in stations:
        peers = sorted({name for pair in pairs if station in pair for name in pair} - {station})
        own = [f'/{station}/{name}' for name in ('sweep_config', 'calibration')]
        streams = ('beat_frequency', 'if_spectrum', 'if_samples_compressed')
        results = [f'/{station}/{name}' for name in (*streams, *(DISPLAYED[s] for s in streams if s in DISPLAYED))]
        heard = [f'/{peer}/{name}' for peer in peers for name in ('calibration', 'status')]
        if feed:
            results += [*own, f'/{station}/sweep_schedule', f'/{station}/status']
            heard += [f'/{station}/{name}' for name in _REQUESTS]
            heard += [f'/{peer}/beat_frequency' for peer in peers]
        else:
            heard += [*own, f'/{station}/status', f'/{station}/if_samples', f'/{station}/if_samples_compressed']
        services = (f'/{station}/store_calibration',) if feed else ()
        found.append(NodeRights(f'/{station}', 'station', ('/diagnostics', *results), tuple(heard), services))
    site = ('/site/temperature', '/site/pressure', '/site/humidity')
    of_stations = [
        f'/{station}/{name}'
        for station in stations
        for name in ('sweep_config', 'sweep_schedule', 'calibration', 'status', 'beat_frequency')
    ]
    ranges = [f'/{first}/{second}/{name}' for first, second in pairs for name in ('range', 'range_sensor')]
    batches = [f'/{first}/{second}/{DISPLAYED["range"]}' for first, second in pairs]
    requests = [f'/{station}/{name}' for station in stations for name in _REQUESTS]
    found.append(NodeRights('/', 'fusion', ('/diagnostics', *ranges, *batches, *requests), (*site, *of_stations)))
    recorded = [f'/{station}/{name}' for station in stations for name in ('if_samples', 'if_spectrum')]
    everything = (*site, '/reference/range', '/diagnostics', *of_stations, *recorded, *ranges)
    found.append(NodeRights('/', 'recorder', ('/diagnostics',), everything, managed=False))
    controllers = tuple(f'/{first}/{second}/range' for first, second in pairs)
    for node in ('gateway', 'follow_range'):
        found.append(NodeRights('/', node, ('/diagnostics',), controllers, managed=False))
    return found


def policy(nodes: Sequence[NodeRights]) -> str:
    """Return the SROS2 policy (version 0.2.0) of some nodes."""
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', '<policy version="0.2.0">', '  <enclaves>']
    for node in nodes:
        services = _PARAMETER_SERVICES + (_LIFECYCLE_SERVICES if node.managed else ())
        published = ('/rosout', '/parameter_events', *(('~/transition_event',) if node.managed else ()), *node.publish)
        lines += [
            f'    <enclave path={quoteattr(node.enclave)}>',
            '      <profiles>',
            f'        <profile ns={quoteattr(node.namespace)} node={quoteattr(node.node)}>',
            *_expressions('topics', 'publish', 'topic', published),
            *_expressions('topics', 'subscribe', 'topic', ('/parameter_events', '/clock', *node.subscribe)),
            *_expressions('services', 'reply', 'service', [*(f'~/{name}' for name in services), *node.reply]),
            '        </profile>',
            '      </profiles>',
            '    </enclave>',
        ]
    return '\n'.join([*lines, '  </enclaves>', '</policy>', ''])


def _expressions(kind: str, right: str, tag: str, names: Sequence[str]) -> list[str]:
    inner = [f'            <{tag}>{name}</{tag}>' for name in names]
    return [f'          <{kind} {right}="ALLOW">', *inner, f'          </{kind}>']
