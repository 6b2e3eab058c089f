"""The recorder's share of a core, its memory and what it writes, with a gateway's traffic.

To the frames received comes what every drive has: both commands of each tick, which come back from
the bus, and a demand a tick.
"""

import contextlib
import os
import random
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from socket import AF_UNIX, SOCK_SEQPACKET, socket
from typing import NamedTuple

from bench.figures import Figure, Options, alone, counts_finely
from bench.traffic import NOMINAL_PER_S, SATURATED_PER_S, second_at_rest, wire_parts
from bench.wire import cpu_ns, resident_mb
from vcu_gateway.recording import datagram
from vcu_gateway.recording.datagram import TickHeader
from vcu_gateway.units import NS_PER_S, NS_PER_US

_TICKS_PER_S = 20
_FULL_S = 20.0
_TURNS = 3
_BEGIN_WITHIN_S = 20.0
_S_PER_HOUR = 3600
_TARGETS = {NOMINAL_PER_S: (0.5, 0.25), SATURATED_PER_S: (2.0, 1.5)}
_NOISE = 0x0000_0007_0007_0007  # three bits of three values, as of a sensor at rest
_JITTER_NS = 200_000
_TICK = (
    '{{"f":{frames},"tick":{now_ns},"frames":[["PCU1","0008A7D0","0c000000e02e{life:02x}00"],'
    '["PCU2","0008A8D0","0c000000e02e{life:02x}00"]],"ok":[true,true]}}\n'
)
_OFFER = (
    '{{"f":{frames},"offer":{{"source":"driver","ttl_ms":200,"age_ns":{age_ns},'
    '"both":["PCU1","PCU2"],"demand":{{"throttle_pct":{throttle_pct},"power_mode":"normal"}}}},'
    '"now":{now_ns},"granted":true}}\n'
)
_COMMANDS = (0x0008A7D0, 0x0008A8D0)


class Recorded(NamedTuple):
    """One run: share of a core, memory, and bytes written in an hour."""

    share_pct: float
    resident_mb: float
    mb_per_hour: float


def figures(options: Options) -> Iterator[Figure]:
    seconds = options.seconds(_FULL_S)
    for per_s in (NOMINAL_PER_S, SATURATED_PER_S):
        found = [run(per_s, seconds) for _ in range(options.turns(_TURNS))]
        shares = [one.share_pct for one in found]
        if counts_finely():
            name = f"recorder at {per_s} frames/s"
            yield alone(name, "% of a core", shares, *_TARGETS[per_s])
        yield alone(
            f"recorder's memory at {per_s} frames/s",
            "MB",
            [one.resident_mb for one in found],
            40,
        )
        written = [one.mb_per_hour for one in found]
        target = 16 if per_s == NOMINAL_PER_S else None
        yield alone(f"recorded at {per_s} frames/s", "MB an hour", written, target)


def run(per_s: int, seconds: float) -> Recorded:
    with (
        tempfile.TemporaryDirectory() as folder,
        recorder(Path(folder)) as pid,
        socket(AF_UNIX, SOCK_SEQPACKET) as sock,
    ):
        _connect(sock, tap_path(Path(folder)))
        traffic = _Traffic(sock, per_s)
        traffic.drive(2.0)
        cpu, size, begin_s = cpu_ns(pid), _written(Path(folder)), time.monotonic()
        traffic.drive(seconds)
        took_s = time.monotonic() - begin_s
        share_pct = 100 * (cpu_ns(pid) - cpu) / NS_PER_S / took_s
        written = _written(Path(folder)) - size
        return Recorded(share_pct, resident_mb(pid), written / 1e6 / took_s * _S_PER_HOUR)


def tap_path(folder: Path) -> Path:
    """The socket of the recorder that writes there."""
    return folder / "tap.sock"


