"""Findings that the live diagnosis kept: one folder each, with finding.json and report.html."""

import dataclasses
import json
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError

from .recordings import checked_name

REPORT = 'report.html'
_SHOWN = 100  # newest findings
_LONGEST = 200  # letters of a pair's name
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
    pair: str  # 'first/second', '' where it is not stated
    report: bool


class Findings:
    """The directory in which the live diagnosis keeps findings; a finding is read again where its file has changed."""

    def __init__(self, directory: Path) -> None:
        """Use a directory, which need not exist."""
        self.directory = directory
        self._known: dict[str, tuple[int, Finding | None]] = {}

    def list(self) -> list[Finding]:
        """Return the newest findings, the newest first; damaged ones are left out."""
        try:
            folders = sorted((p for p in self.directory.iterdir() if p.is_dir()), reverse=True)[:_SHOWN]
        except OSError:  # nothing was found so far
            folders = []
        self._known = {folder.name: self._looked_at(folder) for folder in folders}
        return [finding for _, finding in self._known.values() if finding is not None]

    def _looked_at(self, folder: Path) -> tuple[int, Finding | None]:
        try:
            changed = folder.stat().st_mtime_ns  # of its list of files: the watch writes each as a whole
        except OSError:
            return 0, None
        known = self._known.get(folder.name)
        return known if known is not None and known[0] == changed else (changed, _read(folder))

    def report(self, name: str) -> Path:
        """Return the report of a finding.

        Raises:
            ConfigurationError: there is none of that name.
        """
        path = self.directory / checked_name(name) / REPORT
        if path.is_symlink() or not path.is_file():
            raise ConfigurationError(f"no report '{name}'")
        return path


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
            str(content.get('window', {}).get('pair', ''))[:_LONGEST],
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
