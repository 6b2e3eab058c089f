"""What the bus itself says: error frames, loss, and whether our frames leave."""

from dataclasses import dataclass
from enum import Enum

# Classes and bits of include/uapi/linux/can/error.h.
_CLASS_CONTROLLER = 0x004
_CLASS_BUS_OFF = 0x040
_CLASS_RESTARTED = 0x100
_CONTROLLER_BYTE = 1
_WARNING_BITS = 0x04 | 0x08
_PASSIVE_BITS = 0x10 | 0x20
_ACTIVE_BIT = 0x40


class LinkState(Enum):
    """The controller's state as far as error frames told; LOST: interface down or gone."""

    UP = "up"
    WARNING = "error warning"
    PASSIVE = "error passive"
    BUS_OFF = "bus off"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Link:
    """State of the link and since when it is in it."""

    state: LinkState
    since_ns: int

    def moved(self, state: LinkState, at_ns: int) -> "Link":
        """The same link in this state; `since_ns` stays where the state does."""
        return self if state is self.state else Link(state, at_ns)


def after_error_frame(link: Link, can_id: int, data: bytes | bytearray, at_ns: int) -> Link:
    """The link after an error frame; `can_id` carries the error classes.

    Bus-off ends with a restart or with the controller's word that it is active again.
    """
    if can_id & _CLASS_BUS_OFF:
        return link.moved(LinkState.BUS_OFF, at_ns)
    if can_id & _CLASS_RESTARTED:
        return link.moved(LinkState.UP, at_ns)
    if can_id & _CLASS_CONTROLLER and len(data) > _CONTROLLER_BYTE:
        return _after_controller_byte(link, data[_CONTROLLER_BYTE], at_ns)
    return link


def _after_controller_byte(link: Link, bits: int, at_ns: int) -> Link:
    state = link.state
    if bits & _PASSIVE_BITS:
        state = LinkState.PASSIVE
    elif bits & _WARNING_BITS:
        state = LinkState.WARNING
    elif bits & _ACTIVE_BIT:
        return link.moved(LinkState.UP, at_ns)
    return link if link.state is LinkState.BUS_OFF else link.moved(state, at_ns)
