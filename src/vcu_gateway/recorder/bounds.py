"""Bounds of what a gateway hands over: its HELLO and its core lines, before any of it is kept.

The limits are far above what a gateway sends: a checkpoint of it has 5 kB, both texts of its HELLO
40 kB. A line is checked for its shape only; whether it makes sense is the reader's question.
"""

import json
import math
import re
import sys
from collections.abc import Mapping
from typing import Any

from vcu_gateway.recording.datagram import DatagramError

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
