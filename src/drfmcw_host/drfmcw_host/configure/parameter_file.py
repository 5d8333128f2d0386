"""Parameter files in ROS's own format, which `run --parameters`, `station` and `fusion` load."""

import re
from collections.abc import Iterable
from pathlib import Path

import yaml

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically

from .values import Described

_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9_.-]{0,60}')


def content(parameters: Iterable[Described]) -> str:
    """Return the YAML of all parameters that can be changed while running, by node."""
    nodes: dict[str, dict] = {}
    for p in parameters:
        if not p.read_only and p.value is not None:
            nodes.setdefault(p.node, {'ros__parameters': {}})['ros__parameters'][p.name] = p.value
    return yaml.safe_dump(nodes, sort_keys=True, default_flow_style=False)


def save(directory: Path, name: str, parameters: Iterable[Described]) -> Path:
    """Write a parameter file; return its path. An earlier one of that name is replaced as a whole.

    Raises:
        ConfigurationError: the name could lead elsewhere, or the file cannot be written.
    """
    stem = name.removesuffix('.yaml')
    if not _NAME.fullmatch(stem):
        raise ConfigurationError(f'file name {name[:40]!r}: use letters, digits, ".", "_" and "-"')
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f'{directory}: {error.strerror}') from None
    path = directory / f'{stem}.yaml'
    write_atomically(path, content(parameters))
    return path
