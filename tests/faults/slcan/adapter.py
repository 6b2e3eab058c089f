"""A CAN adapter on a serial line, on a pseudo-terminal, wired to vcan0.

The kernel's slcan makes it a real interface with a transmit queue, a bit rate and a controller's
state. What the interface sends appears on vcan0, which stands for the wire, and the other way.
The adapter can stop reading, report states, and be pulled out.
"""

import contextlib
import fcntl
import os
import pty
import select
import socket
import struct
import subprocess
import threading
import time
import tty
from typing import Any

TIOCSETD, SIOCGIFNAME = 0x5423, 0x8910
N_SLCAN = 17
EFF, ID_MASK = 0x8000_0000, 0x1FFF_FFFF
_frame = struct.Struct("=IB3x8s")


class Adapter:
    """Plugged in from the beginning; the interface is down until `up`.

    Attributes:
        reading: False while it is stuck: nothing passes in either direction.
        name: of the interface.
    """

    def __init__(self, wire: str = "vcan0") -> None:
        self.reading = True
        self._wire = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self._wire.bind((wire,))
        self._ended = False
        self._turn = threading.Lock()
        self._unfinished = b""
        self._master = self._slave = -1
        os.register_at_fork(after_in_child=self._close_line)
        self.plug()
        self._thread = threading.Thread(target=self._work, name="adapter", daemon=True)
        self._thread.start()

    def plug(self) -> None:
        """Plug it in; OSError where the kernel has no slcan."""
        with self._turn:
            self._master, self._slave = pty.openpty()
            tty.setraw(self._master)
            tty.setraw(self._slave)
            fcntl.ioctl(self._slave, TIOCSETD, struct.pack("i", N_SLCAN))
            name: bytes = fcntl.ioctl(self._slave, SIOCGIFNAME, bytes(16))
            self.name = name.rstrip(b"\0").decode()
            self._unfinished = b""

    def unplug(self) -> int:
        """Pull it out; shortly before, wall clock, ns: what follows may be quicker than we are."""
        with self._turn:
            begun_ns = time.time_ns()
            self._close_line()
            return begun_ns

    def _close_line(self) -> None:
        """Also in every process forked from this one: the line hangs up with its last holder."""
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1

    def stick(self) -> int:
        """Stop reading; when, wall clock, ns."""
        with self._turn:
            self.reading = False
            return time.time_ns()

    def up(self, queue_frames: int = 4) -> int:
        """Set the interface up, as the system would; when it was, wall clock, ns."""
        of_can = ("type", "can", "bitrate", "250000")
        _ip("link", "set", self.name, "txqueuelen", str(queue_frames), *of_can)
        for _ in range(3):  # the kernel waits a second for the line, which a busy machine may miss
            if _ip("link", "set", self.name, "up", check=False) == 0:
                break
        else:
            _ip("link", "set", self.name, "up")
        return time.time_ns()

    def report(self, state: str) -> int:
        """The controller's state: a (active), w, p or b (bus-off), and its counters.

        Returns when, shortly before: what follows may be quicker than we are.
        """
        begun_ns = time.time_ns()
        os.write(self._master, f"s{state}\r".encode())
        return begun_ns

    def close(self) -> None:
        self._ended = True
        self._thread.join()
        if self._master >= 0:
            self.unplug()
        self._wire.close()

    def _work(self) -> None:
        while not self._ended:
            with self._turn:
                master = self._master
            if master < 0 or not self.reading:
                self._forget_the_wire()
                time.sleep(0.005)
                continue
            with contextlib.suppress(OSError):
                sources: list[Any] = [master, self._wire]
                ready, _, _ = select.select(sources, [], [], 0.02)
                with self._turn:
                    if self.reading and master == self._master:
                        self._pass_on(master, ready)

    def _pass_on(self, master: int, ready: list[object]) -> None:
        if master in ready:
            self._to_wire(os.read(master, 4096))
        if self._wire in ready:
            self._from_wire()

    def _forget_the_wire(self) -> None:
        """Whoever is stuck or pulled out hears nothing."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._wire.recv(16, socket.MSG_DONTWAIT)

    def _to_wire(self, received: bytes) -> None:
        *lines, self._unfinished = (self._unfinished + received).split(b"\r")
        for line in lines:
            if line[:1] == b"T":
                data = bytes.fromhex(line[10:].decode())
                self._wire.send(_frame.pack(int(line[1:9], 16) | EFF, len(data), data))

    def _from_wire(self) -> None:
        can_id, length, data = _frame.unpack(self._wire.recv(16))
        if can_id & EFF:
            line = f"T{can_id & ID_MASK:08X}{length}{data[:length].hex().upper()}\r"
            os.write(self._master, line.encode())


def _ip(*arguments: str, check: bool = True) -> int:
    sudo = [] if os.geteuid() == 0 else ["sudo"]
    return subprocess.run([*sudo, "ip", *arguments], check=check).returncode
