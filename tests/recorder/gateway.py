"""A gateway's end of the tap, and the recorder as a process: real sockets, real files."""

import contextlib
import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import time
import uuid
from pathlib import Path

from vcu_gateway.recording import chain, datagram, layout
from vcu_gateway.recording.chain import Break, FaultKind
from vcu_gateway.recording.datagram import TickHeader
from vcu_gateway.recording.members import Member, MemberDamage, read_members

TICK_S = 0.05
IDS = [0x18FF0000 | index << 8 for index in range(18)]


class Gateway:
    """Hands on ticks as the gateway does: in order, counted, never waiting.

    Attributes:
        frames: handed on so far, lost ones counted.
    """

    def __init__(self, path, channel="vcan0", run=None, seed=1):
        self.path = str(path)
        self.run = run or uuid.uuid4().hex
        self.channel = channel
        self.sequence = self.frames = self.datagrams_lost = self.frames_lost = self.ticks = 0
        self.clock = {"monotonic_ns": time.monotonic_ns(), "wall_ns": time.time_ns()}
        self.sock = None
        self._random = random.Random(seed)
        self._counters = [0] * len(IDS)
        self._checkpoint_due = True
        self._segment_frames = 0

    def connect(self, timeout_s=60.0):
        end_s = time.monotonic() + timeout_s
        while True:
            sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            try:
                sock.connect(self.path)
                break
            except OSError:
                sock.close()
                if time.monotonic() > end_s:
                    raise
                time.sleep(0.02)
        for part in datagram.packed_hello(self.hello()):
            sock.send(part)
        self.sock, self._checkpoint_due = sock, True

    def hello(self):
        return {
            "format": 1,
            "run": self.run,
            "boot": "b" * 32,
            "versions": {"gateway": "0.1.0"},
            "clock": self.clock,
            "channel": self.channel,
            "config": "bus: {channel: vcan0}\n",
            "dbc": 'VERSION ""\n',
            "settings": {},
        }

    def begin_segment(self):
        self._checkpoint_due = True

    def tick(self, frames=18, more="", events=(), mode=None):
        """One tick with its frames; False where the recorder did not take it."""
        return self.hand_on([self._frame() for _ in range(frames)], more, events, mode)

    def hand_on(self, packed, more="", events=(), mode=None):
        """One tick with these frames."""
        frames = len(packed)
        lines = ""
        if self._checkpoint_due:
            self._segment_frames = 0
            lines = self._checkpoint()
        self._segment_frames += frames
        lines += more + self._tick_line(events, mode)
        self.sequence += 1
        self.frames += frames
        self.ticks += 1
        numbers = TickHeader(self.sequence, self.frames, self.datagrams_lost, self.frames_lost)
        data = datagram.packed_tick(numbers, packed, lines)
        if self._sent(data):
            self._checkpoint_due = False
            return True
        self.datagrams_lost += 1
        self.frames_lost += frames
        self._checkpoint_due = True
        return False

    def _sent(self, data):
        if self.sock is None:
            return False
        try:
            self.sock.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except OSError:
            self.close()
            return False
        if datagram.may_be_urgent(data):
            self._end_recorders_wait()
        return True

    def _end_recorders_wait(self):
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as sock,
        ):
            sock.setblocking(False)
            sock.connect(self.path)

    def _frame(self):
        which = self._random.randrange(len(IDS))
        self._counters[which] += 1
        data = struct.pack(
            "<HHHBB",
            4000 + self._random.randrange(16),
            3000 + self._random.randrange(4),
            0,
            self._counters[which] & 15,
            0xFF,
        )
        stamp = time.monotonic_ns()
        return datagram.packed_frame(stamp, IDS[which] | datagram.EXTENDED, False, data)

    def _checkpoint(self):
        state = {f"part{index}": [index, index * 7, "x" * 20] for index in range(200)}
        values = {"state": state, "ticks": self.ticks, "frames": self.frames, "mode": "standby"}
        return json.dumps({"checkpoint": values, "f": 0}, separators=(",", ":")) + "\n"

    def _tick_line(self, events, mode):
        line = {
            "f": self._segment_frames,
            "tick": time.monotonic_ns(),
            "frames": [
                ["PCU1", "0008A7D0", "0c000000e02e0000"],
                ["PCU2", "0008A7D1", "0c000000e02e0000"],
            ],
            "ok": [True, True],
        }
        if mode:
            line["mode"] = mode
        if events:
            line["events"] = list(events)
        return json.dumps(line, separators=(",", ":")) + "\n"

    def latch(self, cause="undervoltage"):
        """A tick in which a fault latches."""
        began = ["cause_began", "warning", {"cause": cause, "effect": "cut"}]
        latched = ["fault_latched", "critical", {"reason": f"battery {cause}: cut"}]
        return self.tick(events=(began, latched), mode="fault")

    def drive(self, seconds, frames=18, period_s=TICK_S, reconnect=True):
        """Ticks on a grid; connects again where the recorder closed. How late the latest was, s."""
        due_s = time.monotonic()
        late_s = 0.0
        for _ in range(round(seconds / period_s)):
            if self.sock is None and reconnect:
                with contextlib.suppress(OSError):
                    self.connect(timeout_s=0)
            self.tick(frames)
            due_s += period_s
            time.sleep(max(0.0, due_s - time.monotonic()))
            late_s = max(late_s, time.monotonic() - due_s)
        return late_s

    def close(self):
        if self.sock is not None:
            self.sock.close()
            self.sock = None


