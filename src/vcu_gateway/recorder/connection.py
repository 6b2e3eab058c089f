"""Connection of a gateway: what it said of itself, and its datagrams."""

import contextlib
import socket
import sys
import time
from collections.abc import Mapping
from typing import Any

from vcu_gateway.recorder.bounds import check_lines, checked_hello
from vcu_gateway.recorder.senders import Allowance, Sender
from vcu_gateway.recording import datagram
from vcu_gateway.recording.datagram import DatagramError, HelloPart, HelloText, TickParts

BUFFER_BYTES = 1 << 20
"""Room for the longest datagram."""
_MOST_FRAMES = 50_000
_MOST_COUNT = 1 << 63
_CHECKPOINTS = 20, 4.0
"""At once, and a second: a gateway that loses datagrams sends one every 250 ms."""


class GatewayConnection:
    """Connected gateway, as the receiver's thread has it.

    Attributes:
        sender: process at the other end.
        hello: what it said of itself; None before that.
        begin_again: it is to be closed, so that its gateway connects again and begins a segment.
        ended_by_gateway: its gateway has closed it.
        handed_on: a tick of it was put into the backlog.
        hello_bytes: that the long texts of its HELLO take in memory.
        fault: why it is to be closed for good: its data cannot be written; None without.
        begun_s, latest_s: when it began, and when the latest datagram came, monotonic.
        frames: that it handed on so far, lost ones counted, since the gateway started.
        since_wall_ns, last_wall_ns: when it began, and when the latest datagram came.
    """

    def __init__(self, sock: socket.socket, sender: Sender) -> None:
        self._sock = sock
        self.sender = sender
        self._hello_text = HelloText()
        self.hello: Mapping[str, Any] | None = None
        self.begin_again = self.ended_by_gateway = self.handed_on = False
        self.hello_bytes = 0
        self.fault: DatagramError | None = None
        self.frames = 0
        self._checkpoints = Allowance(*_CHECKPOINTS)
        self.begun_s = self.latest_s = time.monotonic()
        self.since_wall_ns = self.last_wall_ns = time.time_ns()

    def fileno(self) -> int:
        return self._sock.fileno()

    @property
    def unfinished_bytes(self) -> int:
        return self._hello_text.size

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
        self.last_wall_ns, self.latest_s = time.time_ns(), time.monotonic()
        received = bytes(memoryview(buffer)[:size])
        if received[0] != datagram.HELLO:
            return self._tick(received)
        part = datagram.unpack(received)
        if not isinstance(part, HelloPart) or self.hello is not None:
            raise DatagramError("a HELLO after the HELLO")
        self._take(part)
        return None

    def _tick(self, received: bytes) -> TickParts:
        if self.hello is None:
            raise DatagramError("a tick before the HELLO")
        tick = datagram.tick_parts(received)
        if tick.frame_count > _MOST_FRAMES:
            raise DatagramError(f"{tick.frame_count} frames in one datagram are too many")
        if max(tick.header) >= _MOST_COUNT or tick.header.frames < tick.frame_count:
            raise DatagramError("its numbers of frames and datagrams cannot be")
        check_lines(tick.lines)
        if tick.begins_segment and not self._checkpoints.take():
            raise DatagramError("too many checkpoints", "rate")
        self.frames = tick.header.frames
        return tick

    def _take(self, part: HelloPart) -> None:
        if len(part.text) > datagram.PART_BYTES:
            raise DatagramError(f"a part of {len(part.text)} bytes is too long", "hello")
        hello = self._hello_text.take(part)
        if hello is not None:
            self.hello = checked_hello(hello)
            self.hello_bytes = sum(sys.getsizeof(hello[key]) for key in ("config", "dbc"))

    def forget_hello(self) -> None:
        """Keep of it what is shown: its drive has the rest, or there will be none."""
        if self.hello is not None:
            self.hello = {key: self.hello[key] for key in ("run", "channel")}
            self.hello_bytes = 0

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._sock.close()
