"""Findings that the live diagnosis kept: one folder each, with finding.json and report.html."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError

from .recordings import checked_name

REPORT = 'report.html'
_SHOWN = 100  # newest findings
_LARGEST = 5_000_000  # bytes of a finding.json that is read


@dataclasses.dataclass(frozen=True)
class Effect:
    """One effect that a finding names."""

    name: str
    station: str  # '' for none
    parameters: tuple[tuple[str, float, float, str], ...]  # (name, value, standard deviation, unit)


@dataclasses.dataclass(frozen=True)
class Finding:
    """What one finding says."""

    name: str
    when: float  # wall clock [s]
    verdict: str
    significance: float
    effects: tuple[Effect, ...]
    next_measurement: str
    report: bool


def read_findings(directory: Path) -> list[Finding]:
    """Return the newest findings in a directory, the newest first; damaged ones are left out."""
    if not directory.is_dir():
        return []
    folders = sorted((p for p in directory.iterdir() if (p / 'finding.json').is_file()), reverse=True)
    found = (_read(folder) for folder in folders[:_SHOWN])
    return [finding for finding in found if finding is not None]


def _read(folder: Path) -> Finding | None:
    path = folder / 'finding.json'
    try:
        checked_name(folder.name)
        status = path.stat()
        if status.st_size > _LARGEST:
            return None
        content: dict[str, Any] = json.loads(path.read_text(encoding='utf-8'))
        effects = tuple(_effect(effect) for effect in content['effects'])
        decisive = content.get('next_measurement')
        text = decisive if isinstance(decisive, str) else json.dumps(decisive) if decisive else ''
        return Finding(
            folder.name,
            status.st_mtime,
            str(content['verdict']),
            float(content['significance']),
            effects,
            text,
            (folder / REPORT).is_file(),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ConfigurationError):
        return None


def _effect(effect: dict[str, Any]) -> Effect:
    parameters = (
        (str(name), float(p['value']), float(p['std']), str(p['unit']))
        for name, p in effect['parameters'].items()
        if isinstance(p['value'], int | float)
    )
    return Effect(str(effect['effect']), str(effect.get('station') or ''), tuple(parameters))


def report_path(directory: Path, name: str) -> Path:
    """Return the report of a finding.

    Raises:
        ConfigurationError: there is none of that name.
    """
    path = directory / checked_name(name) / REPORT
    if path.is_symlink() or not path.is_file():
        raise ConfigurationError(f"no report '{name}'")
    return path
