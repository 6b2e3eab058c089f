"""candump's log format, read: `(1700000000.123456) can0 040AD079#0011223344556677 R`.

`frames` reads the text of any program and goes on behind a damaged line; `recorded_frames` and
`recorded_frame` read what our recorder wrote (segment), where a damaged line is an
error. `quick_lines` matches many lines at once.

Here too is what every reader of a log gives and uses: recorded frames, problems that are reported
a bounded number of times, and lines that are counted and bounded in length.
"""

import gzip
import re
from binascii import unhexlify
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import NamedTuple, TextIO

from vcu_gateway.core import j1939
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.errors import DataError, GatewayError, MissingInputError, Problem


class RecordedFrame(NamedTuple):
    """One frame of a recording.

    Attributes:
        frame: its arrival_ns is the recording's own stamp, on whatever clock that was.
        channel: the interface's name or number; None where the format has none.
        position: line of a text format, else number of the frame, from 1.
    """

    frame: Frame
    channel: str | None
    position: int
    fd: bool = False


REPORTED_LIMIT = 10

_FLAGS = {30: "remote frames", 31: "29-bit identifiers"}
# The classes that the kernel puts into an error frame's identifier; other bits in a "class"
# are those of an identifier that was printed with 30 bits.
_ERROR_CLASSES = 0x3FF


class LineProblems:
    """Counter of lines or frames that cannot be read; the first of each kind are reported."""

    def __init__(self, where: Callable[[int], str], report: Callable[[Problem], None]) -> None:
        self._where = where
        self._report = report
        self._explained: set[int] = set()
        self.unreadable = 0

    def damaged(self, position: int, what: str, remedy: str = "") -> None:
        self.unreadable += 1
        if self.unreadable <= REPORTED_LIMIT:
            self._report(Problem(what, self._where(position), remedy))
        if self.unreadable == REPORTED_LIMIT:
            self._report(Problem("further damage is only counted", self._where(position)))

    def is_error_frame(self, position: int, can_id: int) -> bool:
        """What a number stands for that does not fit 29 bits, explained once: else unreadable."""
        bits = [
            f"bit {bit} set, SocketCAN's flag of {what}"
            for bit, what in _FLAGS.items()
            if can_id >> bit & 1
        ]
        is_error = can_id >> 29 == 1
        self.unreadable += not is_error
        if not 0 <= can_id < 1 << 32:
            what = "is no identifier of 29 bits"
        elif bits:
            what = f"has {' and '.join(bits)}"
        elif can_id & j1939.ID_MASK & ~_ERROR_CLASSES:
            what = "has bit 29 set, SocketCAN's error-frame flag; the source prints such 30-bit"
            what += " identifiers for the IMU (docs/protocol.md E2)"
        else:  # the kernel's own error frames need no explanation
            return is_error
        if can_id not in self._explained and len(self._explained) < REPORTED_LIMIT:
            self._explained.add(can_id)
            remedy = f"on the wire it is {can_id & j1939.ID_MASK:08X}"
            self._report(Problem(f"identifier {can_id:08X} {what}", self._where(position), remedy))
        return is_error

    def failure(self, position: int, error: Exception) -> GatewayError:
        """Error that ended the reading: an unreadable file, or wrong contents."""
        where = self._where(position)
        if isinstance(error, OSError) and not isinstance(error, gzip.BadGzipFile):
            return MissingInputError(Problem(f"cannot be read: {error.strerror or error}", where))
        what = f"is damaged here, {type(error).__name__}: {error}"
        return DataError(Problem(what, where, "nothing after this place was read"))


class LineReader:
    """Iterator over the lines of a text file; `number` is the latest one's, from 1.

    Of a line beyond 8192 characters only the beginning is given, so that a file without
    line ends cannot fill the memory.
    """

    def __init__(self, file: TextIO) -> None:
        self.number = 0
        self._file = file
        self._pieces = self._walk()

    def __iter__(self) -> Iterator[str]:
        return self._pieces

    def __next__(self) -> str:
        return next(self._pieces)

    def close(self) -> None:
        self._file.close()

    def _walk(self) -> Iterator[str]:
        at_start = True
        for piece in iter(partial(self._file.readline, 8192), ""):
            if at_start:
                self.number += 1
                yield piece
            at_start = piece.endswith("\n")


# Seconds, fraction, channel, identifier, payload, and the direction of `candump -x`.
_LINE = re.compile(
    r"\s*\((\d{1,10})(?:\.(\d{1,9}))?\)\s+(\S+)\s+([0-9A-F]{3}|[0-9A-F]{8})#(\S*)(?:\s+([RT]))?\s*",
    re.ASCII | re.IGNORECASE,
)
_REMOTE = re.compile(r"R(?:[0-8](?:_[9A-F])?)?", re.IGNORECASE)
_FD = re.compile(r"#[0-9A-F]((?:[0-9A-F]{2}){0,64})", re.IGNORECASE)
_DATA = re.compile(r"((?:[0-9A-F]{2}\.?){0,64})(?:_[9A-F])?", re.IGNORECASE)

