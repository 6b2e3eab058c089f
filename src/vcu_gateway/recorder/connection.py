"""Connection of a gateway: what it said of itself, and its datagrams."""

import contextlib
import socket
import time
from collections.abc import Mapping
from typing import Any

from vcu_gateway.drive_format import datagram
from vcu_gateway.drive_format.datagram import DatagramError, HelloPart, HelloText, TickParts

_BUFFER_BYTES = 4 << 20
_HELLO_KEYS = {"run": str, "channel": str, "clock": dict, "config": str, "dbc": str}
_CLOCK_KEYS = ("monotonic_ns", "wall_ns")


class GatewayConnection:
    """Connected gateway, as the receiver's thread has it.

    Attributes:
        hello: what it said of itself; None before that.
        begin_again: it is to be closed, so that its gateway connects again and begins a segment.
        ended_by_gateway: its gateway has closed it.
        frames: that it handed on so far, lost ones counted, since the gateway started.
        since_wall_ns, last_wall_ns: when it began, and when the latest datagram came.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._hello_text = HelloText()
        self.hello: Mapping[str, Any] | None = None
        self.begin_again = self.ended_by_gateway = False
        self.frames = 0
        self.since_wall_ns = self.last_wall_ns = time.time_ns()

    def fileno(self) -> int:
        """Descriptor, for a selector."""
        return self._sock.fileno()

    def receive(self, buffer: bytearray) -> TickParts | None:
        """The next tick; None for a part of the HELLO.

        BlockingIOError where none waits, EOFError where the connection has ended; DatagramError
        where it is no datagram of a gateway, or too long.
        """
        size = self._sock.recv_into(buffer, 0, socket.MSG_TRUNC)
        if size == 0:
            raise EOFError
        if size > len(buffer):
            raise DatagramError(f"a datagram of {size} bytes is too long")
        self.last_wall_ns = time.time_ns()
        received = bytes(memoryview(buffer)[:size])
        if received[0] != datagram.HELLO:
            return self._tick(received)
        part = datagram.unpack(received)
        if isinstance(part, HelloPart):
            self._take(part)
        return None

    def _tick(self, received: bytes) -> TickParts:
        if self.hello is None:
            raise DatagramError("a tick before the HELLO")
        tick = datagram.tick_parts(received)
        self.frames = tick.header.frames
        return tick

    def _take(self, part: HelloPart) -> None:
        hello = self._hello_text.take(part)
        if hello is not None:
            self.hello = _checked(hello)

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(OSError):
            self._sock.close()


def new_buffer() -> bytearray:
    """Room for the longest datagram."""
    return bytearray(_BUFFER_BYTES)


def _checked(hello: Mapping[str, Any]) -> Mapping[str, Any]:
    """The HELLO; DatagramError where what the recorder needs is not in it."""
    for key, kind in _HELLO_KEYS.items():
        if not isinstance(hello.get(key), kind):
            raise DatagramError(f"the HELLO has no {key}")
    if not all(isinstance(hello["clock"].get(key), int) for key in _CLOCK_KEYS):
        raise DatagramError("the HELLO has no clock")
    if not hello["run"] or not hello["channel"].isprintable() or " " in hello["channel"]:
        raise DatagramError("the HELLO's run or channel cannot be used")
    return hello
