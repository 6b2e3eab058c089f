"""One gateway on an interface of this machine, and no second one.

The lock is the name of a Unix socket in the abstract namespace: it belongs to the network
namespace that the interface is in, needs no file, and is free again when the process has ended,
however it ended.
"""

import contextlib
import os
import socket
import struct

from vcu_gateway.errors import Problem, UnavailableError

_WAITING = 16
_credentials = struct.Struct("3i")


class Claim:
    """This process alone commands on an interface, until `release` or its end."""

    def __init__(self, channel: str) -> None:
        """Take it; UnavailableError where another gateway has it."""
        self._name = b"\0vcu-gateway/" + os.fsencode(channel)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(self._name)
            self._socket.listen(_WAITING)  # only so that others can ask who it is
        except OSError as error:
            self._socket.close()
            raise UnavailableError(_refusal(channel, self._name)) from error

    def release(self) -> None:
        """Let another gateway have it."""
        self._socket.close()


def _refusal(channel: str, name: bytes) -> Problem:
    pid = _holder(name)
    who = "another gateway" if pid is None else f"another gateway, process {pid},"
    what = f"{who} commands on {channel} already; a second one would fight it"
    return Problem(what, remedy="stop that one first, or set bus.channel to another interface")


def _holder(name: bytes) -> int | None:
    with (
        contextlib.suppress(OSError),
        socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asked,
    ):
        asked.setblocking(False)
        asked.connect(name)
        credentials = asked.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _credentials.size)
        return _credentials.unpack(credentials)[0] or None
    return None
