"""What the kernel says of a CAN interface beyond its flags, asked once at each opening.

Asked by rtnetlink (RTM_GETLINK). It may make the driver ask its hardware, so it is not asked
often; where it cannot be asked, everything is unknown and the gateway goes on without.
"""

import os
import socket
import struct
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.core.link import LinkState

_RTM_NEWLINK, _RTM_GETLINK = 16, 18
_NLM_F_REQUEST = 1
_IFLA_IFNAME, _IFLA_QDISC, _IFLA_LINKINFO, _IFLA_EXT_MASK = 3, 6, 18, 29
_IFLA_INFO_DATA, _IFLA_CAN_BITTIMING, _IFLA_CAN_STATE = 2, 1, 4
_RTEXT_FILTER_SKIP_STATS = 8
_TYPE_MASK = 0x3FFF
_IFF_LOWER_UP, _IFF_ECHO = 0x1_0000, 0x4_0000
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


class Details(NamedTuple):
    """Of one CAN interface; None is not known.

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


def details(name: str) -> Details:
    """Ask the kernel; nothing is raised."""
    try:
        with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as asked:
            asked.settimeout(_PATIENCE_S)
            asked.send(_request(name))
            return parsed(asked.recv(_MOST_BYTES))
    except (OSError, struct.error):
        return Details()


def _request(name: str) -> bytes:
    body = _link.pack(socket.AF_UNSPEC, 0, 0, 0, 0)
    body += _packed(_IFLA_IFNAME, os.fsencode(name) + b"\0")
    body += _packed(_IFLA_EXT_MASK, _number.pack(_RTEXT_FILTER_SKIP_STATS))
    return _header.pack(_header.size + len(body), _RTM_GETLINK, _NLM_F_REQUEST, 1, 0) + body


def _packed(kind: int, value: bytes) -> bytes:
    return _attribute.pack(_attribute.size + len(value), kind) + value + bytes(-len(value) % 4)


def parsed(answer: bytes) -> Details:
    """The kernel's answer; struct.error where it is torn."""
    length, kind, _, _, _ = _header.unpack_from(answer)
    if kind != _RTM_NEWLINK:
        return Details()
    _, _, _, flags, _ = _link.unpack_from(answer, _header.size)
    found = dict(_attributes(answer[_header.size + _link.size : length]))
    queue = found.get(_IFLA_QDISC, b"").rstrip(b"\0")
    info = dict(_attributes(found.get(_IFLA_LINKINFO, b"")))
    controller = dict(_attributes(info.get(_IFLA_INFO_DATA, b"")))
    return Details(
        driver_echoes=bool(flags & _IFF_ECHO),
        queue_is_used=queue != b"noqueue" if queue else None,
        state=_STATES.get(_first(controller, _IFLA_CAN_STATE)),
        bit_rate_bit_s=_first(controller, _IFLA_CAN_BITTIMING) or None,
        carrier=bool(flags & _IFF_LOWER_UP),
    )


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
