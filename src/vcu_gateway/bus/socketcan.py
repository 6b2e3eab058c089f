"""SocketCAN bus that drains its socket, with kernel stamps, own echoes and drop counter.

python-can's own reading keeps the wall-clock stamp alone; the drop counter and the own-echo
flag are lost, every frame costs a wake-up, and time-outs follow the wall clock. This subclass
replaces waiting and reading; sockets, filters and the Notifier above stay python-can's.
"""

import contextlib
import select
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

from vcu_gateway.python_can import can

# isort: split
from can.interfaces.socketcan.socketcan import SocketcanBus

from vcu_gateway.bus.frame_queue import FrameQueue
from vcu_gateway.bus.settings import BusCounters
from vcu_gateway.bus.timestamps import read_clocks
from vcu_gateway.core.arrival_time import ClockPair, arrival_ns, steady
from vcu_gateway.core.link import ERROR_CLASSES
from vcu_gateway.core.schedule import next_drain_ns
from vcu_gateway.units import NS_PER_S

_SO_MEMINFO = 55
_CAN_RAW_ERR_FILTER = 2
_MEMINFO_DROPS = 8
_FRAME_BYTES = 16
_FD_FRAME_BYTES = 72
_ANCILLARY_BYTES = socket.CMSG_SPACE(16)
_EFF_FLAG, _RTR_FLAG, _ERR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
_DRAIN_AT_MOST = 256
_FAILURES_AT_MOST = 4
_CONTROLLER_BYTE = 9
# Waking and reading all that gathered in 10 ms on a saturated bus takes less than this.
_LEAD_NS = 2_000_000

_head = struct.Struct("=IB3x")
_frame = struct.Struct("=IB3x8s")
_timespec = struct.Struct("@qq")
_meminfo = struct.Struct("@9I")


