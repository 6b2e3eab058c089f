"""What the bus itself says: error frames, the carrier, loss."""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

# Classes and bits of include/uapi/linux/can/error.h.
_CLASS_CONTROLLER = 0x004
_CLASS_BUS_OFF = 0x040
_CLASS_RESTARTED = 0x100
ERROR_CLASSES = _CLASS_CONTROLLER | _CLASS_BUS_OFF | _CLASS_RESTARTED
"""The only ones that move the link; the others may come by the thousand."""

_CONTROLLER_BYTE = 1
_PASSIVE_WINDOW_NS = 5_000_000_000
_WARNING_BITS = 0x04 | 0x08
_PASSIVE_BITS = 0x10 | 0x20
_ACTIVE_BIT = 0x40


class LinkState(Enum):
    """The controller's state as far as it is known; LOST: interface down or gone."""

    UP = "up"
    WARNING = "error warning"
    PASSIVE = "error passive"
    BUS_OFF = "bus off"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """State of the link and since when it is in it."""

    state: LinkState
    since_ns: int

    def moved(self, state: LinkState, at_ns: int) -> "LinkStatus":
        """The same link in this state; `since_ns` stays where the state does."""
        return self if state is self.state else LinkStatus(state, at_ns)


def after_error_frame(
    link: LinkStatus, can_id: int, data: bytes | bytearray, at_ns: int
) -> LinkStatus:
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


def _after_controller_byte(link: LinkStatus, bits: int, at_ns: int) -> LinkStatus:
    state = link.state
    if bits & _PASSIVE_BITS:
        state = LinkState.PASSIVE
    elif bits & _WARNING_BITS:
        state = LinkState.WARNING
    elif bits & _ACTIVE_BIT:
        return link.moved(LinkState.UP, at_ns)
    return link if link.state is LinkState.BUS_OFF else link.moved(state, at_ns)


class Carrier(NamedTuple):
    """What the kernel says of the interface itself: a controller in bus-off has no carrier."""

    present: bool
    since_ns: int


def with_carrier(link: LinkStatus, carrier: Carrier | None) -> LinkStatus:
    """The link that error frames told, held against the carrier; None is not known.

    Without a carrier the bus is off, whether an error frame was seen or not. A carrier that
    came back after a bus-off ends it: the error frame that tells of the restart may be lost.
    """
    if carrier is None:
        return link
    off = link.state is LinkState.BUS_OFF
    if not carrier.present:
        return link if off else LinkStatus(LinkState.BUS_OFF, carrier.since_ns)
    if off and carrier.since_ns > link.since_ns:
        return LinkStatus(LinkState.UP, carrier.since_ns)
    return link


class _Told(NamedTuple):
    """What error frames told, and for how long they had told of error-passive before."""

    link: LinkStatus
    passive_ns: int


class PassiveTime:
    """Error-passive time within the last 5 s, of what had gathered by each tick."""

    def __init__(self) -> None:
        self._gathered: deque[tuple[int, int]] = deque()

    def within(self, gathered_ns: int, now_ns: int) -> int:
        """How much of it fell into the window, or up to a tick more; it begins with a tick."""
        gathered = self._gathered
        gathered.append((now_ns, gathered_ns))
        while len(gathered) > 1 and gathered[1][0] <= now_ns - _PASSIVE_WINDOW_NS:
            gathered.popleft()
        return gathered_ns - gathered[0][1]


class LinkMonitor:
    """What is known of the link since it was opened.

    Error frames are entered by the receiving thread, everything else by the ticking thread; each
    writes pages of its own.
    """

    def __init__(self, now_ns: int) -> None:
        self._opened = LinkStatus(LinkState.UP, now_ns)
        self._told = _Told(self._opened, 0)
        self._last_off: LinkStatus | None = None
        self._carrier: Carrier | None = None
        self._last_off_seen: LinkStatus | None = None
        self._missed: LinkStatus | None = None

    def take_error_frame(self, can_id: int, data: bytes | bytearray, at_ns: int) -> None:
        """On the receiving thread."""
        before = self._latest()
        told = after_error_frame(before, can_id, data, at_ns)
        if told.state is LinkState.BUS_OFF:
            self._last_off = told
        passive_ns = self._told.passive_ns
        if before.state is LinkState.PASSIVE:
            passive_ns += max(0, told.since_ns - before.since_ns)
        self._told = _Told(told, passive_ns)

    def begin(self, opened: LinkStatus, carrier: Carrier | None = None) -> None:
        """The interface was opened then, in this state; what was said before is over."""
        self._opened, self._carrier = opened, carrier

    def note_carrier(self, carrier: Carrier) -> None:
        """The carrier came or went."""
        self._carrier = carrier

    def begin_tick(self) -> None:
        """A bus-off that came and went since the last tick is to count in the one that begins."""
        last = self._last_off
        self._missed = None if last is self._last_off_seen else last
        self._last_off_seen = last

    @property
    def link(self) -> LinkStatus:
        """The worst that is known; any thread may ask."""
        link = with_carrier(self._latest(), self._carrier)
        return link if link.state is LinkState.BUS_OFF else self._missed or link

    def passive_ns(self, now_ns: int) -> int:
        """For how long the controller has been error-passive in all; an opening may take some."""
        told = self._told
        link = self._after_opening(told.link)
        if link.state is not LinkState.PASSIVE:
            return told.passive_ns
        return told.passive_ns + max(0, now_ns - link.since_ns)

    def _latest(self) -> LinkStatus:
        return self._after_opening(self._told.link)

    def _after_opening(self, told: LinkStatus) -> LinkStatus:
        """What error frames told, where they told it after the opening."""
        opened = self._opened
        return told if told.since_ns >= opened.since_ns else opened
