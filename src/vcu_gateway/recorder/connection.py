"""Connection of a gateway: what it said of itself, and its datagrams, checked before they are kept.

The limits are far above what a gateway sends: a checkpoint of it has 5 kB, both texts of its HELLO
40 kB. A line is checked for its shape only; whether it makes sense is the reader's question.
"""

import contextlib
import json
import math
import re
import socket
import sys
import time
from collections.abc import Mapping
from typing import Any

from vcu_gateway.rate_limit import TokenBucket
from vcu_gateway.recorder.senders import Sender
from vcu_gateway.recording import datagram
from vcu_gateway.recording.datagram import DatagramError, HelloPart, HelloText, TickParts
from vcu_gateway.recording.segment import is_number
from vcu_gateway.units import NS_PER_S

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


def checked_hello(hello: Mapping[str, Any]) -> Mapping[str, Any]:
    """The HELLO; DatagramError where the recorder cannot use it."""
    run, channel, clock = hello.get("run"), hello.get("channel"), hello.get("clock")
    if not isinstance(run, str) or not _RUN.fullmatch(run):
        raise _hello("has no run id of up to 64 plain characters")
    name = channel if isinstance(channel, str) and " " not in channel else ""
    if not 0 < len(name) <= _LONGEST_CHANNEL or not name.isprintable():
        raise _hello(f"has no channel of up to {_LONGEST_CHANNEL} printable characters")
    if not isinstance(clock, dict) or not _are_counts(clock, "monotonic_ns", "wall_ns"):
        raise _hello("has no clock of two 64-bit numbers")
    for key in _TEXTS:
        if not _is_text(hello.get(key), _MOST_TEXT_BYTES):
            raise _hello(f"has no {key} of up to {_MOST_TEXT_BYTES >> 10} KiB of Unicode")
    if _left_of({key: hello[key] for key in hello if key not in _TEXTS}, _MOST_REST) < 0:
        raise _hello("has a value that is too long, too deep or no finite number")
    return hello


def check_lines(lines: bytes) -> None:
    """DatagramError where these core lines are not those of a gateway."""
    if len(lines) > MOST_LINES_BYTES:
        raise _lines(f"are {len(lines)} bytes, and {MOST_LINES_BYTES} are the most")
    if b"\r" in lines or lines.count(b"\n") > _MOST_LINES:
        raise _lines(f"are more than {_MOST_LINES}, or not parted by line ends alone")
    try:
        for number, line in enumerate(lines.decode().split("\n")[:-1]):
            _check(_DECODER.decode(line), number)
    except DatagramError:
        raise
    except (ValueError, RecursionError) as error:
        raise _lines(f"are no JSON: {str(error)[:100]}") from error


def _check(values: Any, number: int) -> None:
    if not isinstance(values, dict) or "f" not in values:
        raise _lines("have one that is no object with f")
    if not _are_counts(values, *(key for key in ("f", "tick", "restarted") if key in values)):
        raise _lines("have a count or a clock that is no 64-bit number")
    if not _are_events(values.get("events", [])):
        raise _lines("have events that are no list of name, severity and fields")
    if any(key in values for key in ("begin", "gap", "end")):
        raise _lines("have one that only the recorder writes")
    if "checkpoint" in values:
        state = values["checkpoint"]
        counted = isinstance(state, dict) and _are_counts(state, "ticks", "frames")
        if number > 0 or not counted:
            raise _lines("have a checkpoint that is not the first, or without its counts")


def _are_events(events: Any) -> bool:
    return isinstance(events, list) and all(
        isinstance(one, list) and [type(part) for part in one] == [str, str, dict] for one in events
    )


def _are_counts(values: Mapping[str, Any], *keys: str) -> bool:
    return all(is_number(values.get(key)) for key in keys)


