"""Frame lines of a recorded drive, candump's, read quickly: the recorder wrote them."""

from vcu_gateway.core.frame import Frame
from vcu_gateway.drive_format.datagram import ERROR, ID_MASK

_EXTENDED_DIGITS = 8


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
