"""candump's log format, read: `(1700000000.123456) can0 040AD079#0011223344556677 R`.

`frames` reads the text of any program and goes on behind a damaged line; `recorded_frames` and
`recorded_frame` read what our recorder wrote (drive_format.candump), where a damaged line is an
error. `quick_lines` matches many lines at once.
"""

import re
from binascii import unhexlify
from collections.abc import Iterator

from vcu_gateway.core import j1939
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.recording.lines import LineReader
from vcu_gateway.recording.problems import LineProblems, Verdict
from vcu_gateway.recording.recorded import RecordedFrame
from vcu_gateway.units import NS_PER_S

# Seconds, fraction, channel, identifier, payload, and the direction of `candump -x`.
_LINE = re.compile(
    r"\s*\((\d{1,10})(?:\.(\d{1,9}))?\)\s+(\S+)\s+([0-9A-F]{3}|[0-9A-F]{8})#(\S*)(?:\s+([RT]))?\s*",
    re.ASCII | re.IGNORECASE,
)
_REMOTE = re.compile(r"R(?:[0-8](?:_[9A-F])?)?", re.IGNORECASE)
_FD = re.compile(r"#[0-9A-F]((?:[0-9A-F]{2}){0,64})", re.IGNORECASE)
_DATA = re.compile(r"((?:[0-9A-F]{2}\.?){0,64})(?:_[9A-F])?", re.IGNORECASE)

_QUICK = [
    (
        re.compile(
            rb"^\((\d{1,10})\.(\d{%d})\) (\S+) ([01][0-9A-F]{7})#([0-9A-F]{16})(?: ([RT]))?\n"
            % digits,
            re.MULTILINE,
        ),
        10 ** (9 - digits),
    )
    for digits in (9, 6)
]
_NS_BY_DIGITS = tuple(10 ** (9 - digits) for digits in range(10))
_STANDARD_MASK = 0x7FF
_STANDARD_DIGITS = 3
_STAMP_DIGITS = 9
_REMEDY = "record with `candump -L` or `candump -l`"


def frames(lines: LineReader, problems: LineProblems) -> Iterator[RecordedFrame]:
    """Every frame of the text; damaged lines and flags in identifiers go to `problems`.

    None is an own echo: the log is of another program, whatever its direction.
    """
    match = _LINE.fullmatch
    for line in lines:
        found = match(line)
        if found is None:
            if not line.isspace():
                what = "is no line of a candump log, `(time) channel identifier#data`"
                problems.damaged(lines.number, what, _REMEDY)
        elif recorded := _recorded(found, lines.number, problems):
            yield recorded


def _recorded(found: re.Match[str], number: int, problems: LineProblems) -> RecordedFrame | None:
    if _is_refused(found[4], number, problems):
        return None
    try:
        frame, fd = _frame(found)
    except ValueError as error:
        problems.damaged(number, str(error))
        return None
    return RecordedFrame(frame, found[3], number, fd)


def _is_refused(digits: str, number: int, problems: LineProblems) -> bool:
    """True where an identifier is none of a frame; one that is too large is reported."""
    can_id = int(digits, 16)
    if len(digits) > _STANDARD_DIGITS:
        flagged = can_id > j1939.ID_MASK
        return flagged and problems.flagged(number, can_id) is Verdict.UNREADABLE
    if can_id > _STANDARD_MASK:
        problems.damaged(number, f"identifier {can_id:X} of three digits does not fit 11 bits")
    return can_id > _STANDARD_MASK


def _frame(found: re.Match[str], ahead_ns: int = 0, own_echo: bool = False) -> tuple[Frame, bool]:
    """Frame of a line, and whether it is FD; ValueError where its payload is damaged."""
    seconds, fraction, _, digits, payload, _ = found.groups("0")
    can_id = int(digits, 16)
    try:
        data, remote, fd = bytes.fromhex(payload), False, False
    except ValueError:
        data, remote, fd = _unusual(payload)
    arrival_ns = int(seconds) * NS_PER_S + int(fraction) * _NS_BY_DIGITS[len(fraction)] - ahead_ns
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
    if found is None or len(found[2] or "") != _STAMP_DIGITS or not found[6]:
        raise ValueError("is no frame line of a recorder")
    return _frame(found, ahead_ns, found[6] == "T")[0]


class _Identifiers(dict[bytes, int]):
    """Identifiers by their digits; a drive has some dozens."""

    _MOST = 10_000

    def __missing__(self, digits: bytes) -> int:
        if len(self) >= self._MOST:
            self.clear()
        can_id = self[digits] = int(digits, 16)
        return can_id


_IDENTIFIERS = _Identifiers()


def recorded_frames(lines: bytes, ahead_ns: int = 0) -> list[Frame] | None:
    """Frames of the recorder's whole lines; None where not all are for `quick_lines`."""
    found, factor = quick_lines(lines) or ([], 0)
    if not found or factor != 1:
        return None
    identifiers = _IDENTIFIERS
    return [
        Frame(
            identifiers[digits],
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
