"""rtnetlink: a CAN interface beyond its flags (RTM_GETLINK), and notices of changed links.

A query may make the driver read its hardware, so there is one at each opening; where it fails,
everything is unknown and the gateway goes on without. `describe` includes the counters, for the
doctor.
"""

import contextlib
import errno
import os
import select
import socket
import struct
from collections.abc import Iterator
from enum import IntFlag
from typing import NamedTuple

from vcu_gateway.core.link import LinkState

_NLMSG_ERROR, _RTM_NEWLINK, _RTM_GETLINK = 2, 16, 18
_NLM_F_REQUEST = 1
_RTMGRP_LINK = 1
_IFLA_IFNAME, _IFLA_QDISC, _IFLA_LINKINFO, _IFLA_EXT_MASK = 3, 6, 18, 29
_IFLA_TXQLEN, _IFLA_STATS64 = 13, 23
_IFLA_INFO_KIND, _IFLA_INFO_DATA, _IFLA_INFO_XSTATS = 1, 2, 3
_IFLA_CAN_BITTIMING, _IFLA_CAN_STATE, _IFLA_CAN_CTRLMODE = 1, 4, 5
_IFLA_CAN_RESTART_MS, _IFLA_CAN_BERR_COUNTER = 6, 8
_RTEXT_FILTER_SKIP_STATS = 8
_TYPE_MASK = 0x3FFF
_IFF_UP, _IFF_LOWER_UP, _IFF_ECHO = 0x1, 0x1_0000, 0x4_0000
_ARPHRD_CAN = 280
_MOST_BYTES = 65_536
_PATIENCE_S = 0.3

_header = struct.Struct("=IHHII")
_link = struct.Struct("=BxHiII")
_attribute = struct.Struct("=HH")
_number = struct.Struct("=I")

_STATES: dict[int | None, LinkState] = {
    0: LinkState.UP,
    1: LinkState.WARNING,
    2: LinkState.PASSIVE,
    3: LinkState.BUS_OFF,
}
_NOTICE_BYTES = 4096


class InterfaceDetails(NamedTuple):
    """Details of one CAN interface; None is not known.

    Attributes:
        driver_echoes: our frames come back from the driver once they have left; where it does
            not, the kernel sends them back at once, which proves nothing.
        queue_is_used: False where frames go to the driver without any queue (vcan).
        state: of the controller; None too where there is no controller.
        bit_rate_bit_s: that the controller is set to.
        carrier: as it is at this instant.
    """

    driver_echoes: bool | None = None
    queue_is_used: bool | None = None
    state: LinkState | None = None
    bit_rate_bit_s: int | None = None
    carrier: bool | None = None


class ControllerMode(IntFlag):
    """Modes of a controller (CAN_CTRLMODE)."""

    LOOPBACK = 0x01
    LISTEN_ONLY = 0x02
    ONE_SHOT = 0x08
    ERROR_REPORTING = 0x10
    FD = 0x20
    PRESUME_ACK = 0x40


class ErrorCounters(NamedTuple):
    """The CAN protocol's error counters, 0..255."""

    transmit: int
    receive: int


class DeviceCounters(NamedTuple):
    """Counters of a controller since its driver was loaded."""

    bus_errors: int
    warnings: int
    passives: int
    bus_offs: int
    arbitrations_lost: int
    restarts: int


class CanController(NamedTuple):
    """A CAN controller; None is what its driver does not report.

    Attributes:
        restart_ms: time from bus-off to its restart by itself; 0 is never.
    """

    restart_ms: int | None = None
    modes: ControllerMode | None = None
    errors: ErrorCounters | None = None
    counters: DeviceCounters | None = None


class InterfaceTraffic(NamedTuple):
    """Frame counters since the interface exists."""

    received: int
    sent: int
    receive_dropped: int
    send_dropped: int
    overruns: int


