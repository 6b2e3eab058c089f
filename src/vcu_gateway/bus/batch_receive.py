"""recvmmsg(2): the frames that wait in a socket, in one call, with their stamps and flags.

Frame by frame a full receive buffer takes three times as long, in a virtual machine that pays
dearly for a system call fifty times. The standard library has no such call.
"""

import ctypes
import errno
import os
import socket
import struct
from itertools import islice

from vcu_gateway.units import NS_PER_S

# struct mmsghdr, struct iovec, and a control message with a struct timespec.
_header = struct.Struct("@PIPNPNi0PI0P")
_vector = struct.Struct("@PN")
_control = struct.Struct("@Niiqq")

Received = tuple[bytearray, int | None, int]
"""Bytes of a frame, its arrival in ns of the wall clock (None without a stamp), its flags."""


class BatchReceiver:
    """Receives from one socket without waiting; its buffers are made once."""

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
        recvmmsg = ctypes.CDLL(None, use_errno=True).recvmmsg
        self._recvmmsg = recvmmsg
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
        headers = islice(_header.iter_unpack(self._headers), count)
        controls = _control.iter_unpack(self._controls)
        begin = 0
        for header, (_, _, _, seconds, nanoseconds) in zip(headers, controls, strict=False):
            control_bytes, flags, length = header[5:]
            stamp_ns = seconds * NS_PER_S + nanoseconds if control_bytes else None
            taken += ((self._raw[begin : begin + length], stamp_ns, flags),)
            begin += self._frame_bytes
        # The kernel has written into the headers that it used.
        used = count * _header.size
        self._headers[:used] = self._fresh_headers[:used]
        return taken


def _address(buffer: bytearray) -> int:
    return ctypes.addressof(ctypes.c_char.from_buffer(buffer))
