"""SocketCAN bus that drains its socket, with kernel stamps, own echoes and drop counter.

python-can's own reading keeps the wall-clock stamp alone; the drop counter and the own-echo
flag are lost, every frame costs a wake-up, and time-outs follow the wall clock. This subclass
replaces reading and never waits; sockets, filters and the Notifier above stay python-can's.
"""

import contextlib
import ctypes
import errno
import os
import socket
import struct
from collections import deque
from itertools import islice
from typing import Any

from vcu_gateway.python_can import can

# isort: split
from can.interfaces.socketcan.socketcan import SocketcanBus

from vcu_gateway.bus.settings import BusCounters, read_clocks
from vcu_gateway.core.link import ERROR_CLASSES
from vcu_gateway.core.schedule import arrival_ns, steady
from vcu_gateway.units import NS_PER_S

_SO_MEMINFO = 55
_CAN_RAW_ERR_FILTER = 2
_MEMINFO_DROPS = 8
_FRAME_BYTES = 16
_FD_FRAME_BYTES = 72
_EFF_FLAG, _RTR_FLAG, _ERR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
_BATCH_FRAMES = 256
# Half of what the kernel's usual buffer holds: without so many in it nothing was dropped, but where
# the buffer is a smaller one. Then the count is up to a second late.
_MANY_FRAMES = 139
# The kernel takes twice of it: 1,365 frames, 180 ms of a full bus of 1 Mbit/s. Where it grants no
# more than its usual limit (net.core.rmem_max), it is 555 frames, 73 ms.
_USUAL_BUFFER_BYTES = 524_288
_FAILURES_AT_MOST = 4
_CONTROLLER_BYTE = 9
_MSG_CONFIRM = int(socket.MSG_CONFIRM)  # plain: `&` with an enumeration is Python, half a µs

_head = struct.Struct("=IB3x")
_frame = struct.Struct("=IB3x8s")
_meminfo = struct.Struct("@9I")
# struct mmsghdr, struct iovec, a control message with a struct timespec; what is read of them.
_header = struct.Struct("@PIPNPNi0PI0P")
_vector = struct.Struct("@PN")
_control = struct.Struct("@Niiqq")
_outcome = struct.Struct(f"@{struct.calcsize('@PIPNP')}xNi0PI0P")
_stamp = struct.Struct(f"@{struct.calcsize('@Nii0q')}xqq")

Received = tuple[bytearray, int | None, int]
"""Bytes of a frame, its arrival in ns of the wall clock (None without a stamp), its flags."""


class BatchReceiver:
    """recvmmsg(2): the frames that wait in a socket, in one call, with their stamps and flags.

    Frame by frame a full receive buffer takes three times as long, in a virtual machine that pays
    dearly for a system call fifty times. The standard library has no such call. The buffers are
    made once.
    """

    def __init__(self, descriptor: int, frames: int, frame_bytes: int) -> None:
        self._descriptor, self._frames, self._frame_bytes = descriptor, frames, frame_bytes
        self._raw = bytearray(frames * frame_bytes)
        self._controls = bytearray(frames * _control.size)
        self._vectors = bytearray(frames * _vector.size)
        self._headers = bytearray(frames * _header.size)
        raw, controls, vectors = map(_address, (self._raw, self._controls, self._vectors))
        for index in range(frames):
            _vector.pack_into(
                self._vectors, index * _vector.size, raw + index * frame_bytes, frame_bytes
            )
            vector, control = vectors + index * _vector.size, controls + index * _control.size
            _header.pack_into(
                self._headers, index * _header.size, 0, 0, vector, 1, control, _control.size, 0, 0
            )
        self._fresh_headers = bytes(self._headers)
        self._recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._address = ctypes.c_void_p(_address(self._headers))

    def receive(self) -> list[Received]:
        """What waits, in order, as many as there are buffers; OSError where the socket failed."""
        count = self._recvmmsg(
            self._descriptor, self._address, self._frames, socket.MSG_DONTWAIT, None
        )
        if count >= 0:
            return self._taken(count)
        number = ctypes.get_errno()
        if number in (errno.EAGAIN, errno.EINTR):
            return []
        raise OSError(number, os.strerror(number))

    def _taken(self, count: int) -> list[Received]:
        taken: list[Received] = []
        begin, outcomes = 0, islice(_outcome.iter_unpack(self._headers), count)
        for (control_bytes, flags, length), (seconds, nanoseconds) in zip(
            outcomes, _stamp.iter_unpack(self._controls), strict=False
        ):
            stamp_ns = seconds * NS_PER_S + nanoseconds if control_bytes else None
            taken.append((self._raw[begin : begin + length], stamp_ns, flags))
            begin += self._frame_bytes
        # The kernel has written into the headers that it used.
        used = count * _header.size
        self._headers[:used] = self._fresh_headers[:used]
        return taken


