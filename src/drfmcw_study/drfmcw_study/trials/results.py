"""The files of a study: a manifest that says which study it is, and one file per batch, written whole or not at all."""

import contextlib
import fcntl
import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically
from drfmcw_ros.commands.versions import versions

from .study import Job, Study, StudyStopped

_MANIFEST = 'manifest.json'
_LOCK = '.lock'


class ResultDirectory:
    """The files of one study; a context that holds the directory's lock."""

    def __init__(self, path: Path | str, study: Study) -> None:
        """Name the directory; it is made or checked on entering.

        Args:
            path: of the directory.
            study: whose results it holds.
        """
        self.path, self.study = Path(path), study
        self._lock = contextlib.ExitStack()

    def __enter__(self) -> 'ResultDirectory':
        """Make the directory, or check that it holds this study.

        Raises:
            ConfigurationError: it holds something else, is in use, or cannot be written.
        """
        with contextlib.ExitStack() as stack:
            self._take(stack)
            self._lock = stack.pop_all()
        return self

    def _take(self, stack: contextlib.ExitStack) -> None:
        """Lock the directory, and make or check what it holds."""
        manifest = self.path / _MANIFEST
        wanted = self._content()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not manifest.exists() and any(p.name != _LOCK for p in self.path.iterdir()):
                raise ConfigurationError(f'{self.path}: is not empty and holds no Monte Carlo study; choose another')
            lock = stack.enter_context(open(self.path / _LOCK, 'a'))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigurationError(f'{self.path}: another run is working on this study') from None
        except OSError as error:
            raise ConfigurationError(f'{self.path}: {error.strerror}') from None
        if manifest.exists():
            try:
                there = json.loads(manifest.read_text(encoding='utf-8'))
            except (OSError, ValueError) as error:
                raise ConfigurationError(f'{manifest}: cannot be read: {error}') from None
            change = difference(there, wanted)
            if change:
                raise ConfigurationError(f'{self.path}: holds another study: {change}; choose another directory')
        else:
            write_atomically(manifest, json.dumps(wanted, indent=1) + '\n')

    def __exit__(self, *exception: object) -> None:
        """Let others in."""
        self._lock.close()

    def _content(self) -> dict[str, Any]:
        study = self.study
        content = {
            'trials': study.trials,
            'batch': study.batch,
            'points': list(study.points),
            'versions': versions(study.packages),
        }
        return json.loads(json.dumps(content, default=str))

    def missing(self) -> list[Job]:
        """Return the batches that are not there yet, or cannot be read."""
        points = range(len(self.study.points))
        return [job for point in points for job in self.study.jobs(point) if self._read(job) is None]

    def store(self, job: Job, arrays: Mapping[str, np.ndarray]) -> None:
        """Write one batch, whole or not at all.

        Raises:
            StudyStopped: it cannot be written.
        """
        content, named = io.BytesIO(), dict[str, Any](arrays)
        np.savez(content, **named)
        path = job.file(self.path)
        try:
            path.parent.mkdir(exist_ok=True)
            write_atomically(path, content.getvalue())
        except (OSError, ConfigurationError) as error:
            raise StudyStopped(f'cannot write results: {error}') from None

    def batches(self, point: int) -> Iterator[dict[str, np.ndarray]]:
        """Yield a point's stored batches one by one, in order.

        Raises:
            StudyStopped: one is not there.
        """
        for job in self.study.jobs(point):
            arrays = self._read(job)
            if arrays is None:
                raise StudyStopped(f'{job.file(self.path)}: is missing')
            yield arrays

    def _read(self, job: Job) -> dict[str, np.ndarray] | None:
        """Return a batch, None where it is missing or damaged, as the archive's checksums show."""
        try:
            with open(job.file(self.path), 'rb') as file, np.load(file) as archive:
                arrays = {name: archive[name] for name in archive.files}
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            return None
        return arrays if arrays and all(len(a) == len(job.sweeps) for a in arrays.values()) else None


def difference(there: Any, here: Any, name: str = '') -> str:
    """Return the first difference between two JSON values in words, '' where there is none."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in sorted({*there, *here}):
            change = difference(there.get(key), here.get(key), f'{name}.{key}' if name else key)
            if change:
                return change
        return ''
    if isinstance(there, list) and isinstance(here, list):
        if len(there) != len(here):
            return f'{len(there)} {name} there, {len(here)} here'
        changes = (difference(a, b, f'{name}.{i}') for i, (a, b) in enumerate(zip(there, here, strict=True)))
        return next((change for change in changes if change), '')
    same = there == here or (there != there and here != here)  # NaN stands for itself
    return '' if same else f'{name} is {there} there, {here} here'
