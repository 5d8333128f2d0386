"""The recordings in one directory: listed, archived, deleted; no name reaches anything outside of it."""

import dataclasses
import re
import shutil
import tarfile
from collections.abc import Iterator
from pathlib import Path

from drfmcw_physics.settings import ConfigurationError

_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9_.-]{0,99}')
_CHUNK = 1 << 18  # bytes read at a time
_BLOCK = 512  # of a tar archive
_STORAGE = ('*.mcap', '*.db3')
RESULTS = '.results'
"""Folder beside the recordings with what was computed from each."""


@dataclasses.dataclass(frozen=True)
class Recording:
    """One recording as the page lists it."""

    name: str
    size: int  # [bytes]
    begun: float  # wall clock [s]
    complete: bool  # its metadata was written at the end
    results: tuple[str, ...]  # names of files computed from it


def checked_name(name: str) -> str:
    """Return a name that can be that of a recording.

    Raises:
        ConfigurationError: it could lead elsewhere.
    """
    if not _NAME.fullmatch(name):
        raise ConfigurationError(f'name {name[:40]!r}: use letters, digits, ".", "_" and "-", at most 100')
    return name


class Recordings:
    """The directory that holds recordings, one folder each."""

    def __init__(self, directory: Path) -> None:
        """Make the directory where it is not there.

        Raises:
            ConfigurationError: it cannot be made.
        """
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigurationError(f'{directory}: {error.strerror}') from None
        self.directory = directory.resolve()

    def new_path(self, name: str) -> Path:
        """Return the path of a recording to be made.

        Raises:
            ConfigurationError: the name is not acceptable or taken.
        """
        path = self.directory / checked_name(name)
        if path.exists() or path.is_symlink():
            raise ConfigurationError(f"'{name}' exists already")
        return path

    def path(self, name: str) -> Path:
        """Return the path of a recording.

        Raises:
            ConfigurationError: there is none of that name.
        """
        path = self.directory / checked_name(name)
        if path.is_symlink() or not path.is_dir() or not _holds_recording(path):
            raise ConfigurationError(f"no recording '{name}'")
        return path

    def results(self, name: str) -> Path:
        """Return the folder for what is computed from a recording.

        Raises:
            ConfigurationError: the name could lead elsewhere.
        """
        return self.directory / RESULTS / checked_name(name)

    def list(self) -> list[Recording]:
        """Return all recordings, the newest first."""
        found = []
        for path in self.directory.iterdir():
            if not _NAME.fullmatch(path.name) or path.is_symlink() or not path.is_dir() or not _holds_recording(path):
                continue
            files = [file.stat() for file in path.iterdir() if file.is_file()]
            begun = min(status.st_ctime for status in files)
            results = self.results(path.name)
            names = tuple(sorted(f.name for f in results.iterdir() if f.is_file())) if results.is_dir() else ()
            complete = (path / 'metadata.yaml').is_file()
            found.append(Recording(path.name, sum(s.st_size for s in files), begun, complete, names))
        return sorted(found, key=lambda recording: -recording.begun)

    def size(self, name: str) -> int:
        """Return the bytes of a recording so far, 0 where there is none yet."""
        path = self.directory / checked_name(name)
        return sum(f.stat().st_size for f in path.iterdir() if f.is_file()) if path.is_dir() else 0

    def delete(self, name: str) -> None:
        """Delete a recording and what was computed from it.

        Raises:
            ConfigurationError: there is none of that name, or it cannot be deleted.
        """
        path = self.path(name)
        try:
            shutil.rmtree(path)
            shutil.rmtree(self.results(name), ignore_errors=True)
        except OSError as error:
            raise ConfigurationError(f'{name}: {error.strerror}') from None

    def archive(self, name: str) -> Iterator[bytes]:
        """Yield a recording as an uncompressed tar archive, piece by piece.

        Raises:
            ConfigurationError: there is none of that name.
        """
        path = self.path(name)
        files = sorted(f for f in path.iterdir() if f.is_file() and not f.is_symlink())
        return _tar(name, files)

    def disk(self) -> tuple[int, int]:
        """Return (free, total) bytes of the disk."""
        usage = shutil.disk_usage(self.directory)
        return usage.free, usage.total


def _holds_recording(path: Path) -> bool:
    return any(True for pattern in _STORAGE for _ in path.glob(pattern))


def _tar(name: str, files: list[Path]) -> Iterator[bytes]:
    for file in files:
        with file.open('rb') as content:
            info = tarfile.TarInfo(f'{name}/{file.name}')
            status = file.stat()
            info.size, info.mtime = status.st_size, int(status.st_mtime)
            yield info.tobuf(tarfile.PAX_FORMAT)
            left = info.size  # of a recording that still grows, what was there at first
            while left and (chunk := content.read(min(left, _CHUNK))):
                left -= len(chunk)
                yield chunk
            yield b'\0' * (left + -info.size % _BLOCK)
    yield b'\0' * 2 * _BLOCK
