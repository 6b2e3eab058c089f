"""Users of the page: roles, hashed passwords, and the events of who asked for what.

Users of the page: a file with a line for each, and the scrypt hashes of their passwords.

    anna operator scrypt:16384:8:5:c2FsdA==:aGFzaA==

The name, the role and the hash (n, r, p, salt and hash in Base64), with blanks between them; lines
that begin with # are comments. `vcu-gateway web-user` prints such a line.
"""

import base64
import binascii
import hashlib
import hmac
import json
import os
import re
import stat
from collections import deque
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypedDict

from vcu_gateway.api.errors import Right
from vcu_gateway.errors import ConfigError, MissingInputError, Problem, did_you_mean
from vcu_gateway.text import say


class UserRole(Enum):
    """Role of a user; each has all that the ones before it have."""

    VIEWER = "viewer"
    OPERATOR = "operator"
    SERVICE = "service"

    @property
    def rights(self) -> frozenset[Right]:
        """Rights of the gateway that a user of this role may use through the page."""
        return _RIGHTS[self]


_RIGHTS: Mapping[UserRole, frozenset[Right]] = {
    UserRole.VIEWER: frozenset({Right.READ}),
    UserRole.OPERATOR: frozenset({Right.READ, Right.OPERATE}),
    UserRole.SERVICE: frozenset(Right),
}

ACTION_RIGHTS: Mapping[str, Right] = {
    "estop": Right.READ,
    "disarm": Right.READ,
    "arm": Right.OPERATE,
    "reset driver": Right.OPERATE,
    "reset service": Right.SERVICE,
}
"""As the gateway has it: whoever may look may stop. A demand is not among them."""


_KEPT = 200

Severity = Literal["info", "warning", "error"]


class WebEvent(TypedDict):
    """One event, as the gateway's own are shown."""

    name: str
    severity: Severity
    fields: dict[str, Any]
    time: str


class WebEvents:
    """The latest 200 events; each is a line of JSON, too, by default on stderr.

    `on_change` is called after each.
    """

    def __init__(self, write: Callable[[str], None] = say) -> None:
        self._write = write
        self._events: deque[WebEvent] = deque(maxlen=_KEPT)
        self.on_change: Callable[[], None] = lambda: None

    def tell(self, name: str, severity: Severity, **fields: object) -> None:
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        event: WebEvent = {"name": name, "severity": severity, "fields": fields, "time": time}
        self._events.append(event)
        line = {"event": name, "level": severity, "timestamp": time, **fields}
        self._write(json.dumps(line, ensure_ascii=False, default=str))
        self.on_change()

    def latest(self) -> list[WebEvent]:
        """The newest last."""
        return list(self._events)


LEAST_PASSWORD_CHARACTERS = 10
MOST_PASSWORD_CHARACTERS = 256

_COST, _BLOCK, _PARALLEL = 2**14, 8, 5
_COSTS, _BLOCKS, _PARALLELS = range(2**14, 2**17 + 1), range(8, 9), range(1, 17)
_SALT_BYTES, _HASH_BYTES = 16, 32
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,32}")
_REMEDY = "`vcu-gateway web-user NAME --role ROLE` prints a line for it"


class PasswordHash(NamedTuple):
    """Scrypt hash of a password, with its costs and salt."""

    cost: int
    block: int
    parallel: int
    salt: bytes
    digest: bytes

    @classmethod
    def of(cls, password: str) -> Self:
        """Hash of a new password, with a salt of its own."""
        blank = cls(_COST, _BLOCK, _PARALLEL, os.urandom(_SALT_BYTES), bytes(_HASH_BYTES))
        return blank._replace(digest=blank.derived(password))

    def derived(self, password: str) -> bytes:
        """Digest of this password with these costs and this salt; it takes about 0.2 s."""
        memory_bytes = 128 * self.block * (self.cost + self.parallel + 2)
        return hashlib.scrypt(
            password.encode(errors="replace"),
            salt=self.salt,
            n=self.cost,
            r=self.block,
            p=self.parallel,
            maxmem=memory_bytes + 2**20,
            dklen=_HASH_BYTES,
        )

    def matches(self, password: str) -> bool:
        """Whether this is the password; it takes as long whatever the answer."""
        return hmac.compare_digest(self.derived(password), self.digest)

    def text(self) -> str:
        salt, digest = (base64.b64encode(part).decode() for part in (self.salt, self.digest))
        return f"scrypt:{self.cost}:{self.block}:{self.parallel}:{salt}:{digest}"


class User(NamedTuple):
    """One user of the page."""

    name: str
    role: UserRole
    password: PasswordHash

    def line(self) -> str:
        return f"{self.name} {self.role.value} {self.password.text()}"


Users = Mapping[str, User]


def read(path: Path) -> Users:
    """Users of this file, by name.

    Raises:
        MissingInputError: it cannot be read.
        ConfigError: everything that is wrong with it, or with who may read it.
    """
    try:
        mode = path.stat().st_mode
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MissingInputError(Problem(f"cannot read the users: {error}", str(path))) from error
    if mode & (stat.S_IWGRP | stat.S_IROTH | stat.S_IWOTH):
        what = "others may read it, or change it"
        raise ConfigError(Problem(what, str(path), f"chmod g-w,o= {path}"))
    return parse(lines, str(path))


def parse(lines: list[str], where: str) -> Users:
    """Users of these lines; ConfigError names each wrong one, or that there is none."""
    users: dict[str, User] = {}
    problems: list[Problem] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        user = _user(line, f"{where}:{number}")
        if isinstance(user, User) and user.name in users:
            user = Problem(f"there is a user {user.name} already", f"{where}:{number}")
        if isinstance(user, Problem):
            problems.append(user)
        else:
            users[user.name] = user
    if not users and not problems:
        problems.append(Problem("has no user", where, _REMEDY))
    if problems:
        raise ConfigError(*problems)
    return users


def _user(line: str, where: str) -> User | Problem:
    fields = line.split()
    if len(fields) != len(User._fields):
        return Problem("is not NAME ROLE HASH", where, _REMEDY)
    name, role, text = fields
    roles = [one.value for one in UserRole]
    if not is_name(name):
        return Problem("the name has other characters than A-Z a-z 0-9 _ . -", where)
    if role not in roles:
        return Problem(f"no role {role}: {', '.join(roles)}", where, did_you_mean(role, roles))
    password = _password_hash(text)
    if password is None:
        return Problem("the hash is none of scrypt's", where, _REMEDY)
    return User(name, UserRole(role), password)


def is_name(text: str) -> bool:
    return _NAME.fullmatch(text) is not None


def _password_hash(text: str) -> PasswordHash | None:
    try:
        kind, cost, block, parallel, *coded = text.split(":")
        salt, digest = (base64.b64decode(part, validate=True) for part in coded)
        numbers = int(cost), int(block), int(parallel)
    except (ValueError, binascii.Error):
        return None
    ranges = (_COSTS, _BLOCKS, _PARALLELS)
    in_range = all(number in allowed for number, allowed in zip(numbers, ranges, strict=True))
    power_of_two = numbers[0] & (numbers[0] - 1) == 0
    sizes = len(salt) >= _SALT_BYTES and len(digest) == _HASH_BYTES
    if kind != "scrypt" or not (in_range and power_of_two and sizes):
        return None
    return PasswordHash(*numbers, salt, digest)


NOBODY = PasswordHash(_COST, _BLOCK, _PARALLEL, bytes(_SALT_BYTES), bytes(_HASH_BYTES))
"""For a name that is none: the answer takes as long, and no password has this digest."""
