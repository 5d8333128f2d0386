"""Calibrations of the stations: what this machine's stations keep, and what the host has seen or stored."""

import dataclasses
import hashlib
import re
from pathlib import Path

from drfmcw_physics.oscillators import Calibration
from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.calibration.document import Document, from_calibration, implausible, read_document
from drfmcw_ros.calibration.store import CalibrationStore
from drfmcw_ros.commands.cli import write_atomically

_STATION = re.compile(r'[A-Za-z_]\w{0,99}', re.ASCII)
_LARGEST = 200  # calibrations kept of a station: nothing on the network fills the disk

Key = tuple[int, str]
"""Version, and a digest of the values: a station that lost its store counts from 1 again."""


class Calibrations:
    """One folder per station, one file per calibration that was ever in use while the host ran."""

    def __init__(self, directory: Path, local: CalibrationStore) -> None:
        """Keep calibrations in a directory; `local` is where stations of this machine keep theirs."""
        self.directory = directory
        self._local = local
        self._read: dict[Path, tuple[int, Document]] = {}

    def see(self, calibration: Calibration) -> None:
        """Keep a calibration that a station publishes; raises ConfigurationError where it cannot be kept."""
        document = from_calibration(calibration)
        if not implausible(document) and not self._path(document).exists():
            self.keep(document)

    def keep(self, document: Document) -> None:
        """Keep a document as a station stored it; raises ConfigurationError where it cannot be kept."""
        path = self._path(document)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists() or len(list(path.parent.iterdir())) < _LARGEST:
                write_atomically(path, document.text())
        except OSError as error:
            raise ConfigurationError(f'{path.parent}: {error.strerror}') from None

    def of(self, station: str) -> list[Document]:
        """Return the known calibrations of a station, the newest version first; damaged ones are left out."""
        if not _STATION.fullmatch(station):
            return []
        found: dict[Key, Document] = {}
        for path in self._files(station):
            document = self._cached(path)
            if document is not None and document.station == station:
                found[key_of(document.calibration())] = document
        return sorted(found.values(), key=lambda d: (d.version, d.date), reverse=True)

    def known(self, calibration: Calibration) -> Document:
        """Return the document of a calibration in use: with date, operator and note where it is known."""
        key = key_of(calibration)
        same = (d for d in self.of(calibration.station) if key_of(d.calibration()) == key)
        return next(same, from_calibration(calibration))

    def _files(self, station: str) -> list[Path]:
        """Return the files of a station; later ones say more about the same calibration."""
        own = self.directory / station
        files = sorted(own.glob('*.yaml')) if own.is_dir() else []
        try:
            return files + [self._local.path(station, version) for version in self._local.versions(station)]
        except ConfigurationError:
            return files

    def _cached(self, path: Path) -> Document | None:
        try:
            changed = path.stat().st_mtime_ns
            if path not in self._read or self._read[path][0] != changed:
                self._read[path] = (changed, read_document(path))
        except (OSError, ConfigurationError):
            return None
        return self._read[path][1]

    def _path(self, document: Document) -> Path:
        if not _STATION.fullmatch(document.station):
            raise ConfigurationError(f'{document.station[:40]!r} is no name of a station')
        version, digest = key_of(document.calibration())
        return self.directory / document.station / f'{version:06d}-{digest}.yaml'


def key_of(calibration: Calibration) -> Key:
    """Return what distinguishes calibrations of one station."""
    values = dataclasses.astuple(dataclasses.replace(calibration, version=0, stamp=0, frame_id=''))
    return calibration.version, hashlib.sha256(repr(values).encode()).hexdigest()[:8]
