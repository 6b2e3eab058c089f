"""python-can's SocketCAN bus, reading what the kernel says beside each frame.

python-can's own reading keeps the wall-clock stamp alone; the drop counter and the own-echo
flag are lost, every frame costs a wake-up, and time-outs follow the wall clock. This subclass
replaces waiting and reading; sockets, filters and the Notifier above stay python-can's.
"""

import errno
import select
import socket
import struct
import time
from collections import deque
from typing import Any

import can
from can.interfaces.socketcan.socketcan import SocketcanBus

from vcu_gateway.bus.clocks import read_clocks
from vcu_gateway.core.clock import ClockPair, arrival_ns, steady
from vcu_gateway.core.schedule import next_drain_ns

_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_FRAME_BYTES = 16
_FD_FRAME_BYTES = 72
_ANCILLARY_BYTES = socket.CMSG_SPACE(16) + socket.CMSG_SPACE(4)
_EFF_FLAG, _RTR_FLAG, _ERR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
_DRAIN_AT_MOST = 256
_NS_PER_S = 1_000_000_000
# Waking and reading all that gathered in 10 ms on a saturated bus takes less than this.
_LEAD_NS = 2_000_000

_head = struct.Struct("=IB3x")
_frame = struct.Struct("=IB3x8s")
_timespec = struct.Struct("@qq")
_counter = struct.Struct("@I")


class DrainingSocketcanBus(SocketcanBus):
    """A SocketCAN bus that lets frames gather for a moment and then reads them all.

    `Message.timestamp` is the kernel's arrival stamp in seconds of the MONOTONIC clock.
    `Message.is_rx` is False only for our own frame that has come back because it left.

    Attributes:
        dropped: frames that the kernel dropped because the receive buffer was full.
        wakes: times that the reader woke, frames or not.
    """

    def __init__(
        self,
        channel: str,
        can_filters: Any,
        gather_s: float,
        receive_buffer_bytes: int | None,
    ) -> None:
        self._pending: deque[can.Message] = deque()
        self._gather_ns = int(gather_s * _NS_PER_S)
        self._grid: tuple[int, int] | None = None
        self._distance_ns: int | None = None
        self._failed = False
        self._clocks = read_clocks()
        self.dropped = 0
        self.wakes = 0
        super().__init__(channel=channel, receive_own_messages=True, can_filters=can_filters)
        self.socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        if receive_buffer_bytes is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
        self._poll = select.poll()
        self._poll.register(self.socket, select.POLLIN)

    @property
    def receive_buffer_bytes(self) -> int:
        """The receive buffer that the kernel really gave (it doubles what was asked)."""
        return self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after `timeout` seconds of the monotonic clock.

        Raises can.CanOperationError once when the interface fails; afterwards it only waits,
        so that a Notifier on a dead socket does not spin.
        """
        pending = self._pending
        if pending:
            return pending.popleft()
        self.wakes += 1
        if self._failed:
            time.sleep(timeout or 0.1)
            return None
        self._let_gather()
        self._drain()
        if not pending and self._poll.poll(None if timeout is None else timeout * 1000):
            self._drain()
        return pending.popleft() if pending else None

    def align(self, origin_ns: int, period_ns: int) -> None:
        """Read shortly before every point of this grid, whatever may gather otherwise."""
        self._grid = (origin_ns - _LEAD_NS, period_ns)

    def _let_gather(self) -> None:
        """Sleep until it is worth reading again; on a quiet bus that is now."""
        until_ns = next_drain_ns(self._clocks.monotonic_ns, self._gather_ns, self._grid)
        left_ns = until_ns - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / _NS_PER_S)

    def _drain(self) -> None:
        """Read all that waits, at most some hundreds of frames."""
        receive, failure = self.socket.recvmsg, None
        read: list[Any] = []
        try:
            for _ in range(_DRAIN_AT_MOST):
                # One by one: what was read before a failure must not be lost.
                read += (receive(_FD_FRAME_BYTES, _ANCILLARY_BYTES, socket.MSG_DONTWAIT),)
        except BlockingIOError:
            pass
        except OSError as error:
            failure = error
        # The clocks are read after the frames, so no stamp lies in their future.
        before, self._clocks = self._clocks, read_clocks()
        self._distance_ns = self._clocks.distance_ns if steady(before, self._clocks) else None
        self._pending.extend(self._dissect(received, before) for received in read)
        if failure is not None:
            # The interface going down is told once and mends itself; other errors do not.
            self._failed = failure.errno != errno.ENETDOWN
            raise can.CanOperationError(
                f"Failed to receive: {failure.strerror}", failure.errno
            ) from failure

    def _dissect(self, received: Any, before: ClockPair) -> can.Message:
        raw, ancillary, flags, _ = received
        can_id, length = _head.unpack_from(raw)
        extended = can_id & _EFF_FLAG != 0
        return can.Message(
            self._arrival_s(ancillary, before),
            can_id & (0x1FFF_FFFF if extended or can_id & _ERR_FLAG else 0x7FF),
            extended,
            can_id & _RTR_FLAG != 0,
            can_id & _ERR_FLAG != 0,
            None,
            length,
            bytearray(raw[8 : 8 + length]),
            len(raw) > _FRAME_BYTES,
            not flags & socket.MSG_CONFIRM,
        )

    def _arrival_s(self, ancillary: Any, before: ClockPair) -> float:
        at_ns = None
        for _level, kind, payload in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _timespec.unpack(payload)
                stamp_ns = seconds * _NS_PER_S + nanoseconds
                if self._distance_ns is None:
                    at_ns = arrival_ns(stamp_ns, before, self._clocks)
                else:
                    at_ns = stamp_ns - self._distance_ns
            elif kind == _SO_RXQ_OVFL:
                self.dropped = _counter.unpack(payload)[0]
        return (before.monotonic_ns if at_ns is None else at_ns) / _NS_PER_S

    def send_now(self, can_id: int, data: bytes) -> None:
        """Hand one extended data frame to the kernel without waiting.

        Raises OSError where it does not take it at once (ENOBUFS, EAGAIN, ENETDOWN, ...).
        """
        self.socket.send(_frame.pack(can_id | _EFF_FLAG, len(data), data), socket.MSG_DONTWAIT)
