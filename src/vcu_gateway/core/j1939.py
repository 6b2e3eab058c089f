"""CAN frame and its J1939 identifier."""

from dataclasses import dataclass
from typing import NamedTuple


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


ID_MASK = 0x1FFF_FFFF
"""29 bits; anything above is a flag of SocketCAN, not an identifier (docs/protocol.md E2)."""

MATCH_MASK = 0x03FF_FFFF
"""All but the priority: receivers tell messages apart by PGN and source (docs/protocol.md E1)."""

GROUP_MASK = MATCH_MASK & ~0xFF
"""All but priority and source: messages of one meaning to one node, from any sender."""

PDU2_FIRST_PF = 240
"""From this PDU format on, PS belongs to the group number instead of being a destination."""

GLOBAL_ADDRESS = 0xFF
"""The destination that stands for every node."""


class Identifier(NamedTuple):
    """The fields of a 29-bit identifier.

    priority 0..7 (0 wins), extended_data_page 0..1, data_page 0..1, pdu_format,
    pdu_specific and source_address 0..255.
    """

    priority: int
    extended_data_page: int
    data_page: int
    pdu_format: int
    pdu_specific: int
    source_address: int

    @property
    def destination_address(self) -> int | None:
        """The addressed node, or None for a broadcast (PDU2)."""
        return self.pdu_specific if self.pdu_format < PDU2_FIRST_PF else None

    @property
    def pgn(self) -> int:
        """Parameter group number, 18 bits; without the destination for PDU1."""
        page = self.extended_data_page << 17 | self.data_page << 16
        specific = 0 if self.pdu_format < PDU2_FIRST_PF else self.pdu_specific
        return page | self.pdu_format << 8 | specific


def parse(can_id: int) -> Identifier:
    """Split a 29-bit identifier; ValueError beyond 29 bits."""
    if not 0 <= can_id <= ID_MASK:
        raise ValueError(f"identifier {can_id:#x} does not fit 29 bits")
    return Identifier(
        priority=can_id >> 26 & 0x7,
        extended_data_page=can_id >> 25 & 1,
        data_page=can_id >> 24 & 1,
        pdu_format=can_id >> 16 & 0xFF,
        pdu_specific=can_id >> 8 & 0xFF,
        source_address=can_id & 0xFF,
    )


def match_key(can_id: int) -> int:
    """Key of a message, the same for every priority."""
    return can_id & MATCH_MASK


def group_key(can_id: int) -> int:
    """Key of a message, the same for every priority and sender."""
    return can_id & GROUP_MASK


def group_key_to(can_id: int, destination: int) -> int:
    """`group_key` of the same group to another node; for PDU1 identifiers."""
    return group_key(can_id) & ~0xFF00 | destination << 8


def with_priority(can_id: int, priority: int) -> int:
    """The same message at another priority, 0..7."""
    return match_key(can_id) | (priority & 0x7) << 26
