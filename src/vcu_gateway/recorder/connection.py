"""Connection of a gateway: who it is, what it may hand over, and its datagrams.

The limits are far above what a gateway sends: a checkpoint of it has 5 kB, both texts of its HELLO
40 kB. A line is checked for its shape only; whether it makes sense is the reader's question.
"""

import contextlib
import json
import math
import os
import pwd
import re
import socket
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.recording import datagram
from vcu_gateway.recording.datagram import DatagramError, HelloPart, HelloText, TickParts

GATEWAY_USER = "vcu-gateway"
_CREDENTIALS = struct.Struct("iII")
_SAY_EVERY_S = 10.0
_MOST_RUNS = 256


class Sender(NamedTuple):
    """Process at the other end, as the kernel saw it connect (SO_PEERCRED)."""

    pid: int
    uid: int
    gid: int

    def __str__(self) -> str:
        return f"process {self.pid} of user {_user(self.uid)}"


def sender_of(sock: socket.socket) -> Sender:
    """The process that connected; OSError where the kernel does not say."""
    found = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return Sender(*_CREDENTIALS.unpack(found))


def trusted_users(gateway_user: str | None) -> frozenset[int]:
    """Ids of those who may hand over: root, the recorder's own user, the gateway's.

    None: `vcu-gateway`, where that user exists. UnavailableError where a named one does not.
    """
    trusted = {0, os.geteuid()}
    try:
        trusted.add(pwd.getpwnam(gateway_user or GATEWAY_USER).pw_uid)
    except KeyError as error:
        if gateway_user is not None:
            remedy = "name the user that the gateway runs as; look at: getent passwd"
            what = f"there is no user {gateway_user} (--gateway-user)"
            raise UnavailableError(Problem(what, remedy=remedy)) from error
    return frozenset(trusted)


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


class RunOwners:
    """Which process each run is of: the one that named it first, as long as that one lives."""

    def __init__(self) -> None:
        self._owners: dict[str, Sender] = {}

    def other(self, run: str, sender: Sender) -> Sender | None:
        """The process that has this run already; None where it is the sender's now."""
        owner = self._owners.get(run)
        if owner is not None and owner != sender and _lives(owner.pid):
            return owner
        while len(self._owners) >= _MOST_RUNS:
            del self._owners[self._least_wanted()]
        self._owners[run] = sender
        return None

    def _least_wanted(self) -> str:
        """A run whose process is gone, else the oldest of the process that named most.

        Whoever names many runs must not make another one's forgotten.
        """
        gone = (run for run, owner in self._owners.items() if not _lives(owner.pid))
        most = Counter(self._owners.values()).most_common(1)[0][0]
        of_most = (run for run, owner in self._owners.items() if owner == most)
        return next(gone, None) or next(of_most)


def _lives(pid: int) -> bool:
    """False where that process is gone, or is one that the kernel does not name."""
    if pid <= 0:
        return False
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except OSError:
        return False
    return True


class Allowance:
    """Token bucket: bursts of `burst`, and `a_second` in the long run."""

    def __init__(self, burst: float, a_second: float) -> None:
        self._burst, self._a_second = burst, a_second
        self._left, self._at_s = burst, time.monotonic()

    def take(self) -> bool:
        now_s = time.monotonic()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._a_second)
        self._at_s = now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True