class DrainingSocketcanBus(SocketcanBus):
    """A SocketCAN bus that lets frames gather for a moment and then reads them all.

    `Message.timestamp` is the kernel's arrival stamp in seconds of the MONOTONIC clock.
    `Message.is_rx` is False only for our own frame that has come back because it left.

    What the kernel drops is counted in `BusCounters.dropped`, by the reader and then by `finish`.

    Attributes:
        wakes: times that the reader woke, frames or not.
    """

    stamps_are_monotonic = True

    def __init__(
        self,
        channel: str,
        can_filters: Any,
        gather_s: float,
        receive_buffer_bytes: int | None,
        counters: BusCounters,
    ) -> None:
        self._queue = FrameQueue()
        self._reader: threading.Thread | None = None
        self._gather_ns = int(gather_s * NS_PER_S)
        self._grid: tuple[int, int] | None = None
        self._distance_ns: int | None = None
        self._failed = False
        self._clocks = read_clocks()
        self._counters = counters
        self._drops_before = 0
        self._last_error: tuple[int, int] | None = None
        self.wakes = 0
        try:
            super().__init__(channel=channel, receive_own_messages=True, can_filters=can_filters)
            self._set_up(receive_buffer_bytes)
        except BaseException:
            self._is_shutdown = True  # nothing more to close than the socket
            if hasattr(self, "socket"):
                self.socket.close()
            raise

    def _set_up(self, receive_buffer_bytes: int | None) -> None:
        option = self.socket.setsockopt
        option(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, ERROR_CLASSES)
        # The least that the kernel grants: about six frames of ours wait, however long the
        # interface's queue is. What waits is stale when it leaves.
        option(socket.SOL_SOCKET, socket.SO_SNDBUF, 0)
        if receive_buffer_bytes is not None:
            option(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
        self._poll = select.poll()
        self._poll.register(self.socket, select.POLLIN)
        self._tick_poll = select.poll()  # the ticking thread's: two must not wait on one
        self._tick_poll.register(self.socket, select.POLLIN)

    @property
    def library_bus(self) -> can.BusABC:
        """The bus that python-can's Notifier reads: this one."""
        return self

    @property
    def receive_buffer_bytes(self) -> int:
        """Receive buffer that the kernel granted, in the unit of SO_RCVBUF as it is set."""
        return self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame, or None after `timeout` seconds of the monotonic clock.

        Raises can.CanOperationError once when the interface fails; afterwards it only waits,
        so that a Notifier on a dead socket does not spin.
        """
        queue = self._queue
        if (message := queue.take()) is not None:
            return message
        self.wakes += 1
        self._reader = threading.current_thread()
        if self._failed:
            time.sleep(timeout or 0.1)
            return None
        self._let_gather()
        with queue.lock:
            self._drain()
        if not queue.pending and self._poll.poll(None if timeout is None else timeout * 1000):
            with queue.lock:
                self._drain()
        return queue.take()

    def _may_wait(self) -> bool:
        """Whether any frame that has arrived may not have been handed on yet.

        A frame goes from the socket through the lock's holder and the queue to the reader:
        looked for in this order it is not missed.
        """
        if self._tick_poll.poll(0):
            return True
        queue = self._queue
        return queue.lock.locked() or bool(queue.pending) or queue.with_reader

    def read_waiting(self, until_ns: int, hand_on: Callable[[can.Message], None]) -> bool:
        """Hand on, on the calling thread, all unread frames that arrived until this time.

        It goes on until nothing waits or a frame that arrived later was handed on. A frame that
        the reader holds is waited for; where that takes longer than some milliseconds the reader
        goes on alone, and `BusCounters.reader_not_awaited` counts it: False, and nothing was read.
        `hand_on` must not raise.

        Raises can.CanOperationError once when the interface fails, as `recv`.
        """
        if not self._may_wait():
            return True
        if self._reader is not None and not self._reader.is_alive():
            return True  # a dead reader must not go unnoticed: the drive ends for want of echoes
        last_s = 0.0

        def hand_on_noting(message: can.Message) -> None:
            nonlocal last_s
            last_s = message.timestamp
            hand_on(message)

        def read_more() -> bool:
            if self._failed or last_s * NS_PER_S > until_ns or not self._tick_poll.poll(0):
                return False
            self._drain()
            return True

        done = self._queue.empty(hand_on_noting, read_more)
        self._counters.reader_not_awaited += not done
        return done

    def align(self, origin_ns: int, period_ns: int) -> None:
        """Read shortly before every point of this grid, whatever may gather otherwise."""
        self._grid = (origin_ns - _LEAD_NS, period_ns)

    def _let_gather(self) -> None:
        """Sleep until it is worth reading again; on a quiet bus that is now."""
        until_ns = next_drain_ns(self._clocks.monotonic_ns, self._gather_ns, self._grid)
        left_ns = until_ns - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / NS_PER_S)

    def _drain(self) -> None:
        """Read all that waits, at most some hundreds of frames, holding the queue's lock."""
        if self._failed:
            return
        read, failure = self._read()
        # The clocks are read after the frames, so no stamp lies in their future.
        before, self._clocks = self._clocks, read_clocks()
        self._distance_ns = self._clocks.distance_ns if steady(before, self._clocks) else None
        self._last_error = None
        for received in read:
            if (message := self._dissect(received, before)) is not None:
                self._queue.pending.append(message)
        self._count_drops()
        if failure is not None:
            # The interface is down or gone, and the socket reports it once. It is not read again:
            # the listener closes it and opens another.
            self._failed = True
            raise can.CanOperationError(
                f"Failed to receive: {failure.strerror}", failure.errno
            ) from failure

    def _read(self) -> tuple[list[Any], OSError | None]:
        """Waiting frames, at most some hundreds, and the first failure."""
        receive = self.socket.recvmsg
        read: list[Any] = []
        failures: list[OSError] = []
        while len(failures) < _FAILURES_AT_MOST:
            try:
                for _ in range(_DRAIN_AT_MOST):
                    # One by one: what was read before a failure must not be lost.
                    read += (receive(_FD_FRAME_BYTES, _ANCILLARY_BYTES, socket.MSG_DONTWAIT),)
                break
            except BlockingIOError:
                break
            except OSError as error:
                failures.append(error)  # reported once, before the frames that wait behind it
        return read, failures[0] if failures else None

    def _count_drops(self) -> None:
        """Take over the kernel's 32-bit counter: SO_RXQ_OVFL's, at this instant."""
        memory_info = self.socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _meminfo.size)
        now = _meminfo.unpack(memory_info)[_MEMINFO_DROPS]
        self._counters.dropped += (now - self._drops_before) & 0xFFFF_FFFF
        self._drops_before = now

    def finish(self) -> None:
        """Let no more frames in; those that arrived and were not read count as dropped.

        Only when the reader has ended; afterwards the counters account for every frame.
        """
        with self._queue.lock:
            self._failed = True  # the socket is not read any more: it is to be closed
            with contextlib.suppress(OSError):  # the interface may be gone: nothing comes then
                self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
                self.socket.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, 0)
            self._counters.dropped += len(self._queue.pending) + self._left()
            self._queue.pending.clear()
            self._count_drops()

    def _left(self) -> int:
        left, failures = 0, 0
        while failures < _FAILURES_AT_MOST:
            try:
                self.socket.recv(_FD_FRAME_BYTES, socket.MSG_DONTWAIT)
                left += 1
            except BlockingIOError:
                break
            except OSError:
                failures += 1  # each kind is reported once, before what waits behind it
        return left

    def _dissect(self, received: Any, before: ClockPair) -> can.Message | None:
        raw, ancillary, flags, _ = received
        can_id, length = _head.unpack_from(raw)
        if can_id & _ERR_FLAG and self._repeats(can_id, raw[_CONTROLLER_BYTE]):
            return None
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

    def _repeats(self, can_id: int, controller_bits: int) -> bool:
        """Whether this error frame equals the last one of this reading: a flood's do."""
        error = can_id, controller_bits
        repeats = error == self._last_error
        self._last_error = error
        self._counters.repeated_errors += repeats
        return repeats

    def _arrival_s(self, ancillary: Any, before: ClockPair) -> float:
        if not ancillary:
            return before.monotonic_ns / NS_PER_S
        seconds, nanoseconds = _timespec.unpack(ancillary[0][2])
        stamp_ns: int = seconds * NS_PER_S + nanoseconds
        if self._distance_ns is None:
            return arrival_ns(stamp_ns, before, self._clocks) / NS_PER_S
        return (stamp_ns - self._distance_ns) / NS_PER_S

    def send_now(self, can_id: int, data: bytes) -> None:
        """Hand one extended data frame to the kernel without waiting.

        Raises OSError where it does not take it at once (ENOBUFS, EAGAIN, ENETDOWN, ...).
        """
        self.socket.send(_frame.pack(can_id | _EFF_FLAG, len(data), data), socket.MSG_DONTWAIT)
