"""State of a network interface, by ioctl; the problem with it, and its remedy, as sentences.

rtnetlink's notices say when to ask; they can be lost, an answer cannot. It needs no privilege and
costs some microseconds. A change between two queries (down and up again) is reported by the CAN
socket itself.
"""

import errno
import fcntl
import os
import socket
import struct
from collections.abc import Callable
from typing import NamedTuple

from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.errors import Problem

_SIOCGIFNAME = 0x8910
_SIOCGIFFLAGS = 0x8913
_SIOCGIFHWADDR = 0x8927
_SIOCGIFINDEX = 0x8933
_SIOCGIFTXQLEN = 0x8942
_IFF_UP, _IFF_RUNNING = 0x1, 0x40
_ARPHRD_CAN = 280

# struct ifreq with the name alone, or behind the name an integer or a short.
_name = struct.Struct("16s24x")
_integer = struct.Struct("16xi20x")
_short = struct.Struct("16xH22x")
_USUAL_BIT_S = 250_000
_WITHOUT_CAN = "this kernel has no CAN; try `vcu-gateway demo`, or a kernel with the can modules"


def can_socket_error() -> OSError | None:
    """Error that a raw CAN socket meets here; None where the kernel gives one."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except AttributeError:
        return OSError(errno.EAFNOSUPPORT, "this Python was built without CAN")
    except OSError as error:
        return error
    return None


class Interface(NamedTuple):
    """State of an interface at one instant.

    Attributes:
        number: the kernel's index of it; one that was deleted and made again has another.
        carrier: False while a CAN controller is bus-off; the kernel may report it 1 s late.
        tx_queue_frames: length of the transmit queue.
    """

    number: int
    is_can: bool
    up: bool
    carrier: bool
    tx_queue_frames: int


class Interfaces:
    """Queries of the kernel over one socket that is kept: it works when no new one can be had."""

    def __init__(self) -> None:
        self._socket: socket.socket | None = None

    def look(self, name: str) -> Interface | None:
        """The interface of this name; None where there is none."""
        request = _name.pack(os.fsencode(name))
        try:
            number, queue = (
                _integer.unpack(self._ask(code, request))[0]
                for code in (_SIOCGIFINDEX, _SIOCGIFTXQLEN)
            )
            flags, kind = (
                _short.unpack(self._ask(code, request))[0]
                for code in (_SIOCGIFFLAGS, _SIOCGIFHWADDR)
            )
        except OSError:
            return None
        up, running = bool(flags & _IFF_UP), bool(flags & _IFF_RUNNING)
        return Interface(number, kind == _ARPHRD_CAN, up, running, queue)

    def name_of(self, number: int) -> str | None:
        """Present name of the interface of this number; None where it is gone."""
        try:
            answer = self._ask(_SIOCGIFNAME, _integer.pack(number))
        except OSError:
            return None
        return os.fsdecode(_name.unpack(answer)[0].rstrip(b"\0"))

    def _ask(self, code: int, request: bytes) -> bytes:
        if self._socket is None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        return fcntl.ioctl(self._socket, code, request)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


def unopened(error: Exception, settings: BusSettings) -> Problem:
    code, channel = getattr(error, "errno", None), settings.channel
    if settings.interface == "udp_multicast" and "msgpack" in str(error):
        remedy = "install the extra: pip install 'vcu-gateway[multicast]'"
    elif settings.interface != "socketcan":
        remedy = "check bus.interface and bus.channel"
    elif code == errno.EAFNOSUPPORT:
        remedy = _WITHOUT_CAN
    elif code == errno.ENODEV:
        remedy = _how_to_make(settings)
    else:
        remedy = f"look at: ip -details link show {channel}"
    return Problem(f"cannot open {settings.interface} {channel}: {error}", remedy=remedy)


def unfit(found: Interface | None, settings: BusSettings, renamed_to: str | None) -> Problem | None:
    """Problem that keeps an interface from being opened; None where it can be.

    `renamed_to` is what the one that was open before is called now, None where it is gone.
    """
    channel = settings.channel
    if found is None and renamed_to is not None:
        remedy = f"rename it back, or set bus.channel to {renamed_to}"
        return Problem(f"{channel} was renamed to {renamed_to}", remedy=remedy)
    if found is None:
        what = f"cannot open socketcan {channel}: no such interface"
        return Problem(what, remedy=_how_to_make(settings) if _kernel_has_can() else _WITHOUT_CAN)
    if not found.is_can:
        what = f"cannot open socketcan {channel}: it is no CAN interface"
        return Problem(what, remedy="bus.channel must be one of: ip -brief link show type can")
    if not found.up:
        return Problem(f"{channel} is down", remedy=f"ip link set {channel} up")
    return None


def left(
    opened: Interface, found: Interface | None, channel: str, name_of: Callable[[int], str | None]
) -> str | None:
    """Problem of an interface in use that cannot be used any more; None where it can.

    `name_of` returns the present name of an interface.
    """
    if found is None or found.number != opened.number:
        name = name_of(opened.number)
        return f"{channel} is gone" if name is None else f"{channel} was renamed to {name}"
    return None if found.up else f"{channel} is down"


def _kernel_has_can() -> bool:
    error = can_socket_error()
    return error is None or error.errno not in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT)


def _how_to_make(settings: BusSettings) -> str:
    channel = settings.channel
    bit_rate = f"bitrate {settings.bit_rate_bit_s or _USUAL_BIT_S}"
    return (
        f"for a bench: ip link add dev {channel} type vcan && ip link set {channel} up; "
        f"for an adapter: plug it in and ip link set {channel} up type can {bit_rate}"
    )
