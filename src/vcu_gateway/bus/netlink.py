"""rtnetlink: a CAN interface beyond its flags (RTM_GETLINK), and notices of changed links.

A query may make the driver read its hardware, so there is one at each opening; where it fails,
everything is unknown and the gateway goes on without. `describe` includes the counters, for the
doctor.
"""

import errno
import os
import socket
import struct
from collections.abc import Iterator

from vcu_gateway.bus.interface_info import (
    CanController,
    ControllerMode,
    DeviceCounters,
    ErrorCounters,
    InterfaceDetails,
    InterfaceInfo,
    InterfaceTraffic,
)
from vcu_gateway.core.link import LinkState

__all__ = ["InterfaceDetails", "describe", "described", "details", "subscribe"]

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
_error = struct.Struct("=i")
_mode = struct.Struct("=4xI")
_error_counters = struct.Struct("=2H")
_device_counters = struct.Struct("=6I")
_statistics = struct.Struct("=12Q")

_STATES: dict[int | None, LinkState] = {
    0: LinkState.UP,
    1: LinkState.WARNING,
    2: LinkState.PASSIVE,
    3: LinkState.BUS_OFF,
}


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
        number = -_error.unpack_from(answer, _header.size)[0] if is_refusal else errno.EBADMSG
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
        None if modes is None else ControllerMode(_mode.unpack_from(modes)[0]),
        None if errors is None else ErrorCounters._make(_error_counters.unpack_from(errors)),
        None if counters is None else DeviceCounters._make(_device_counters.unpack_from(counters)),
    )


def _traffic(found: dict[int, bytes]) -> InterfaceTraffic | None:
    """The used fields of struct rtnl_link_stats64."""
    if _IFLA_STATS64 not in found:
        return None
    counts = _statistics.unpack_from(found[_IFLA_STATS64])
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