class InterfaceInfo(NamedTuple):
    """Everything known of an interface; None and empty are not known.

    Attributes:
        kind: the kernel's word, such as vcan; can is any with a controller.
        discipline: the queueing discipline; noqueue is none.
        controller: None where there is none.
    """

    details: InterfaceDetails
    up: bool
    is_can: bool
    kind: str = ""
    discipline: str = ""
    tx_queue_frames: int | None = None
    controller: CanController | None = None
    traffic: InterfaceTraffic | None = None


def subscribe() -> socket.socket:
    """A socket that gets a notice of every change of a link and never waits; OSError if refused."""
    kind = socket.SOCK_RAW | socket.SOCK_NONBLOCK
    notices = socket.socket(socket.AF_NETLINK, kind, socket.NETLINK_ROUTE)
    try:
        notices.bind((0, _RTMGRP_LINK))
    except OSError:
        notices.close()
        raise
    return notices


def details(name: str) -> InterfaceDetails:
    """Details of this interface; all None where the kernel does not answer."""
    try:
        return described(_answer(_request(name))).details
    except (OSError, struct.error):
        return InterfaceDetails()


def describe(name: str) -> InterfaceInfo:
    """Everything about this interface; OSError where the kernel refuses, ENODEV where none is."""
    try:
        return described(_answer(_request(name, with_counters=True)))
    except struct.error as error:
        raise OSError(errno.EBADMSG, os.strerror(errno.EBADMSG)) from error


def _answer(request: bytes) -> bytes:
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as route_socket:
        route_socket.settimeout(_PATIENCE_S)
        route_socket.send(request)
        return route_socket.recv(_MOST_BYTES)


def _request(name: str, *, with_counters: bool = False) -> bytes:
    body = _link.pack(socket.AF_UNSPEC, 0, 0, 0, 0)
    body += _packed(_IFLA_IFNAME, os.fsencode(name) + b"\0")
    if not with_counters:
        body += _packed(_IFLA_EXT_MASK, _number.pack(_RTEXT_FILTER_SKIP_STATS))
    return _header.pack(_header.size + len(body), _RTM_GETLINK, _NLM_F_REQUEST, 1, 0) + body


def _packed(kind: int, value: bytes) -> bytes:
    return _attribute.pack(_attribute.size + len(value), kind) + value + bytes(-len(value) % 4)


def described(answer: bytes) -> InterfaceInfo:
    """Interface out of the kernel's answer; struct.error where it is torn, OSError if refused."""
    length, kind, _, _, _ = _header.unpack_from(answer)
    if kind != _RTM_NEWLINK:
        is_refusal = kind == _NLMSG_ERROR
        number = -struct.unpack_from("=i", answer, _header.size)[0] if is_refusal else errno.EBADMSG
        raise OSError(number, os.strerror(number))
    _, hardware, _, flags, _ = _link.unpack_from(answer, _header.size)
    found = dict(_attributes(answer[_header.size + _link.size : length]))
    info = dict(_attributes(found.get(_IFLA_LINKINFO, b"")))
    return InterfaceInfo(
        details=_details(flags, found, info),
        up=bool(flags & _IFF_UP),
        is_can=hardware == _ARPHRD_CAN,
        kind=_word(info, _IFLA_INFO_KIND),
        discipline=_word(found, _IFLA_QDISC),
        tx_queue_frames=_first(found, _IFLA_TXQLEN),
        controller=_controller(info) if _IFLA_INFO_DATA in info else None,
        traffic=_traffic(found),
    )


def _details(flags: int, found: dict[int, bytes], info: dict[int, bytes]) -> InterfaceDetails:
    queue = _word(found, _IFLA_QDISC)
    controller = dict(_attributes(info.get(_IFLA_INFO_DATA, b"")))
    return InterfaceDetails(
        driver_echoes=bool(flags & _IFF_ECHO),
        queue_is_used=queue != "noqueue" if queue else None,
        state=_STATES.get(_first(controller, _IFLA_CAN_STATE)),
        bit_rate_bit_s=_first(controller, _IFLA_CAN_BITTIMING) or None,
        carrier=bool(flags & _IFF_LOWER_UP),
    )