def _is_text(value: Any, most_bytes: int) -> bool:
    """True for Unicode of at most that many bytes in memory; a lone surrogate is none."""
    if not isinstance(value, str) or sys.getsizeof(value) > most_bytes:
        return False
    with contextlib.suppress(UnicodeEncodeError):
        value.encode()
        return True
    return False


def _left_of(value: Any, room: int, depth: int = 0) -> int:
    """How many values there is still room for; negative where one cannot be kept."""
    if isinstance(value, (dict, list)):
        fits = depth < _MOST_DEPTH
        inner = [*value.keys(), *value.values()] if isinstance(value, dict) else value
        for one in inner if fits else ():
            room = _left_of(one, room, depth + 1)
            if room < 0:
                return room
    elif isinstance(value, (int, float)):
        fits = math.isfinite(value) if isinstance(value, float) else abs(value) <= _LARGEST
    else:
        fits = value is None or _is_text(value, _MOST_WORD)
    return room - 1 if fits else -1


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits[:20]} is no finite number")
    return value


def _refuse(word: str) -> float:
    raise ValueError(f"{word} is no number of JSON")


# Made once: json.loads would make one for every line.
_DECODER = json.JSONDecoder(parse_constant=_refuse, parse_float=_finite)


def _hello(what: str) -> DatagramError:
    return DatagramError(f"its HELLO {what}", "hello")


def _lines(what: str) -> DatagramError:
    return DatagramError(f"its core lines {what}", "core_lines")


BUFFER_BYTES = 1 << 20
"""Room for the longest datagram."""
_MOST_FRAMES = 50_000
_CHECKPOINTS = NS_PER_S // 4, 20
"""At once, and a second: a gateway that loses datagrams sends one every 250 ms."""


class GatewayConnection:
    """Connected gateway, as the receiver's thread has it.

    Attributes:
        hello: what it said of itself; None before that.
        begin_again: it is to be closed, so that its gateway connects again and begins a segment.
        handed_on: a tick of it was put into the backlog.
        hello_bytes: that the long texts of its HELLO take in memory.
        fault: why it is to be closed for good: its data cannot be written; None without.
        frames: that it handed on so far, lost ones counted, since the gateway started.
        begun_s, latest_s: when it began, and when the latest datagram came, monotonic;
            since_wall_ns, last_wall_ns: the same on the wall clock.
    """

    def __init__(self, sock: socket.socket, sender: Sender) -> None:
        self._sock = sock
        self.sender = sender
        self.hello_text = HelloText()
        self.hello: Mapping[str, Any] | None = None
        self.begin_again = self.ended_by_gateway = self.handed_on = False
        self.hello_bytes = 0
        self.fault: DatagramError | None = None
        self.frames = 0
        self._checkpoints = TokenBucket(*_CHECKPOINTS, time.monotonic_ns())
        self.begun_s = self.latest_s = time.monotonic()
        self.since_wall_ns = self.last_wall_ns = time.time_ns()

    def fileno(self) -> int:
        return self._sock.fileno()

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
        if max(tick.header) > _LARGEST or tick.header.frames < tick.frame_count:
            raise DatagramError("its numbers of frames and datagrams cannot be")
        check_lines(tick.lines)
        if tick.begins_segment and not self._checkpoints.taken(time.monotonic_ns()):
            raise DatagramError("too many checkpoints", "rate")
        self.frames = tick.header.frames
        return tick

    def _take(self, part: HelloPart) -> None:
        if len(part.text) > datagram.PART_BYTES:
            raise DatagramError(f"a part of {len(part.text)} bytes is too long", "hello")
        hello = self.hello_text.take(part)
        if hello is not None:
            self.hello = checked_hello(hello)
            self.hello_bytes = sum(sys.getsizeof(hello[key]) for key in _TEXTS)

    def forget_hello(self) -> None:
        """Keep of it what is shown: its drive has the rest, or there will be none."""
        if self.hello is not None:
            self.hello = {key: self.hello[key] for key in ("run", "channel")}
            self.hello_bytes = 0

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._sock.close()
