"""Sessions: a signed cookie says who a browser belongs to; it ends with time, logout or a change of the password."""

import dataclasses
import hashlib
import secrets
import stat
import time
from pathlib import Path

from itsdangerous import BadData, URLSafeTimedSerializer

from drfmcw_physics.settings import ConfigurationError

from .passwords import Passwords, write_private

LIFETIME = 12 * 3600
"""Of a session [s]: a shift and its handover."""

_SECRET_BYTES = 32


@dataclasses.dataclass(frozen=True)
class Session:
    """One login of one user."""

    user: str
    number: str  # random, names the login
    begun: float  # wall clock [s]
    fingerprint: str  # of the password hash at login


class Sessions:
    """Issues and checks cookies; the secret that signs them stays in the state directory."""

    def __init__(self, directory: Path, passwords: Passwords) -> None:
        """Read the secret, or make one at the first start.

        Raises:
            ConfigurationError: the secret cannot be read or written, or others may read it.
        """
        self._passwords = passwords
        self._ended: dict[str, float] = {}  # number: when it would have ended anyway
        self._serializer = URLSafeTimedSerializer(read_secret(directory / 'secret'), salt='drfmcw host session')

    def begin(self, user: str) -> str:
        """Return the cookie of a new session."""
        return self._serializer.dumps([user, secrets.token_urlsafe(16), time.time(), self._fingerprint(user)])

    def of(self, cookie: str | None) -> Session | None:
        """Return the session that a cookie stands for, None where it stands for none (any more)."""
        if not cookie or len(cookie) > 1000:
            return None
        try:
            user, number, begun, fingerprint = self._serializer.loads(cookie, max_age=LIFETIME)
        except (BadData, ValueError, TypeError):
            return None
        session = Session(user, number, begun, fingerprint)
        return session if self.lives(session) else None

    def lives(self, session: Session) -> bool:
        """Return whether a session has neither been ended nor become too old, and the password is still the same."""
        if session.number in self._ended or time.time() - session.begun >= LIFETIME:
            return False
        current = self._fingerprint(session.user)
        return bool(current) and session.fingerprint == current

    def end(self, session: Session) -> None:
        """End a session: its cookie is worth nothing from here on."""
        now = time.time()
        self._ended = {n: end for n, end in self._ended.items() if end > now} | {session.number: now + LIFETIME}

    def _fingerprint(self, user: str) -> str:
        """Return a digest of the user's password hash: a new password ends the sessions of the old one."""
        known = self._passwords.users().get(user, '')
        return hashlib.sha256(known.encode()).hexdigest()[:16] if known else ''


def read_secret(path: Path) -> bytes:
    """Return the secret in a file, made of random bytes where there is none.

    Raises:
        ConfigurationError: it cannot be read or written, others may read it, or it is too short.
    """
    try:
        if stat.S_IMODE(path.stat().st_mode) & 0o077:
            raise ConfigurationError(f'{path}: others may read it; run rm {path}')
        secret = path.read_bytes()
    except FileNotFoundError:
        secret = secrets.token_bytes(_SECRET_BYTES)
        write_private(path, secret)
    except OSError as error:
        raise ConfigurationError(f'{path}: {error.strerror}') from None
    if len(secret) < _SECRET_BYTES:
        raise ConfigurationError(f'{path}: is too short for a secret; run rm {path}')
    return secret
