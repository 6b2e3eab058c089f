"""Link state: the CAN controller's, from error frames, the carrier and loss."""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

# Classes and bits of include/uapi/linux/can/error.h.
_CLASS_CONTROLLER = 0x004
_CLASS_BUS_OFF = 0x040
_CLASS_RESTARTED = 0x100
ERROR_CLASSES = _CLASS_CONTROLLER | _CLASS_BUS_OFF | _CLASS_RESTARTED
"""Classes that change the link state; the others may come by the thousand."""

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

    Bus-off ends with a restart or with the controller's report that it is active again.
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
    """Carrier of the interface, from the kernel: a controller in bus-off has none."""

    present: bool
    since_ns: int


def with_carrier(link: LinkStatus, carrier: Carrier | None) -> LinkStatus:
    """The link that error frames reported, held against the carrier; None is not known.

    Without a carrier the bus is off, whether an error frame was seen or not. A carrier that
    came back after a bus-off ends it: the error frame that reports the restart may be lost.
    """
    if carrier is None:
        return link
    off = link.state is LinkState.BUS_OFF
    if not carrier.present:
        return link if off else LinkStatus(LinkState.BUS_OFF, carrier.since_ns)
    if off and carrier.since_ns > link.since_ns:
        return LinkStatus(LinkState.UP, carrier.since_ns)
    return link


class _Reported(NamedTuple):
    """State that error frames reported, and how long they had reported error-passive before."""

    link: LinkStatus
    passive_ns: int


class PassiveTime:
    """Error-passive time within the last 5 s, of what had gathered by each tick.

    Kept are the ticks by which more had gathered.
    """

    def __init__(self) -> None:
        self._gathered: deque[tuple[int, int]] = deque()

    def within(self, gathered_ns: int, now_ns: int) -> int:
        """How much of it fell into the window, or up to a tick more; it begins with a tick."""
        gathered = self._gathered
        if not gathered or gathered[-1][1] != gathered_ns:
            gathered.append((now_ns, gathered_ns))
        while len(gathered) > 1 and gathered[1][0] <= now_ns - _PASSIVE_WINDOW_NS:
            gathered.popleft()
        return gathered_ns - gathered[0][1]


class LinkMonitor:
    """Link state from error frames, carrier, opening and loss.

    Each field holds an immutable value that is replaced whole: any thread may read `link`.

    Attributes:
        link: the worst that is known.

    An opening does not undo what was reported: it is a time, and what was reported before that
    time no longer counts. So an error frame that arrives while the link is being opened is neither
    lost nor mistaken for one of the old link.

    A controller that restarts by itself may be in bus-off for less than a tick. `begin_tick`
    compares the last bus-off with the one of the tick before, by identity, and has a new one
    count for the tick that begins even where the link is up again:

        t =  0 ms  begin_tick()                 link: up
        t = 12 ms  error frame: bus-off         link: bus off since 12 ms
        t = 31 ms  error frame: restarted       link: up since 31 ms
        t = 50 ms  begin_tick()                 link: bus off since 12 ms
        t = 100 ms begin_tick()                 link: up since 31 ms
    """

    def __init__(self, now_ns: int) -> None:
        self._opened = self._known = LinkStatus(LinkState.UP, now_ns)
        self._reported = _Reported(self._opened, 0)
        self._last_off: LinkStatus | None = None
        self._carrier: Carrier | None = None
        self._lost: LinkStatus | None = None
        self._last_off_seen: LinkStatus | None = None
        self._missed: LinkStatus | None = None
        self._passive = PassiveTime()
        self.link = self._opened

    def take_error_frame(self, can_id: int, data: bytes | bytearray, at_ns: int) -> None:
        before = self._known
        link = after_error_frame(before, can_id, data, at_ns)
        if link.state is LinkState.BUS_OFF:
            self._last_off = link
        passive_ns = self._reported.passive_ns
        if before.state is LinkState.PASSIVE:
            passive_ns += max(0, link.since_ns - before.since_ns)
        self._reported = _Reported(link, passive_ns)
        self._judge()

    def open(self, opened: LinkStatus, carrier: Carrier | None = None) -> None:
        """The interface was opened then, in this state; earlier reports no longer count."""
        self._opened, self._carrier, self._lost = opened, carrier, None
        self._passive = PassiveTime()
        self._judge()

    def lose(self, now_ns: int) -> None:
        """The interface is down or gone; since the first of several calls."""
        if self._lost is None:
            self._lost = LinkStatus(LinkState.LOST, now_ns)
            self._judge()

    def change_carrier(self, carrier: Carrier) -> None:
        self._carrier = carrier
        self._judge()

    def begin_tick(self) -> None:
        """A bus-off that came and went since the last tick is to count in the one that begins."""
        last, missed = self._last_off, self._missed
        self._missed = None if last is self._last_off_seen else last
        self._last_off_seen = last
        if self._missed is not missed:
            self._judge()

    def _judge(self) -> None:
        """After every change: the state since the opening, and the worst of all."""
        reported, opened = self._reported.link, self._opened
        known = self._known = reported if reported.since_ns >= opened.since_ns else opened
        link = with_carrier(known, self._carrier)
        if link.state is not LinkState.BUS_OFF:
            link = self._missed or link
        self.link = self._lost or link

    def recent_passive_ns(self, now_ns: int) -> int:
        """Error-passive time within the last 5 s; once a tick."""
        return self._passive.within(self.passive_ns(now_ns), now_ns)

    def passive_ns(self, now_ns: int) -> int:
        """Error-passive time in all; that before an opening may be missing."""
        gathered_ns, link = self._reported.passive_ns, self._known
        if link.state is not LinkState.PASSIVE:
            return gathered_ns
        return gathered_ns + max(0, now_ns - link.since_ns)