@contextlib.contextmanager
def recorder(folder: Path) -> Iterator[int]:
    """A recorder as nice as its unit has it, by its process."""
    command = [
        "nice",
        "-n",
        "10",
        sys.executable,
        "-m",
        "vcu_gateway",
        "recorder",
        "--folder",
        str(folder / "kept"),
    ]
    command += ["--socket", str(tap_path(folder)), "--keep-free-bytes", "0"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield process.pid
        finally:
            process.terminate()


def _connect(sock: socket, path: Path) -> None:
    end_s = time.monotonic() + _BEGIN_WITHIN_S
    while True:
        try:
            sock.connect(os.fspath(path))
        except OSError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.02)
        else:
            return


def _written(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*.gz"))


class _Traffic:
    """Ticks of a gateway that hands on this many frames a second."""

    def __init__(self, sock: socket, per_s: int) -> None:
        self._sock = sock
        self._frames_a_tick = per_s / _TICKS_PER_S
        self._second = second_at_rest(life=False)
        self._random = random.Random(1)
        self._sequence = self._frames = self._handed_on = 0
        self._throttle_pct = 20.0
        self._begin_ns = time.monotonic_ns()
        clock = {"monotonic_ns": self._begin_ns, "wall_ns": time.time_ns()}
        hello = {"format": 1, "run": uuid.uuid4().hex, "channel": "can0", "clock": clock}
        for part in datagram.packed_hello({**hello, "config": "", "dbc": "", "settings": {}}):
            sock.send(part)

    def drive(self, seconds: float) -> None:
        """Hand on the ticks of that time."""
        due_s = time.monotonic()
        for _ in range(round(seconds * _TICKS_PER_S)):
            self._tick()
            due_s += 1 / _TICKS_PER_S
            time.sleep(max(0.0, due_s - time.monotonic()))

    def _tick(self) -> None:
        self._sequence += 1
        until = int(self._sequence * self._frames_a_tick)
        packed = [self._frame(number) for number in range(self._frames, until)]
        packed += self._commands()
        self._frames = until
        self._handed_on += len(packed)
        now_ns, life = time.monotonic_ns(), self._sequence & 0xF
        lines = self._offer(now_ns) + _TICK.format(frames=self._handed_on, now_ns=now_ns, life=life)
        if self._sequence == 1:
            lines = '{"checkpoint":{"ticks":0,"frames":0},"f":0}\n' + lines
        header = TickHeader(self._sequence, self._handed_on, 0, 0)
        self._sock.send(datagram.packed_tick(header, packed, lines))

    def _commands(self) -> list[bytes]:
        """Both commands of the tick before, as the bus gave them back."""
        payload = bytes((0x0C, round(self._throttle_pct / 0.39), 0, 0, 0xE0, 0x2E, 0x60, 0xEA))
        begin_ns = self._begin_ns + round((self._sequence - 1) * NS_PER_S / _TICKS_PER_S)
        return [self._packed(begin_ns, can_id, payload, own_echo=True) for can_id in _COMMANDS]

    def _offer(self, now_ns: int) -> str:
        """A driver's demand, made a moment ago."""
        step_pct = self._random.uniform(-2, 2)
        self._throttle_pct = round(min(90.0, max(0.0, self._throttle_pct + step_pct)), 1)
        age_ns = 500_000 + self._random.randrange(_JITTER_NS)
        return _OFFER.format(
            frames=self._handed_on,
            age_ns=age_ns,
            throttle_pct=self._throttle_pct,
            now_ns=now_ns,
        )

    def _frame(self, number: int) -> bytes:
        """A frame of the mix: noise in its values, and in its stamp what a bus adds."""
        _, frame = self._second[number % len(self._second)]
        can_id, data = wire_parts(frame)
        noisy = int.from_bytes(data, "little") ^ self._random.getrandbits(48) & _NOISE
        at_ns = round(number * NS_PER_S / _TICKS_PER_S / self._frames_a_tick)
        return self._packed(self._begin_ns + at_ns, can_id, noisy.to_bytes(8, "little"))

    def _packed(self, due_ns: int, can_id: int, data: bytes, own_echo: bool = False) -> bytes:
        stamp_ns = due_ns + self._random.randrange(_JITTER_NS)
        stamp_ns -= stamp_ns % NS_PER_US
        return datagram.packed_frame(stamp_ns, can_id | datagram.EXTENDED, own_echo, data)
