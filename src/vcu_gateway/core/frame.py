"""Frame: one received CAN frame, as the core takes it."""

from dataclasses import dataclass


@dataclass(slots=True)
class Frame:
    """One received frame; not changed after it was made.

    Attributes:
        can_id: identifier without flags, 11 or 29 bits.
        data: payload, 0..64 bytes.
        arrival_ns: the kernel's arrival stamp on the monotonic clock.
        extended, remote, error: kind of frame.
        own_echo: our own frame, come back because it has left (MSG_CONFIRM).
    """

    can_id: int
    data: bytes | bytearray
    arrival_ns: int
    extended: bool = True
    remote: bool = False
    error: bool = False
    own_echo: bool = False
