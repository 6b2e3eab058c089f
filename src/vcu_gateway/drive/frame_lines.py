"""Frame lines of a recorded drive, candump's, read quickly: the recorder wrote them."""

import re

from vcu_gateway.core.frame import Frame
from vcu_gateway.drive_format.datagram import ERROR, ID_MASK

_EXTENDED_DIGITS = 8
# An extended data frame of classic CAN, which almost every line is.
_ORDINARY = re.compile(
    r"\((\d{1,12})\.(\d{9})\) \S+ ([01][0-9A-F]{7})#((?:[0-9A-F]{2}){0,8}) ([RT])\n", re.ASCII
)


class _Identifiers(dict[str, int]):
    """Identifiers by their digits; a drive has some dozens."""

    _MOST = 10_000

    def __missing__(self, digits: str) -> int:
        if len(self) >= self._MOST:
            self.clear()
        can_id = self[digits] = int(digits, 16)
        return can_id


_IDENTIFIERS = _Identifiers()


def frames_of(lines: str, distance_ns: int = 0) -> list[Frame] | None:
    """Frames of whole lines at once; None where not every one is an extended data frame."""
    found = _ORDINARY.findall(lines)
    if len(found) != lines.count("\n"):
        return None
    from_hex, identifiers = bytes.fromhex, _IDENTIFIERS
    return [
        Frame(
            identifiers[digits],
            from_hex(payload),
            int(seconds + fraction) - distance_ns,
            True,
            False,
            False,
            direction == "T",
        )
        for seconds, fraction, digits, payload, direction in found
    ]


def frame_of(line: str, distance_ns: int = 0) -> Frame:
    """Frame of one line; `distance_ns` is the wall clock's from the monotonic one.

    Raises ValueError where it is no line of a recorded drive.
    """
    stamp, _, body, direction = line.split()
    seconds, _, fraction = stamp[1:-1].partition(".")
    digits, _, payload = body.partition("#")
    if len(fraction) != 9 or direction not in ("R", "T"):
        raise ValueError("the stamp or the direction is damaged")
    arrival_ns, can_id = int(seconds + fraction) - distance_ns, int(digits, 16)
    extended = len(digits) == _EXTENDED_DIGITS
    try:
        data = bytes.fromhex(payload)
    except ValueError:
        data = _unusual(payload)
    return Frame(
        can_id & ID_MASK,
        data,
        arrival_ns,
        extended=extended,
        remote=payload[:1] == "R",
        error=extended and can_id & ERROR != 0,
        own_echo=direction == "T",
    )


def _unusual(payload: str) -> bytes:
    """Data of a remote frame, or of one with more than eight bytes: `#`, flags, data."""
    return b"" if payload[:1] == "R" else bytes.fromhex(payload.removeprefix("#0"))
