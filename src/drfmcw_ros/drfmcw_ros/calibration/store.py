"""Where a station keeps its calibrations: one file per version, never changed, the newest holds."""

import dataclasses
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError

from .document import Document, implausible, now, read_document

_NAME = re.compile(r'(\d{6})\.yaml')
_STATION = re.compile(r'[A-Za-z_]\w*', re.ASCII)


def state_directory(environ: Mapping[str, str], given: str = '') -> Path:
    """Return the directory of what outlives a process: as given, systemd's, or that of the user (XDG)."""
    if given:
        return Path(given)
    if environ.get('STATE_DIRECTORY'):
        return Path(environ['STATE_DIRECTORY'].split(':')[0])
    home = environ.get('XDG_STATE_HOME') or str(Path(environ.get('HOME', '~')).expanduser() / '.local' / 'state')
    return Path(home) / 'drfmcw'


class CalibrationStore:
    """Calibrations of the stations whose state lies in one directory."""

    def __init__(self, state: Path | str) -> None:
        """Use the directory `calibration` in a state directory; it is made when the first document is stored."""
        self.directory = Path(state) / 'calibration'

    def stations(self) -> list[str]:
        """Return the names of stations with a stored calibration."""
        try:
            return sorted(entry.name for entry in self.directory.iterdir() if self.versions(entry.name))
        except OSError:
            return []

    def versions(self, station: str) -> list[int]:
        """Return the stored versions of a station, in order."""
        try:
            found = [_NAME.fullmatch(entry.name) for entry in self._of(station).iterdir()]
        except FileNotFoundError:
            return []
        except OSError as error:
            raise ConfigurationError(f'{self._of(station)}: {error.strerror}') from None
        return sorted(int(match[1]) for match in found if match)

    def path(self, station: str, version: int) -> Path:
        """Return the file of a version."""
        return self._of(station) / f'{version:06d}.yaml'

    def read(self, station: str, version: int | None = None) -> Document:
        """Return a version of a station's calibration, the newest by default.

        Raises:
            ConfigurationError: there is none, or it is damaged.
        """
        versions = self.versions(station)
        if not versions:
            raise ConfigurationError(f"no calibration of '{station}' is stored in {self.directory}")
        if version is not None and version not in versions:
            stored = f'{versions[0]} ... {versions[-1]}' if len(versions) > 1 else str(versions[0])
            raise ConfigurationError(f"'{station}' has no calibration of version {version}; stored: {stored}")
        chosen = versions[-1] if version is None else version
        document = read_document(self.path(station, chosen))
        if (document.station, document.version) != (station, chosen):
            raise ConfigurationError(
                f"{self.path(station, chosen)}: is version {document.version} of '{document.station}'"
            )
        return document

    def newest(self, station: str) -> Document | None:
        """Return the calibration that holds, None where none is stored; raises ConfigurationError as `read`."""
        return self.read(station) if self.versions(station) else None

    def add(self, document: Document, operator: str = '') -> Document:
        """Store a document under the next version; return it as stored.

        The file appears complete or not at all, also if the power fails, and replaces none.

        Raises:
            ConfigurationError: implausible, or the directory cannot be written.
        """
        refusal = implausible(document)
        if refusal:
            raise ConfigurationError(refusal)
        folder = self._of(document.station)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            while True:
                version = max(self.versions(document.station), default=0) + 1
                stored = dataclasses.replace(
                    document, version=version, date=now(), operator=operator or document.operator
                )
                if _write_once(self.path(document.station, version), stored.text()):
                    return stored
        except OSError as error:
            raise ConfigurationError(f'{folder}: {error.strerror or error}') from None

    def _of(self, station: str) -> Path:
        if not _STATION.fullmatch(station):
            raise ConfigurationError(f"'{station}' is no name of a station: letters, digits and _, no digit first")
        return self.directory / station


def _write_once(path: Path, text: str) -> bool:
    """Write a file that survives a power failure; return False where another process wrote one of that name."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f'.{path.name}.')
    try:
        with os.fdopen(handle, 'wb') as file:
            file.write(text.encode())
            os.fchmod(file.fileno(), 0o644)
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(name, path)
        except FileExistsError:
            return False
    finally:
        os.unlink(name)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
    return True
