"""Frames by the thousand: sendmmsg, so that sending costs the machine next to nothing."""

import ctypes
import json
import math
import os
import socket
import struct
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

EFF, RTR, ERR = 0x8000_0000, 0x4000_0000, 0x2000_0000
_BATCH_S = 0.005
_PATIENCE_S = 60.0
_frame = struct.Struct("=IB3x8s")


class _Part(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Header(ctypes.Structure):
    """struct msghdr."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint32),
        ("parts", ctypes.POINTER(_Part)),
        ("part_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    """struct mmsghdr."""

    _fields_ = (("header", _Header), ("sent", ctypes.c_uint))


class Flood(NamedTuple):
    """What to send, in turn: identifiers with SocketCAN's flags, and data."""

    frames: Sequence[tuple[int, bytes]]
    rate_hz: float
    duration_s: float
    channel: str = "vcan0"

    def pour(self, counts_path: Path) -> None:
        """Send; what was sent is in the file afterwards, by identifier."""
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
            bus.bind((self.channel,))
            counts = self._pour(bus)
        part = counts_path.with_suffix(".part")
        part.write_text(json.dumps(counts))
        part.rename(counts_path)

    def _pour(self, bus: socket.socket) -> Counter[int]:
        """Whole batches of about 5 ms; one that is late follows at once, none is left out."""
        turns = max(1, round(self.rate_hz * _BATCH_S / len(self.frames)))
        batch = tuple(self.frames) * turns
        messages, _keep = _messages(batch)
        sendmmsg = ctypes.CDLL(None, use_errno=True).sendmmsg
        counts: Counter[int] = Counter()
        due_s = time.monotonic()
        for _ in range(math.ceil(self.rate_hz * self.duration_s / len(batch))):
            time.sleep(max(0, due_s - time.monotonic()))
            sent = sendmmsg(bus.fileno(), messages, len(batch), 0)
            if sent < 0:
                number = ctypes.get_errno()
                raise OSError(number, os.strerror(number))
            counts.update(can_id for can_id, _ in batch[:sent])
            due_s += len(batch) / self.rate_hz
        return counts


def _messages(frames: Sequence[tuple[int, bytes]]) -> tuple[ctypes.Array[_Message], object]:
    raw = b"".join(_frame.pack(can_id, len(data), data) for can_id, data in frames)
    buffer = ctypes.create_string_buffer(raw, len(raw))
    begin = ctypes.addressof(buffer)
    count = len(frames)
    parts = (_Part * count)(*(_Part(begin + _frame.size * i, _frame.size) for i in range(count)))
    messages = (_Message * count)()
    for i in range(count):
        messages[i].header.parts = ctypes.pointer(parts[i])
        messages[i].header.part_count = 1
    return messages, (buffer, parts)


def poured(counts_path: Path) -> Counter[int]:
    """What a flood that has ended sent, by identifier with flags."""
    end_s = time.monotonic() + _PATIENCE_S
    while not counts_path.exists():
        assert time.monotonic() < end_s, "the flood did not end"
        time.sleep(0.02)
    return Counter({int(key): n for key, n in json.loads(counts_path.read_text()).items()})


def send(*frames: tuple[int, bytes], channel: str = "vcan0") -> None:
    """These frames at once, flags included, from a socket of its own."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind((channel,))
        for can_id, data in frames:
            bus.send(_frame.pack(can_id, len(data), data))
