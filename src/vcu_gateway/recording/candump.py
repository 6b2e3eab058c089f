"""candump's log format: `(1700000000.123456) can0 040AD079#0011223344556677`."""

import re
from collections.abc import Iterator

from vcu_gateway.core import j1939
from vcu_gateway.core.frame import Frame
from vcu_gateway.recording.lines import LineReader
from vcu_gateway.recording.problems import LineProblems, Verdict
from vcu_gateway.recording.recorded import RecordedFrame
from vcu_gateway.units import NS_PER_S

# Seconds, fraction, channel, identifier, payload, and the direction of `candump -x`.
_LINE = re.compile(
    r"\s*\((\d{1,10})(?:\.(\d{1,9}))?\)\s+(\S+)\s+([0-9A-F]{3}|[0-9A-F]{8})#(\S*)(?:\s+[RT])?\s*",
    re.ASCII | re.IGNORECASE,
)
_REMOTE = re.compile(r"R(?:[0-8](?:_[9A-F])?)?", re.IGNORECASE)
_FD = re.compile(r"#[0-9A-F]((?:[0-9A-F]{2}){0,64})", re.IGNORECASE)
_DATA = re.compile(r"((?:[0-9A-F]{2}\.?){0,64})(?:_[9A-F])?", re.IGNORECASE)

_NS_BY_DIGITS = tuple(10 ** (9 - digits) for digits in range(10))
_STANDARD_MASK = 0x7FF
_STANDARD_DIGITS = 3
_REMEDY = "record with `candump -L` or `candump -l`"


def frames(lines: LineReader, problems: LineProblems) -> Iterator[RecordedFrame]:
    """Every frame of the text; damaged lines and flags in identifiers go to `problems`."""
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
    seconds, fraction, channel, digits, payload = found.groups("0")
    can_id = int(digits, 16)
    extended = len(digits) > _STANDARD_DIGITS
    error = can_id > (j1939.ID_MASK if extended else _STANDARD_MASK)
    if error and _refused(can_id, extended, number, problems):
        return None
    try:
        data, remote, fd = bytes.fromhex(payload), False, False
    except ValueError:
        unusual = _unusual(payload)
        if unusual is None:
            problems.damaged(number, f"the payload {payload[:40]!r} is damaged")
            return None
        data, remote, fd = unusual
    arrival_ns = int(seconds) * NS_PER_S + int(fraction) * _NS_BY_DIGITS[len(fraction)]
    frame = Frame(can_id & j1939.ID_MASK, data, arrival_ns, extended, remote, error)
    return RecordedFrame(frame, channel, number, fd)


def _refused(can_id: int, extended: bool, number: int, problems: LineProblems) -> bool:
    """Report an identifier that is too large; True where the line is no frame at all."""
    if extended:
        return problems.flagged(number, can_id) is Verdict.UNREADABLE
    problems.damaged(number, f"identifier {can_id:X} of three digits does not fit 11 bits")
    return True


def _unusual(payload: str) -> tuple[bytes, bool, bool] | None:
    """Data, remote and FD of a payload that is not just hexadecimal; None if damaged.

    `R` with a length is a remote frame, a second `#` an FD frame with its flags, `_E` at the
    end a data length code above 8, and dots may part the bytes.
    """
    if _REMOTE.fullmatch(payload):
        return b"", True, False
    if found := _FD.fullmatch(payload):
        return bytes.fromhex(found[1]), False, True
    if found := _DATA.fullmatch(payload):
        return bytes.fromhex(found[1].replace(".", "")), False, False
    return None