def _controller(info: dict[int, bytes]) -> CanController | None:
    data = dict(_attributes(info[_IFLA_INFO_DATA]))
    if _IFLA_CAN_STATE not in data:
        return None
    modes = data.get(_IFLA_CAN_CTRLMODE)
    errors = data.get(_IFLA_CAN_BERR_COUNTER)
    counters = info.get(_IFLA_INFO_XSTATS)
    return CanController(
        _first(data, _IFLA_CAN_RESTART_MS),
        None if modes is None else ControllerMode(struct.unpack_from("=4xI", modes)[0]),
        None if errors is None else ErrorCounters._make(struct.unpack_from("=2H", errors)),
        None if counters is None else DeviceCounters._make(struct.unpack_from("=6I", counters)),
    )


def _traffic(found: dict[int, bytes]) -> InterfaceTraffic | None:
    """The used fields of struct rtnl_link_stats64."""
    if _IFLA_STATS64 not in found:
        return None
    counts = struct.unpack_from("=12Q", found[_IFLA_STATS64])
    return InterfaceTraffic(counts[0], counts[1], counts[6], counts[7], counts[11])


def _word(attributes: dict[int, bytes], kind: int) -> str:
    return attributes.get(kind, b"").rstrip(b"\0").decode(errors="replace")


def _first(attributes: dict[int, bytes], kind: int) -> int | None:
    """The number that an attribute begins with; None where it is not there."""
    value = attributes.get(kind)
    return None if value is None else _number.unpack_from(value)[0]


def _attributes(area: bytes) -> Iterator[tuple[int, bytes]]:
    while len(area) >= _attribute.size:
        length, kind = _attribute.unpack_from(area)
        if length < _attribute.size:
            return
        yield kind & _TYPE_MASK, area[_attribute.size : length]
        area = area[length + -length % 4 :]


class LinkWatch:
    """Waits for rtnetlink's notices of links, for other input, a wake-up or a time-out.

    A notice says only that it is time to look; whatever it says of which interface is not read.
    The kernel reports lost notices as an error, which is as good as a notice.

    It waits for the time alone before it is opened.

    Attributes:
        is_told: False where the kernel refuses notices: one has to look from time to time.
    """

    def __init__(self) -> None:
        self.is_told = False
        self._poll = select.poll()
        self._wakeup: int | None = None
        self._notices: socket.socket | None = None

    def open(self) -> None:
        """Subscribe to notices, and take wake-ups from now on."""
        self._wakeup = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self.watch(self._wakeup)
        with contextlib.suppress(OSError):
            self._notices = subscribe()
            self.watch(self._notices.fileno())
            self.is_told = True

    def watch(self, descriptor: int) -> None:
        """Let input on this descriptor end a wait, too."""
        self._poll.register(descriptor, select.POLLIN)

    def wake(self) -> None:
        """End the wait, or the next one; from any thread."""
        if (wakeup := self._wakeup) is not None:
            os.eventfd_write(wakeup, 1)

    def wait(self, at_most_s: float) -> None:
        """Wait until there may be something to look at, or this time is over."""
        self._poll.poll(at_most_s * 1000)
        with contextlib.suppress(BlockingIOError):
            if self._wakeup is not None:
                os.eventfd_read(self._wakeup)
        with contextlib.suppress(OSError):  # none is left, or some were lost
            while self._notices is not None:
                self._notices.recv(_NOTICE_BYTES)

    def close(self) -> None:
        """Give the descriptors back; nobody waits any more."""
        wakeup, self._wakeup = self._wakeup, None
        if wakeup is not None:
            os.close(wakeup)
        if self._notices is not None:
            self._notices.close()