class Refusals:
    """Counts what was refused by its reason; a line in the log, of each at most one in 10 s.

    Attributes:
        counts: by reason, since the start.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self._say = say
        self._said_s: dict[str, float] = {}

    def note(self, reason: str, sentence: str) -> None:
        self.counts[reason] += 1
        now_s = time.monotonic()
        said_s = self._said_s.get(reason)
        if said_s is None or now_s - said_s >= _SAY_EVERY_S:
            self._said_s[reason] = now_s
            count = self.counts[reason]
            self._say(f"{sentence} (number {count} of this kind)" if count > 1 else sentence)


MOST_LINES_BYTES = 512 << 10
"""Of the core lines in one datagram."""

_MOST_LINES = 10_000
_MOST_TEXT_BYTES = 256 << 10
_MOST_REST = 5_000
_MOST_DEPTH = 8
_MOST_WORD = 1_000
_LARGEST = (1 << 63) - 1
_RUN = re.compile(r"[0-9A-Za-z._-]{1,64}", re.ASCII)
_LONGEST_CHANNEL = 64
_TEXTS = ("config", "dbc")
_OF_THE_RECORDER = ("begin", "gap", "end")
_COUNTS = ("f", "tick", "restarted")


def checked_hello(hello: Mapping[str, Any]) -> Mapping[str, Any]:
    """The HELLO; DatagramError where the recorder cannot use it."""
    run, channel, clock = hello.get("run"), hello.get("channel"), hello.get("clock")
    if not isinstance(run, str) or not _RUN.fullmatch(run):
        raise _hello("has no run id of up to 64 plain characters")
    if not isinstance(channel, str) or not _is_channel(channel):
        raise _hello(f"has no channel of up to {_LONGEST_CHANNEL} printable characters")
    if not isinstance(clock, dict) or not all(
        _is_count(clock.get(key)) for key in ("monotonic_ns", "wall_ns")
    ):
        raise _hello("has no clock of two 64-bit numbers")
    for key in _TEXTS:
        if not _is_text(hello.get(key), _MOST_TEXT_BYTES):
            raise _hello(f"has no {key} of up to {_MOST_TEXT_BYTES >> 10} KiB of Unicode")
    left = _left_of({key: value for key, value in hello.items() if key not in _TEXTS}, _MOST_REST)
    if left < 0:
        raise _hello("has a value that is too long, too deep or no finite number")
    return hello


def check_lines(lines: bytes) -> None:
    """DatagramError where these core lines are not those of a gateway."""
    if not lines:
        return
    if len(lines) > MOST_LINES_BYTES:
        raise _lines(f"are {len(lines)} bytes, and {MOST_LINES_BYTES} are the most")
    if b"\r" in lines or lines.count(b"\n") > _MOST_LINES:
        raise _lines(f"are more than {_MOST_LINES}, or not parted by line ends alone")
    try:
        for number, line in enumerate(lines.decode().split("\n")[:-1]):
            _check(json.loads(line, parse_constant=_refuse, parse_float=_finite), number)
    except (ValueError, RecursionError) as error:
        if isinstance(error, DatagramError):
            raise
        raise _lines(f"are no JSON: {str(error)[:100]}") from error


def _check(values: Any, number: int) -> None:
    if not isinstance(values, dict) or "f" not in values:
        raise _lines("have one that is no object with f")
    if not all(_is_count(values[key]) for key in _COUNTS if key in values):
        raise _lines("have a count or a clock that is no 64-bit number")
    if not _are_events(values.get("events", [])):
        raise _lines("have events that are no list of name, severity and fields")
    if any(key in values for key in _OF_THE_RECORDER):
        raise _lines("have one that only the recorder writes")
    if "checkpoint" in values:
        state = values["checkpoint"]
        counted = isinstance(state, dict) and all(_is_count(state.get(key)) for key in _STATE)
        if number > 0 or not counted:
            raise _lines("have a checkpoint that is not the first, or without its counts")


_STATE = ("ticks", "frames")


def _are_events(events: Any) -> bool:
    return isinstance(events, list) and all(
        isinstance(one, list)
        and len(one) == 3
        and isinstance(one[0], str)
        and isinstance(one[1], str)
        and isinstance(one[2], dict)
        for one in events
    )


def _is_count(value: Any) -> bool:
    """True for an integer, and no bool, of 0 to 2**63 - 1."""
    return type(value) is int and 0 <= value <= _LARGEST


def _is_channel(channel: str) -> bool:
    return 0 < len(channel) <= _LONGEST_CHANNEL and channel.isprintable() and " " not in channel


def _is_text(value: Any, most_bytes: int) -> bool:
    """True for Unicode of at most that many bytes in memory; a lone surrogate is none."""
    if not isinstance(value, str) or sys.getsizeof(value) > most_bytes:
        return False
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def _left_of(value: Any, room: int, depth: int = 0) -> int:
    """How many values there is still room for; negative where one cannot be kept."""
    if value is None or isinstance(value, bool):
        return room - 1
    if isinstance(value, int):
        return room - 1 if abs(value) <= _LARGEST else -1
    if isinstance(value, float):
        return room - 1 if math.isfinite(value) else -1
    if isinstance(value, str):
        return room - 1 if _is_text(value, _MOST_WORD) else -1
    if depth >= _MOST_DEPTH:
        return -1
    inner = [*value.keys(), *value.values()] if isinstance(value, dict) else value
    for one in inner:
        room = _left_of(one, room, depth + 1)
        if room < 0:
            return room
    return room - 1


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits[:20]} is no finite number")
    return value


def _refuse(word: str) -> float:
    raise ValueError(f"{word} is no number of JSON")


def _hello(what: str) -> DatagramError:
    return DatagramError(f"its HELLO {what}", "hello")


def _lines(what: str) -> DatagramError:
    return DatagramError(f"its core lines {what}", "core_lines")


BUFFER_BYTES = 1 << 20
"""Room for the longest datagram."""
_MOST_FRAMES = 50_000
_MOST_COUNT = 1 << 63
_CHECKPOINTS = 20, 4.0
"""At once, and a second: a gateway that loses datagrams sends one every 250 ms."""


class GatewayConnection:
    """Connected gateway, as the receiver's thread has it.

    Attributes:
        sender: process at the other end.
        hello: what it said of itself; None before that.
        begin_again: it is to be closed, so that its gateway connects again and begins a segment.
        ended_by_gateway: its gateway has closed it.
        handed_on: a tick of it was put into the backlog.
        hello_bytes: that the long texts of its HELLO take in memory.
        fault: why it is to be closed for good: its data cannot be written; None without.
        begun_s, latest_s: when it began, and when the latest datagram came, monotonic.
        frames: that it handed on so far, lost ones counted, since the gateway started.
        since_wall_ns, last_wall_ns: when it began, and when the latest datagram came.
    """

    def __init__(self, sock: socket.socket, sender: Sender) -> None:
        self._sock = sock
        self.sender = sender
        self._hello_text = HelloText()
        self.hello: Mapping[str, Any] | None = None
        self.begin_again = self.ended_by_gateway = self.handed_on = False
        self.hello_bytes = 0
        self.fault: DatagramError | None = None
        self.frames = 0
        self._checkpoints = Allowance(*_CHECKPOINTS)
        self.begun_s = self.latest_s = time.monotonic()
        self.since_wall_ns = self.last_wall_ns = time.time_ns()

    def fileno(self) -> int:
        return self._sock.fileno()

    @property
    def unfinished_bytes(self) -> int:
        return self._hello_text.size

    def receive(self, buffer: bytearray) -> TickParts | None:
        """The next tick; None for a part of the HELLO.

        BlockingIOError where none waits, EOFError where the connection has ended; DatagramError
        where it is no datagram of a gateway, or too long.
        """
        size = self._sock.recv_into(buffer, 0, socket.MSG_TRUNC)
        if size == 0:
            raise EOFError
        if size > len(buffer):
            raise DatagramError(f"a datagram of {size} bytes is too long")
        self.last_wall_ns, self.latest_s = time.time_ns(), time.monotonic()
        received = bytes(memoryview(buffer)[:size])
        if received[0] != datagram.HELLO:
            return self._tick(received)
        part = datagram.unpack(received)
        if not isinstance(part, HelloPart) or self.hello is not None:
            raise DatagramError("a HELLO after the HELLO")
        self._take(part)
        return None

    def _tick(self, received: bytes) -> TickParts:
        if self.hello is None:
            raise DatagramError("a tick before the HELLO")
        tick = datagram.tick_parts(received)
        if tick.frame_count > _MOST_FRAMES:
            raise DatagramError(f"{tick.frame_count} frames in one datagram are too many")
        if max(tick.header) >= _MOST_COUNT or tick.header.frames < tick.frame_count:
            raise DatagramError("its numbers of frames and datagrams cannot be")
        check_lines(tick.lines)
        if tick.begins_segment and not self._checkpoints.take():
            raise DatagramError("too many checkpoints", "rate")
        self.frames = tick.header.frames
        return tick

    def _take(self, part: HelloPart) -> None:
        if len(part.text) > datagram.PART_BYTES:
            raise DatagramError(f"a part of {len(part.text)} bytes is too long", "hello")
        hello = self._hello_text.take(part)
        if hello is not None:
            self.hello = checked_hello(hello)
            self.hello_bytes = sum(sys.getsizeof(hello[key]) for key in ("config", "dbc"))

    def forget_hello(self) -> None:
        """Keep of it what is shown: its drive has the rest, or there will be none."""
        if self.hello is not None:
            self.hello = {key: self.hello[key] for key in ("run", "channel")}
            self.hello_bytes = 0

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._sock.close()
