"""candump's log lines with nanoseconds and direction, as `candump -l -x` writes them.

    (1763920000.123456789) can0 040AD079#0011223344556677 R

R: received, T: the echo of an own frame. A remote frame is `#R8`, an FD frame `##0...`, an error
frame has bit 29 of the identifier set, as in `20000040#`.
"""

from vcu_gateway.drive_format.datagram import ERROR, EXTENDED, ID_MASK, REMOTE
from vcu_gateway.units import NS_PER_S

_STANDARD_MASK = 0x7FF
_CLASSIC_BYTES = 8
_KEPT_IDENTIFIERS = 4096


class CandumpLines:
    """Lines of one channel; the texts of its identifiers are kept."""

    def __init__(self, channel: str) -> None:
        self._channel = channel
        self._kept: dict[int, str] = {}

    def line(self, wall_ns: int, can_id: int, data: bytes, own_echo: bool, length: int = 0) -> str:
        """One frame with its line end.

        `can_id` has Linux's flags; `length` is that of a remote frame, which has no data.
        """
        seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
        head = self._kept.get(can_id) or self._head(can_id)
        direction = "T" if own_echo else "R"
        if can_id & REMOTE or len(data) > _CLASSIC_BYTES:
            payload = f"R{length or ''}" if can_id & REMOTE else f"#0{data.hex().upper()}"
            return f"({seconds}.{nanoseconds:09d}){head}{payload} {direction}\n"
        return f"({seconds}.{nanoseconds:09d}){head}{data.hex().upper()} {direction}\n"

    def _head(self, can_id: int) -> str:
        """Channel and identifier; at most 4096 are kept, whatever a flood sends."""
        if can_id & ERROR:
            digits = f"{can_id & ID_MASK | ERROR:08X}"
        elif can_id & EXTENDED:
            digits = f"{can_id & ID_MASK:08X}"
        else:
            digits = f"{can_id & _STANDARD_MASK:03X}"
        head = f" {self._channel} {digits}#"
        if len(self._kept) < _KEPT_IDENTIFIERS:
            self._kept[can_id] = head
        return head
