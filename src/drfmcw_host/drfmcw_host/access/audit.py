"""Audit log: one JSON line per login and change, with time, user, address and action; never a secret."""

import collections
import datetime
import json
import os
import threading
from pathlib import Path
from typing import Any

from drfmcw_physics.settings import ConfigurationError

_LONGEST = 500  # letters of one text
_LARGEST = 10_000_000  # bytes, from which on the log is moved to .1
_REMEMBERED = 200  # newest entries kept in memory


class Audit:
    """Appends to audit.jsonl in the state directory and keeps the newest entries for the page."""

    def __init__(self, path: Path) -> None:
        """Read the newest entries.

        Raises:
            ConfigurationError: the log cannot be opened for writing.
        """
        self._path = path
        self._lock = threading.Lock()
        self.entries: collections.deque[dict[str, Any]] = collections.deque(maxlen=_REMEMBERED)
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600))
            for line in path.read_text(encoding='utf-8', errors='replace').splitlines()[-_REMEMBERED:]:
                self._remember(line)
        except OSError as error:
            raise ConfigurationError(f'{path}: {error.strerror}') from None

    def _remember(self, line: str) -> None:
        try:
            entry = json.loads(line)
        except ValueError:  # cut off by a crash
            return
        if isinstance(entry, dict):
            self.entries.append(entry)

    def write(self, user: str, address: str, action: str, **details: Any) -> None:
        """Append one line: who did what from where, now (UTC)."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec='milliseconds')
        entry: dict[str, Any] = {'time': now, 'user': user, 'address': address, 'action': action}
        entry |= {name: value[:_LONGEST] if isinstance(value, str) else value for name, value in details.items()}
        entry['user'] = entry['user'][:_LONGEST]
        with self._lock:
            if self._path.exists() and self._path.stat().st_size > _LARGEST:
                self._path.replace(self._path.with_suffix('.jsonl.1'))
            with os.fdopen(os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), 'a') as file:
                file.write(json.dumps(entry) + '\n')
            self.entries.append(entry)
