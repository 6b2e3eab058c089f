"""The other end of the bus: plays the vehicle and stamps what the program under test sends.

Where the kernel has CAN and a vcan0, that is the bus. Elsewhere a pair of AF_UNIX datagram
sockets stands in: the same calls, the same 16 bytes, stamps by the kernel, 278 frames of room.
"""

import contextlib
import ctypes
import os
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from bench import CHANNEL
from bench.traffic import timetable

_SO_TIMESTAMPNS = 35
_PR_SET_TIMERSLACK = 29
_EFF_FLAG = 0x8000_0000
_CHECK_S = 0.005
_timespec = struct.Struct("@qq")


def has_vcan() -> bool:
    """True where a real CAN socket can be bound to vcan0."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.bind((CHANNEL,))
    except OSError:
        return False
    return True


def bus_name() -> str:
    if not has_vcan():
        return "AF_UNIX datagram sockets standing in for CAN"
    lab = os.environ.get("VCU_LAB")
    return f"SocketCAN {CHANNEL}" + (f", in the lab ({lab})" if lab else "")


class Wire:
    """A running end of the bus.

    Attributes:
        far_fd: descriptor of the other end, for a program to inherit; None on a real bus.
        sent, refused: frames taken by the bus so far, and those for which it had no room.
        arrivals: (wall-clock ns, identifier) of each frame from the program.
    """

    def __init__(self, per_s: float | None, echo: bool = False) -> None:
        self._per_s = per_s
        self._echo = echo and not has_vcan()
        self.far_fd: int | None = None
        self.sent = self.refused = 0
        self.arrivals: list[tuple[int, int]] = []
        self._stopping = False
        self._socket = self._open()
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.setblocking(False)
        self._thread = threading.Thread(target=self._play)

    def _open(self) -> socket.socket:
        if has_vcan():
            real = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            real.bind((CHANNEL,))
            return real
        near, self._far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.far_fd = self._far.fileno()
        return near

    def __enter__(self) -> "Wire":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping = True
        self._thread.join()
        self._socket.close()
        if self.far_fd is not None:
            self._far.close()

    def stamps_ns(self, can_id: int, from_ns: int, to_ns: int) -> list[int]:
        """Kernel stamps of one command frame within a window of the wall clock."""
        return [at for at, who in self.arrivals if who == can_id and from_ns <= at < to_ns]

    def _play(self) -> None:
        # This thread's sleeps end on time; the programs under test keep the usual 50 us slack.
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
        start_ns = time.monotonic_ns()
        for at_ns, frame in timetable(self._per_s):
            while (left_ns := start_ns + at_ns - time.monotonic_ns()) > 0:
                self._take()
                time.sleep(min(left_ns / 1e9, _CHECK_S))
            if self._stopping:
                return
            self._send(frame)

    def _send(self, frame: bytes) -> None:
        try:
            self._socket.send(frame)
            self.sent += 1
        except OSError:  # full, or nobody there yet
            self.refused += 1
            self._take()
            time.sleep(0.001)

    def _take(self) -> None:
        for at_ns, frame in take(self._socket):
            self.arrivals.append((at_ns, int.from_bytes(frame[:4], "little") & ~_EFF_FLAG))
            if self._echo:
                # A byte too long: see program.py
                with contextlib.suppress(OSError):
                    self._socket.send(frame + b"\0")


def take(end: socket.socket) -> Iterator[tuple[int, bytes]]:
    """All that waits in a stamping socket: (wall-clock ns, frame)."""
    while True:
        try:
            raw, ancillary, _, _ = end.recvmsg(72, 64, socket.MSG_DONTWAIT)
        except OSError:
            return
        seconds, nanoseconds = _timespec.unpack(ancillary[0][2])
        yield seconds * 10**9 + nanoseconds, raw


def cpu_ns(pid: int) -> int:
    """Processor time of a process so far (clock_getcpuclockid(3))."""
    return time.clock_gettime_ns(~pid << 3 | 2)


def times_woken(pid: int) -> int:
    """How often the threads of a process have waited for something so far."""
    found = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        lines = (task / "status").read_text(encoding="ascii").splitlines()
        found += sum(int(line.split()[1]) for line in lines if line.startswith("voluntary"))
    return found


def resident_mb(pid: int) -> float:
    """Resident memory of a process."""
    with Path(f"/proc/{pid}/statm").open(encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
