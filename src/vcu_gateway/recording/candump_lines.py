"""candump's log lines with nanoseconds and direction, as `candump -l -x` writes them.

    (1763920000.123456789) can0 040AD079#0011223344556677 R

R: received, T: the echo of an own frame. A remote frame is `#R`, an FD frame `##0...`, an error
frame has bit 29 of the identifier set, as in `20000040#`.
"""

import contextlib
import struct
from functools import lru_cache

from vcu_gateway.recording import datagram
from vcu_gateway.recording.datagram import CLASSIC, ERROR, EXTENDED, ID_MASK, REMOTE, TickParts
from vcu_gateway.units import NS_PER_S

_CLASSIC_BYTES = 8
_KEPT = 4096
"""Texts by identifier, whatever a flood sends."""
_STAMP_AND_KIND = struct.Struct("<q6s8x")
_KIND = struct.Struct("<IBB")
_PAYLOAD_AT = 2 * (CLASSIC.size - _CLASSIC_BYTES)
_PAYLOAD_END = 2 * CLASSIC.size


def frame_line(channel: str, wall_ns: int, can_id: int, data: bytes, own_echo: bool) -> str:
    """One frame with its line end; `can_id` has Linux's flags, a remote frame no data."""
    seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
    payload, direction = data.hex().upper(), "T" if own_echo else "R"
    if can_id & REMOTE:
        payload = "R"
    elif len(data) > _CLASSIC_BYTES:
        payload = f"#0{payload}"
    return f"({seconds}.{nanoseconds:09d}){_head(channel, can_id)}{payload} {direction}\n"


def tick_lines(channel: str, tick: TickParts, clock_ns: int) -> str:
    """All frames of a tick; `clock_ns` is the wall clock less the gateway's monotonic one."""
    if len(tick.frames) == tick.frame_count * CLASSIC.size and clock_ns >= NS_PER_S:
        with contextlib.suppress(ValueError):
            return _classic(channel, tick.frames, clock_ns)
    return "".join(
        frame_line(channel, arrival_ns + clock_ns, can_id, data, own_echo)
        for arrival_ns, can_id, own_echo, data in datagram.frame_records(tick.frames)
    )


def _classic(channel: str, packed: bytes, clock_ns: int) -> str:
    """Frames with eight bytes each; ValueError where one is of another kind.

    As quick as Python can: an identifier's text is made once, all payloads' together.
    """
    place, lines = _PAYLOAD_AT, []
    digits = packed.hex().upper()
    for arrival_ns, kind in _STAMP_AND_KIND.iter_unpack(packed):
        head, tail = _around(channel, kind)
        stamp = str(arrival_ns + clock_ns)
        payload = digits[place : place + 2 * _CLASSIC_BYTES]
        lines.append(f"({stamp[:-9]}.{stamp[-9:]}){head}{payload}{tail}")
        place += _PAYLOAD_END
    return "".join(lines)


@lru_cache(_KEPT)
def _around(channel: str, kind: bytes) -> tuple[str, str]:
    """What stands around the payload; ValueError where that is not just eight bytes."""
    can_id, own_echo, length = _KIND.unpack(kind)
    if length != _CLASSIC_BYTES or can_id & REMOTE:
        raise ValueError
    return _head(channel, can_id), " T\n" if own_echo else " R\n"


@lru_cache(_KEPT)
def _head(channel: str, can_id: int) -> str:
    if can_id & ERROR:
        return f" {channel} {can_id & ID_MASK | ERROR:08X}#"
    digits = f"{can_id & ID_MASK:08X}" if can_id & EXTENDED else f"{can_id & 0x7FF:03X}"
    return f" {channel} {digits}#"
