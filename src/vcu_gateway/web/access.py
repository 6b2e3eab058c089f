"""Who asks: the session's user and role, signing in and signing out.

Sessions of browsers: random tokens, kept as hashes, over a restart in a file.
"""

import asyncio
import contextlib
import hashlib
import json
import secrets
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from starlette.requests import Request
from starlette.responses import Response

from vcu_gateway import files
from vcu_gateway.api.errors import Right
from vcu_gateway.web.connections import LoginLimit, counted, has_session
from vcu_gateway.web.guard import PageRequestError
from vcu_gateway.web.settings import WebSettings
from vcu_gateway.web.users import MOST_PASSWORD_CHARACTERS, NOBODY, UserRole, WebEvents, is_name

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
        self._sessions = {key: one for key, one in self._sessions.items() if one.may_stop(now_s)}
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


_WAITING = 16
_WAITING_OF_NAME = 2
_WAITING_OF_ADDRESS = 4


class Visitor(NamedTuple):
    """Who asks.

    Attributes:
        user: empty where there are no users.
        looks: False for a session that has ended and may only stop the vehicle.
    """

    user: str
    role: UserRole
    address: str
    looks: bool

    def may(self, right: Right) -> bool:
        return right in self.role.rights

    def fields(self) -> dict[str, str]:
        """Who it is, in an event."""
        user = self.user or "(no users)"
        return {"user": user, "role": self.role.value, "address": self.address}


class Access:
    """Users, their sessions, and the limit on attempts."""

    def __init__(self, settings: WebSettings, events: WebEvents) -> None:
        self._settings = settings
        self._events = events
        self._sessions = Sessions(settings.session_lifetime_s, settings.state_file)
        self._limit = LoginLimit()
        self._one_at_a_time = asyncio.Semaphore(1)
        self._names_waiting: Counter[str] = Counter()
        self._addresses_waiting: Counter[str] = Counter()
        # Browsers take the first name from this host alone, and over TLS alone.
        self.cookie = "__Host-vcu-session" if settings.tls else "vcu-session"

    @property
    def has_users(self) -> bool:
        return bool(self._settings.users)

    def visitor(self, request: Request) -> Visitor | None:
        """Who asks; None for whoever has never signed in, or whose user is gone."""
        address = request.client.host if request.client else ""
        if not self.has_users:
            has_session(request.scope)
            return Visitor("", self._settings.local_role, address, looks=True)
        session = self._sessions.find(request.cookies.get(self.cookie, ""))
        user = self._settings.users.get(session.user) if session else None
        if session is None or user is None or not session.may_stop(now_s()):
            return None
        has_session(request.scope)
        looks = session.is_open(now_s())
        return Visitor(user.name, user.role, address, looks)

    async def sign_in(self, name: str, password: str, address: str) -> tuple[str, UserRole]:
        """Token and role of a new session; PageRequestError where it is refused."""
        wait_s = self._limit.wait_s(address, name, time.monotonic_ns())
        if wait_s > 0 or self._too_many_wait(name, address):
            self._events.tell("sign_in_limited", "warning", user=_told(name), address=address)
            wait_s = max(1, wait_s)
            sentence = f"too many attempts: try again in {wait_s} s"
            raise PageRequestError(429, sentence, {"retry-after": str(wait_s)})
        if not await self._is_right(name, password, address):
            self._limit.failed(address, name, time.monotonic_ns())
            self._events.tell("sign_in_failed", "warning", user=_told(name), address=address)
            raise PageRequestError(401, "name or password is wrong")
        self._limit.succeeded(address)
        role = self._settings.users[name].role
        self._events.tell("signed_in", "info", user=name, role=role.value, address=address)
        return self._sessions.open(name, now_s()), role

    def _too_many_wait(self, name: str, address: str) -> bool:
        """Each name and each address has a part of the room, so that none keeps others out."""
        return (
            self._names_waiting.total() >= _WAITING
            or self._names_waiting[name] >= _WAITING_OF_NAME
            or self._addresses_waiting[address] >= _WAITING_OF_ADDRESS
        )

    async def _is_right(self, name: str, password: str, address: str) -> bool:
        if len(password) > MOST_PASSWORD_CHARACTERS:
            return False
        user = self._settings.users.get(name)
        hashed = user.password if user else NOBODY
        with counted(self._names_waiting, name), counted(self._addresses_waiting, address):
            async with self._one_at_a_time:
                matches = await asyncio.to_thread(hashed.matches, password)
        return matches and user is not None

    def sign_out(self, request: Request) -> None:
        visitor = self.visitor(request)
        self._sessions.close(request.cookies.get(self.cookie, ""))
        if visitor is not None and visitor.user:
            self._events.tell("signed_out", "info", user=visitor.user, address=visitor.address)

    def set_cookie(self, response: Response, token: str) -> None:
        """Give the browser its token: no script reads it, no other site sends it."""
        response.set_cookie(
            self.cookie,
            token,
            max_age=int(self._settings.session_lifetime_s) + _STOPS_FOR_S,
            path="/",
            secure=self._settings.tls is not None,
            httponly=True,
            samesite="strict",
        )


def _told(name: str) -> str:
    """A name for the log: whatever else was typed, such as a password, stays out of it."""
    return name if is_name(name) else "(no name)"
