"""State of a network interface, by ioctl.

rtnetlink's notices say when to ask; they can be lost, an answer cannot. It needs no privilege and
costs some microseconds. A change between two queries (down and up again) is reported by the CAN
socket itself.
"""

import errno
import fcntl
import os
import socket
import struct
from typing import NamedTuple

_SIOCGIFNAME = 0x8910
_SIOCGIFFLAGS = 0x8913
_SIOCGIFHWADDR = 0x8927
_SIOCGIFINDEX = 0x8933
_SIOCGIFTXQLEN = 0x8942
_IFF_UP, _IFF_RUNNING = 0x1, 0x40
_ARPHRD_CAN = 280

_by_name = struct.Struct("16s24x")
_by_index = struct.Struct("16xi20x")
_integer = struct.Struct("16xi20x")
_short = struct.Struct("16xH22x")
_name = struct.Struct("16s24x")


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
        request = _by_name.pack(os.fsencode(name))
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
            answer = self._ask(_SIOCGIFNAME, _by_index.pack(number))
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