_QUICK_LINE = rb"^\((\d{1,10})\.(\d{%d})\) (\S+) ([01][0-9A-F]{7})#([0-9A-F]{16})(?: ([RT]))?\n"
_QUICK = [(re.compile(_QUICK_LINE % one, re.MULTILINE), 10 ** (9 - one)) for one in (9, 6)]
_STANDARD_MASK = 0x7FF
_STANDARD_DIGITS = 3


def frames(lines: LineReader, problems: LineProblems) -> Iterator[RecordedFrame]:
    """Every frame of the text; damaged lines and flags in identifiers go to `problems`.

    None is an own echo: the log is of another program, whatever its direction.
    """
    match = _LINE.fullmatch
    for line in lines:
        if (found := match(line)) is None:
            if not line.isspace():
                what = "is no line of a candump log, `(time) channel identifier#data`"
                remedy = "record with `candump -L` or `candump -l`"
                problems.damaged(lines.number, what, remedy)
        elif recorded := _recorded(found, lines.number, problems):
            yield recorded


def _recorded(found: re.Match[str], number: int, problems: LineProblems) -> RecordedFrame | None:
    can_id = int(found[4], 16)
    if len(found[4]) == _STANDARD_DIGITS and can_id > _STANDARD_MASK:
        problems.damaged(number, f"identifier {can_id:X} of three digits does not fit 11 bits")
        return None
    if can_id > j1939.ID_MASK and not problems.is_error_frame(number, can_id):
        return None
    try:
        frame, fd = _frame(found)
    except ValueError as error:
        problems.damaged(number, str(error))
        return None
    return RecordedFrame(frame, found[3], number, fd)


def _frame(found: re.Match[str], ahead_ns: int = 0, own_echo: bool = False) -> tuple[Frame, bool]:
    """Frame of a line, and whether it is FD; ValueError where its payload is damaged."""
    seconds, fraction, _, digits, payload, _ = found.groups("0")
    can_id = int(digits, 16)
    try:
        data, remote, fd = bytes.fromhex(payload), False, False
    except ValueError:
        data, remote, fd = _unusual(payload)
    arrival_ns = int(seconds + fraction.ljust(9, "0")) - ahead_ns
    extended, error = len(digits) > _STANDARD_DIGITS, can_id > j1939.ID_MASK
    return Frame(can_id & j1939.ID_MASK, data, arrival_ns, extended, remote, error, own_echo), fd


def _unusual(payload: str) -> tuple[bytes, bool, bool]:
    """Data, remote and FD of a payload that is not just hexadecimal; ValueError if damaged.

    `R` with a length is a remote frame, a second `#` an FD frame with its flags, `_E` at the
    end a data length code above 8, and dots may part the bytes.
    """
    if _REMOTE.fullmatch(payload):
        return b"", True, False
    if found := _FD.fullmatch(payload):
        return bytes.fromhex(found[1]), False, True
    if found := _DATA.fullmatch(payload):
        return bytes.fromhex(found[1].replace(".", "")), False, False
    raise ValueError(f"the payload {payload[:40]!r} is damaged")


def recorded_frame(line: str, ahead_ns: int = 0) -> Frame:
    """Frame of the recorder's line; `ahead_ns` is the wall clock's from the monotonic one.

    ValueError where it is no such line: it has nine digits of a second, and a direction.
    """
    found = _LINE.fullmatch(line)
    if found is None or len(found[2] or "") != 9 or not found[6]:
        raise ValueError("is no frame line of a recorder")
    return _frame(found, ahead_ns, found[6] == "T")[0]


@lru_cache(maxsize=4096)  # a drive has some dozens
def _identifier(digits: bytes) -> int:
    return int(digits, 16)


def recorded_frames(lines: bytes, ahead_ns: int = 0) -> list[Frame] | None:
    """Frames of the recorder's whole lines; None where not all are for `quick_lines`."""
    found, factor = quick_lines(lines) or ([], 0)
    if not found or factor != 1:
        return None
    return [
        Frame(
            _identifier(digits),
            unhexlify(payload),
            int(seconds + fraction) - ahead_ns,
            True,
            False,
            False,
            direction == b"T",
        )
        for seconds, fraction, _, digits, payload, direction in found
    ]


def quick_lines(lines: bytes) -> tuple[list[tuple[bytes, ...]], int] | None:
    """Parts of whole lines: seconds, fraction, channel, identifier, data, direction; ns of a digit.

    None where not every one is an extended frame of eight bytes, as nearly all are.
    """
    count = lines.count(b"\n")
    for pattern, factor in _QUICK:
        found = pattern.findall(lines)
        if len(found) == count:
            return found, factor
    return None