class RecorderProcess:
    """`vcu-gateway recorder` as a process of its own."""

    def __init__(self, folder, *options, environment=None, before=(), pass_fds=()):
        self.folder = (Path(folder) / "recordings").resolve()
        self.socket = Path(folder) / "tap.sock"
        self.status_path = Path(folder) / "status.json"
        self._errors = (Path(folder) / "stderr.txt").open("ab")
        command = [*before, sys.executable, "-m", "vcu_gateway", "recorder"]
        command += ["--folder", self.folder, "--socket", self.socket]
        command += ["--status", self.status_path, "--keep-free-bytes", "0", *options]
        self.process = subprocess.Popen(
            list(map(str, command)),
            stderr=self._errors,
            pass_fds=pass_fds,
            env={**os.environ, **(environment or {})},
        )

    @property
    def errors(self):
        return Path(self._errors.name).read_text()

    @property
    def status(self):
        return json.loads(self.status_path.read_text())

    @property
    def waited_s(self):
        """How long its two threads were ready and another program had their processor, at least.

        One waits for the other no longer than that one runs: so long may be the recorder's own.
        """
        threads = Path(f"/proc/{self.process.pid}/task").iterdir()
        counts = [(one / "schedstat").read_text().split() for one in threads]
        return sum(int(waited) - int(ran) for ran, waited, _ in counts) / 1e9

    def wait_for(self, condition, timeout_s=10.0):
        """The status, once it fulfils the condition."""
        end_s = time.monotonic() + timeout_s
        status = None
        while time.monotonic() < end_s:
            with contextlib.suppress(OSError, ValueError):
                status = self.status
                if condition(status):
                    return status
            time.sleep(0.05)
        raise AssertionError(f"never: {status}\n{self.errors}")

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(10)

    def stop(self):
        """End it in order; its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(10)

    def close(self):
        if self.process.poll() is None:
            self.kill()
        self._errors.close()


def drives(folder):
    return layout.recorded_folders(Path(folder) / "recordings" / layout.DRIVES)


def incidents(folder):
    return layout.recorded_folders(Path(folder) / "recordings" / layout.INCIDENTS)


def members(path):
    return [part for part in read_members(path) if isinstance(part, Member)]


def damage(path):
    return [part for part in read_members(path) if isinstance(part, MemberDamage)]


def core_lines(segment):
    lines = b"".join(one.data for one in members(segment.core)).splitlines()
    return [json.loads(line) for line in lines]


def recorded_frames(segment):
    return sum(one.lines for one in members(segment.frames))


def breaks(folder):
    return [part for part in chain.walk(layout.segments(folder)) if isinstance(part, Break)]


def account(folder):
    """Frames of a drive: recorded, told as gaps; each segment goes on where the last one ended.

    All members are one chain, whatever ended the recorder meanwhile: a torn end is outside of it.
    """
    assert not [one for one in breaks(folder) if one.kind is not FaultKind.TORN]
    recorded = lost = expected = 0
    for segment in layout.segments(folder):
        lines = core_lines(segment)
        assert "checkpoint" in lines[0], segment
        gap = lines[2].get("gap", {}) if len(lines) > 2 else {}
        assert lines[1]["begin"]["frames"] == expected + gap.get("frames", 0), (segment, gap)
        here = recorded_frames(segment)
        lost += gap.get("frames", 0)
        recorded += here
        expected = lines[1]["begin"]["frames"] + here
    return recorded, lost