def _address(buffer: bytearray) -> int:
    return ctypes.addressof(ctypes.c_char.from_buffer(buffer))


class DrainingSocketcanBus(SocketcanBus):
    """A SocketCAN bus that is read in batches, by the thread that calls `read_batch`.

    `Message.timestamp` is the kernel's arrival stamp in seconds of the MONOTONIC clock.
    `Message.is_rx` is False only for our own frame that has come back because it left.

    What the kernel drops is counted in `BusCounters.dropped`, by `read_batch` and `finish`.
    """

    def __init__(
        self,
        channel: str,
        can_filters: Any,
        receive_buffer_bytes: int | None,
        counters: BusCounters,
    ) -> None:
        self._batch: deque[Received] = deque()
        self._more_since_s: float | None = None
        self._failure: OSError | None = None
        self._failed = False
        self._before = self._clocks = read_clocks()
        self._distance_ns: int | None = None
        self._counters = counters
        self._drops_before = 0
        self._count_drops_ns = 0
        self._last_error: tuple[int, int] | None = None
        try:
            super().__init__(channel=channel, receive_own_messages=True, can_filters=can_filters)
            self._set_up(receive_buffer_bytes)
        except BaseException:
            self._is_shutdown = True  # nothing more to close than the socket
            if hasattr(self, "socket"):
                self.socket.close()
            raise

    def _set_up(self, receive_buffer_bytes: int | None) -> None:
        self._receiver = BatchReceiver(self.socket.fileno(), _BATCH_FRAMES, _FD_FRAME_BYTES)
        option = self.socket.setsockopt
        option(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, ERROR_CLASSES)
        # The least that the kernel grants: about six frames of ours wait, however long the
        # interface's queue is. What waits is stale when it leaves.
        option(socket.SOL_SOCKET, socket.SO_SNDBUF, 0)
        if receive_buffer_bytes is not None:
            option(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
        elif self.receive_buffer_bytes < _USUAL_BUFFER_BYTES:
            option(socket.SOL_SOCKET, socket.SO_RCVBUF, _USUAL_BUFFER_BYTES)

    @property
    def receive_buffer_bytes(self) -> int:
        """Receive buffer that the kernel granted, in the unit of SO_RCVBUF as it is set."""
        return self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next frame of the batch; None without one, or where it repeats the one before.

        It never waits. Raises can.CanOperationError once, at the end of a batch, where the
        interface has failed.
        """
        del timeout
        if self._batch:
            return self._dissect(self._batch.popleft())
        failure, self._failure = self._failure, None
        if failure is not None:
            why = f"Failed to receive: {failure.strerror}"
            raise can.CanOperationError(why, failure.errno) from failure
        return None

    def read_batch(self, now_ns: int) -> int:
        """Read what waits in the socket, at most some hundreds of frames.

        The number of calls of `recv` that it takes to receive them: one for each frame, one for
        a failure.
        """
        if self._failed:
            return 0
        self._more_since_s = None
        read, self._failure = self._read()
        # The interface is down or gone, and the socket reports it once. It is not read again: it
        # is to be closed.
        self._failed = self._failure is not None
        if read:
            self._begin_batch(read)
        if now_ns >= self._count_drops_ns or len(read) >= _MANY_FRAMES:
            self._count_drops_ns = now_ns + NS_PER_S
            self._count_drops()
        return len(read) + self._failed

    def _begin_batch(self, read: list[Received]) -> None:
        # The clocks are read after the frames, so no stamp lies in their future.
        self._before, self._clocks = self._clocks, read_clocks()
        is_steady = steady(self._before, self._clocks)
        self._distance_ns = self._clocks.distance_ns if is_steady else None
        self._last_error = None
        self._batch.extend(read)
        is_full = len(read) >= _BATCH_FRAMES
        self._more_since_s = self._arrival_s(read[-1][1]) if is_full else None

    def has_more(self, until_ns: int) -> bool:
        """True where a frame that arrived until this time may wait behind the last batch."""
        since_s = self._more_since_s
        return not self._failed and since_s is not None and since_s * NS_PER_S <= until_ns

    def _read(self) -> tuple[list[Received], OSError | None]:
        """Waiting frames, at most some hundreds, and the first failure."""
        failures: list[OSError] = []
        while len(failures) < _FAILURES_AT_MOST:
            try:
                return self._receiver.receive(), failures[0] if failures else None
            except OSError as error:
                failures.append(error)  # reported once, before the frames that wait behind it
        return [], failures[0]

    def _count_drops(self) -> None:
        """Take over the kernel's 32-bit counter: SO_RXQ_OVFL's, at this instant."""
        memory_info = self.socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _meminfo.size)
        now = _meminfo.unpack(memory_info)[_MEMINFO_DROPS]
        self._counters.dropped += (now - self._drops_before) & 0xFFFF_FFFF
        self._drops_before = now

    def finish(self) -> None:
        """Let no more frames in; those that arrived and were not read count as dropped.

        Afterwards the counters account for every frame.
        """
        self._failed = True  # the socket is not read any more: it is to be closed
        with contextlib.suppress(OSError):  # the interface may be gone: nothing comes then
            self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
            self.socket.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, 0)
        self._counters.dropped += self._left()
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

    def _dissect(self, received: Received) -> can.Message | None:
        raw, stamp_ns, flags = received
        can_id, length = _head.unpack_from(raw)
        if can_id & _ERR_FLAG and self._repeats(can_id, raw[_CONTROLLER_BYTE]):
            return None
        extended = can_id & _EFF_FLAG != 0
        return can.Message(
            self._arrival_s(stamp_ns),
            can_id & (0x1FFF_FFFF if extended or can_id & _ERR_FLAG else 0x7FF),
            extended,
            can_id & _RTR_FLAG != 0,
            can_id & _ERR_FLAG != 0,
            None,
            length,
            raw[8 : 8 + length],
            len(raw) > _FRAME_BYTES,
            not flags & _MSG_CONFIRM,
        )

    def _repeats(self, can_id: int, controller_bits: int) -> bool:
        """Whether this error frame equals the last one of this reading: a flood's do."""
        error = can_id, controller_bits
        repeats = error == self._last_error
        self._last_error = error
        self._counters.repeated_errors += repeats
        return repeats

    def _arrival_s(self, stamp_ns: int | None) -> float:
        if stamp_ns is None:
            return self._before.monotonic_ns / NS_PER_S
        if self._distance_ns is None:
            return arrival_ns(stamp_ns, self._before, self._clocks) / NS_PER_S
        return (stamp_ns - self._distance_ns) / NS_PER_S

    def send_now(self, can_id: int, data: bytes) -> None:
        """Hand one extended data frame to the kernel without waiting.

        Raises OSError where it does not take it at once (ENOBUFS, EAGAIN, ENETDOWN, ...).
        """
        self.socket.send(_frame.pack(can_id | _EFF_FLAG, len(data), data), socket.MSG_DONTWAIT)
