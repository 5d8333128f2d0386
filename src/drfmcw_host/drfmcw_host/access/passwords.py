"""Users and their argon2 hashes, in a file that only its owner reads."""

import json
import os
import re
import stat
from pathlib import Path

import argon2

from drfmcw_physics.settings import ConfigurationError
from drfmcw_ros.commands.cli import write_atomically

SHORTEST = 10
"""Letters that a password has at least."""

_LONGEST = 1000  # letters that are hashed; longer ones only cost time
_USER = re.compile(r'[A-Za-z0-9][A-Za-z0-9._-]{0,31}')


class Passwords:
    """The password file: user names and argon2id hashes as JSON, mode 0600."""

    def __init__(self, path: Path) -> None:
        """Use the file at `path`, which need not exist."""
        self.path = path
        self._hasher = argon2.PasswordHasher()
        self._nobody = self._hasher.hash(os.urandom(16).hex())

    def users(self) -> dict[str, str]:
        """Return user: hash, empty without a file.

        Raises:
            ConfigurationError: the file is damaged, or others may read or write it.
        """
        try:
            status = self.path.stat()
            content = self.path.read_text(encoding='utf-8')
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise ConfigurationError(f'{self.path}: {error.strerror}') from None
        if stat.S_IMODE(status.st_mode) & 0o077:
            raise ConfigurationError(f'{self.path}: others may read or write it; run chmod 600 {self.path}')
        try:
            users = json.loads(content)
        except ValueError:
            users = None
        if not isinstance(users, dict) or not all(isinstance(v, str) for v in users.values()):
            raise ConfigurationError(f'{self.path}: is no password file')
        return users

    def set(self, user: str, password: str) -> None:
        """Set a user's password, and with it the user.

        Raises:
            ConfigurationError: the name or the password is not acceptable, or the file cannot be written.
        """
        if not _USER.fullmatch(user):
            raise ConfigurationError(f'user {user!r}: use letters, digits, ".", "_" and "-", at most 32')
        if not SHORTEST <= len(password) <= _LONGEST:
            raise ConfigurationError(f'a password has {SHORTEST} to {_LONGEST} letters')
        write_private(self.path, json.dumps(self.users() | {user: self._hasher.hash(password)}, indent=1) + '\n')

    def verify(self, user: str, password: str) -> bool:
        """Return whether the password is that of the user; takes the same time for users that are not there."""
        known = self.users().get(user)
        try:
            self._hasher.verify(known or self._nobody, password[:_LONGEST])
        except (argon2.exceptions.VerificationError, argon2.exceptions.InvalidHashError):
            return False
        return known is not None


def write_private(path: Path, content: str | bytes) -> None:
    """Write a file that only its owner can read, in a directory that is made where it is not there.

    Raises:
        ConfigurationError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror or error}') from None
    write_atomically(path, content, private=True)
