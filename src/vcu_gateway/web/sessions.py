"""Sessions of browsers: random tokens, kept as hashes, over a restart in a file."""

import contextlib
import hashlib
import json
import secrets
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from vcu_gateway import files

_TOKEN_BYTES = 32
SESSIONS_PER_USER = 16
_STOPS_FOR_S = 24 * 3600
_STEP_S = 1.0


def now_s() -> float:
    """Seconds since the boot, suspended ones too: setting the clock ends no session."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def wall_clock_ahead_s() -> float:
    """Difference of the wall clock to `now_s`, which changes where the clock is set."""
    return time.time() - now_s()


class BrowserSession(NamedTuple):
    """One browser that has signed in; the times are those of `now_s`."""

    user: str
    began_s: float
    expires_s: float

    def is_open(self, now_s: float) -> bool:
        """Whether it may look and act."""
        return self.began_s - 1 <= now_s < self.expires_s

    def may_stop(self, now_s: float) -> bool:
        """Whether it may stop the vehicle: for a day longer than it may look."""
        return self.is_open(now_s) or now_s < self.expires_s + _STOPS_FOR_S


class Sessions:
    """Sessions by the hash of their token; of one user's 17 the oldest ends, and nobody else's.

    Args:
        lifetime_s: how long one lasts.
        file: where they are kept over a restart of this program; None keeps them in memory. Its
            times are those of the wall clock, for it may be read after another boot.
        ahead_s: difference of the wall clock to `now_s`.
    """

    def __init__(
        self,
        lifetime_s: float,
        file: Path | None = None,
        ahead_s: Callable[[], float] = wall_clock_ahead_s,
    ) -> None:
        self._lifetime_s = lifetime_s
        self._file = file
        self._ahead_s = ahead_s
        self._written_ahead_s = ahead_s()
        self._sessions = _load(file, self._written_ahead_s) if file is not None else {}

    def open(self, user: str, now_s: float) -> str:
        """A new session; the token is for the browser's cookie and kept nowhere."""
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        self._forget_ended(now_s)
        self._make_room(user)
        self._sessions[_key(token)] = BrowserSession(user, now_s, now_s + self._lifetime_s)
        self._save()
        return token

    def find(self, token: str) -> BrowserSession | None:
        """The session of this token, ended or not; None for a token that is none."""
        if abs(self._ahead_s() - self._written_ahead_s) > _STEP_S:
            self._save()  # the clock was set: a restart is to find them where they were
        return self._sessions.get(_key(token))

    def close(self, token: str) -> None:
        """End a session at once, its right to stop too."""
        if self._sessions.pop(_key(token), None) is not None:
            self._save()

    def _make_room(self, user: str) -> None:
        own = [key for key, one in self._sessions.items() if one.user == user]
        for key in own[: max(0, len(own) + 1 - SESSIONS_PER_USER)]:
            del self._sessions[key]

    def _forget_ended(self, now_s: float) -> None:
        kept = {key: one for key, one in self._sessions.items() if one.may_stop(now_s)}
        self._sessions = kept

    def _save(self) -> None:
        """Write a new file and rename it: a session is whole or not there."""
        self._written_ahead_s = ahead_s = self._ahead_s()
        if self._file is None:
            return
        written = {
            key: (one.user, one.began_s + ahead_s, one.expires_s + ahead_s)
            for key, one in self._sessions.items()
        }
        with contextlib.suppress(OSError):  # a full disk keeps nobody from signing in
            files.replace(self._file, json.dumps(written), 0o600)


def _key(token: str) -> str:
    return hashlib.sha256(token.encode(errors="replace")).hexdigest()


def _load(file: Path, ahead_s: float) -> dict[str, BrowserSession]:
    """Sessions of the run before; none where the file is missing or damaged."""
    try:
        written = json.loads(file.read_text())
        return {
            str(key): BrowserSession(
                str(user), float(began_s) - ahead_s, float(expires_s) - ahead_s
            )
            for key, (user, began_s, expires_s) in written.items()
        }
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
