"""Nominal traffic with random faults for as long as is asked, on vcan0; `make soak`.

    tests/lab/lab run --timeout 720 -- .venv/bin/python -m tests.faults.soak --minutes 10

The recorded bus is held against the invariants of docs/safety.md all the while. At the end: memory
does not grow, no descriptor is left over, every tick is accounted for, every frame sent is on the
bus. Status 1, with the seed, where anything of this is not so.
"""

import argparse
import contextlib
import json
import os
import random
import signal
import statistics
import sys
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from tests.faults import judged_bus
from tests.faults.breakable_vehicle import Breaking, Step
from tests.faults.driving import THROTTLE_PCT, BusStand, record, set_up
from tests.faults.flood import EFF, ERR, RTR, send
from tests.faults.line_client import LineClient
from tests.faults.machine import descriptors, resident_kb
from tests.vcan.conftest import COMMANDS, Recorded, ended_after
from vcu_gateway.client import ClientError

MS = 1_000_000
PERIOD_S = 0.05
GROWTH_MAX_KB = 1024
WATCHED = (*COMMANDS, *judged_bus.STATUS2)
FOREIGN_DATA = bytes((0x04, 231, 0, 0, 0xE0, 0x2E, 0x60, 0xEA))  # 90 %, which nobody asks here
RECEIVED = (0x1808D0F4, 0x1809D0F4, 0x0808D0A7, 0x0809D0A7, 0x0809D0A8, 0x040AD092, 0x040AD079)
TELL_EVERY_S = 30.0
RECOVERY_S = 60.0
SHARE_DRIVEN = 20  # one in so many frames has torque
PATIENCE_S = 30.0
# What a frame shows has been told by then; the log is written by a thread of its own.
TOLD_NS = 2000 * MS


class Tail:
    """The lines that a file has got since the last look."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read_to = 0

    def lines(self) -> list[str]:
        with self._path.open("rb") as file:
            file.seek(self._read_to)
            whole = file.read().rpartition(b"\n")[0]
        self._read_to += len(whole) + 1 if whole else 0
        return whole.decode(errors="replace").splitlines()


class Watcher:
    """Reads the recording and the log as they grow, and checks them bit by bit.

    Attributes:
        frames: the gateway's own command frames so far; with_torque: those with throttle.
        last_ns: the stamp of the last of them.
    """

    def __init__(self, recording: Path, log: Path) -> None:
        self._recording, self._log = Tail(recording), Tail(log)
        self._modes: deque[dict[str, Any]] = deque(maxlen=200)
        self._context: list[Recorded] = []
        self._waiting: list[Recorded] = []
        self.frames = self.with_torque = self.last_ns = 0
        self.stopped: dict[str, Any] | None = None

    def look(self, last: bool = False) -> None:
        """Check what is new; AssertionError where an invariant does not hold.

        The youngest frames wait for the next look, but for the last.
        """
        seen = [*self._waiting, *map(_frame, self._recording.lines())]
        told_ns = seen[-1].stamp_ns - (0 if last else TOLD_NS) if seen else 0
        new = [frame for frame in seen if frame.stamp_ns <= told_ns]
        self._waiting = [frame for frame in seen if frame.stamp_ns > told_ns]
        for line in self._log.lines():
            if line.startswith("{"):
                self._note(json.loads(line))
        before = sum(map(_is_own, self._context))
        checked = judged_bus.check([*self._context, *new], log=self._modes, foreign=_is_foreign)
        self.frames += checked.frames - before
        self.with_torque += sum(_is_own(frame) and frame.data[1] > 0 for frame in new)
        self._context = [*self._context, *new][-12:]
        self.last_ns = max([self.last_ns, *(f.stamp_ns for f in new if _is_own(f))])

    def _note(self, entry: dict[str, Any]) -> None:
        if entry["event"] == "mode_changed":
            self._modes.append(entry)
        elif entry["event"] == "stopped":
            self.stopped = entry
        assert entry["event"] not in ("crashed", "api_failed"), entry


def _frame(line: str) -> Recorded:
    stamp, can_id, data = line.split(",")
    flagged = int(can_id, 16)
    return Recorded(int(stamp), flagged >> 29, flagged & 0x1FFF_FFFF, bytes.fromhex(data))


def _is_foreign(frame: Recorded) -> bool:
    return frame.data == FOREIGN_DATA or len(frame.data) != 8


def _is_own(frame: Recorded) -> bool:
    return frame.can_id in COMMANDS and frame.flags == 4 and not _is_foreign(frame)


# What goes wrong.


@dataclass
class Trouble:
    """Random faults of one drive."""

    one: Breaking
    chance: random.Random
    done: Counter[str] = field(default_factory=Counter)
    latest: deque[str] = field(default_factory=lambda: deque(maxlen=8))

    def one_of_many(self) -> None:
        """Something goes wrong for a while, and is mended."""
        name, fault = self.chance.choice(list(FAULTS.items()))
        self.done[name] += 1
        self.latest.append(name)
        fault(self)

    def wait(self, least_s: float = 0.2, most_s: float = 2.5) -> None:
        time.sleep(self.chance.uniform(least_s, most_s))

    @property
    def pid(self) -> int:
        pid = self.one.gateway.popen.pid
        assert pid is not None
        return pid

    def node(self) -> str:
        return self.chance.choice(["BMS", "IMU", "ARD2", "PCU1", "PCU2", "PCU1_Status1"])

    def broken_vehicle(self) -> None:
        self.one.break_with(self.chance.choice(STEPS)(self))
        self.wait()
        self.one.break_with()

    def random_frames(self) -> None:
        chance = self.chance
        for _ in range(chance.randrange(1, 200)):
            flags = chance.choice((0, EFF, EFF, EFF, RTR | EFF))
            can_id = chance.getrandbits(29) if flags & EFF else chance.getrandbits(11)
            if can_id & 0x03FF_FF00 in {one & 0x03FF_FF00 for one in COMMANDS}:
                continue
            send((flags | can_id, chance.randbytes(0 if flags & RTR else chance.randrange(9))))
        self.wait(0.1, 0.5)

    def mutated_frames(self) -> None:
        for _ in range(self.chance.randrange(1, 20)):
            send((EFF | self.chance.choice(RECEIVED), self.chance.randbytes(8)))
        self.wait(0.1, 1.0)

    def error_frames(self) -> None:
        bits = self.chance.choice((0x04, 0x08, 0x10, 0x20))
        send((ERR | 0x004, bytes((0, bits, 0, 0, 0, 0, 0, 0))))
        self.wait(0.1, 1.5)
        send((ERR | 0x004, bytes((0, 0x40, 0, 0, 0, 0, 0, 0))))

    def bus_off(self) -> None:
        for _ in range(self.chance.randrange(1, 10)):
            send((ERR | 0x040, bytes(8)))
            time.sleep(0.02)
            send((ERR | 0x100, bytes(8)))
        self.wait(0.1, 0.5)

    def another_sender(self) -> None:
        for _ in range(self.chance.randrange(1, 5)):
            send((EFF | self.chance.choice(COMMANDS), FOREIGN_DATA))
        self.wait(0.1, 1.0)

    def link_down(self) -> None:
        set_up("vcan0", up=False)
        self.wait(0.0, 1.0)
        set_up("vcan0")

    def stopped(self) -> None:
        os.kill(self.pid, signal.SIGSTOP)
        self.wait(0.05, 2.0)
        os.kill(self.pid, signal.SIGCONT)

    def reload(self) -> None:
        text = self.chance.choice(
            (
                "limits: {power_limit_max_w: 40000}\n",
                "",
                "limits: [",
                "limits: {regen_limit_pct: 5}\n",
            )
        )
        self.one.stand.configure(text)
        os.kill(self.pid, signal.SIGHUP)
        self.wait(0.1, 0.5)

    def silent_driver(self) -> None:
        with contextlib.suppress(ClientError):
            self.one.owner.release()
        self.one._owner = None
        self.wait(0.1, 1.0)

    def emergency_stop(self) -> None:
        self.one.client.estop()
        self.wait(0.1, 0.5)

    def changing_driver(self) -> None:
        for _ in range(self.chance.randrange(1, 15)):
            with contextlib.suppress(ClientError):  # a machine that stalls makes it too old
                self.one.owner.set(
                    throttle_pct=self.chance.choice((0.0, 5.0, 30.0, 100.0)),
                    brake_pct=self.chance.choice((0.0, 0.0, 50.0)),
                    regen_brake=self.chance.random() < 0.5,
                    motor_reverse=self.chance.random() < 0.2,
                    power_mode=self.chance.choice(("eco", "normal", "turbo")),
                )
            self.wait(0.02, 0.3)

    def rude_clients(self) -> None:
        for _ in range(self.chance.randrange(1, 30)):
            with contextlib.suppress(OSError), LineClient(self.one.stand.socket_path) as client:
                client.socket.sendall(self.chance.randbytes(self.chance.randrange(1, 3000)))


def _set(trouble: Trouble) -> Step:
    signal_name, raws = trouble.chance.choice(
        (
            ("BMS_Status.CellOvervoltage", (1, 2)),  # 3 stays until a restart
            ("BMS_Status.CellUndervoltage", (1, 2, 3)),
            ("BMS_Status.DischargeOvercurrent", (1, 2, 3)),
            ("BMS_Status.Overtemperature", (1, 2, 3)),
            ("BMS_Status.Undertemperature", (1, 2, 3)),
            ("BMS_Status.InternalFault", (1,)),
            ("BMS_Status.SOC", (0, 101, 255)),
            ("PCU1_Status1.TemperatureProtectLevel", (1, 2, 3)),
            ("PCU2_Status1.VoltageLevel", (0, 1, 5, 6, 7)),
            ("PCU2_Status2.MotorSpeed", (0, 6001, 65535)),
        )
    )
    return {"fault": "set", "signal": signal_name, "raw": trouble.chance.choice(raws)}


STEPS: tuple[Callable[[Trouble], Step], ...] = (
    _set,
    _set,
    lambda t: {"fault": "silence", "of": t.node()},
    lambda t: {"fault": "drop", "share_pct": t.chance.choice((10, 30, 60))},
    lambda t: {"fault": "delay", "of": t.node(), "delay_ms": t.chance.choice((20, 120, 700))},
    lambda t: {"fault": "duplicate"},
    lambda t: {"fault": "corrupt", "of": t.node(), "flip_bits": t.chance.choice((1, 8))},
    lambda t: {"fault": "shorten", "of": t.node(), "length_bytes": t.chance.randrange(8)},
    lambda t: {"fault": "freeze", "signal": "BMS_Status.LifeSignal"},
    lambda t: {"fault": "wrong_direction", "controller": "PCU2"},
    lambda t: {"fault": "ignore_commands", "controller": "PCU1", "throttle_pct": 90.0},
)

FAULTS: dict[str, Callable[[Trouble], None]] = {
    "vehicle": Trouble.broken_vehicle,
    "vehicle again": Trouble.broken_vehicle,
    "random frames": Trouble.random_frames,
    "mutated frames": Trouble.mutated_frames,
    "error frames": Trouble.error_frames,
    "bus-off": Trouble.bus_off,
    "another sender": Trouble.another_sender,
    "link down": Trouble.link_down,
    "stopped": Trouble.stopped,
    "reload": Trouble.reload,
    "silent driver": Trouble.silent_driver,
    "emergency stop": Trouble.emergency_stop,
    "changing driver": Trouble.changing_driver,
    "rude clients": Trouble.rude_clients,
}


# The run.


class Sample(NamedTuple):
    at_s: float
    memory_kb: int


class Soaked(NamedTuple):
    """What came of it.

    Attributes:
        growth_kb: of the last quarter's median over the second one's.
        unaccounted: ticks that are neither done nor skipped.
        missing: frames that the gateway has sent and nobody recorded.
    """

    seconds: float
    faults: int
    frames: int
    with_torque: int
    ticks: int
    skipped: int
    unaccounted: int
    missing: int
    growth_kb: int
    slope_kb_per_h: float
    descriptors_left: int

    @property
    def long(self) -> bool:
        """Long enough to say anything of memory."""
        return self.seconds > 300

    @property
    def wrong(self) -> list[str]:
        """What is not as it must be."""
        checks = {
            f"memory grew by {self.growth_kb} kB": not self.long or self.growth_kb <= GROWTH_MAX_KB,
            f"{self.descriptors_left} descriptors left over": self.descriptors_left <= 0,
            f"{self.unaccounted} ticks unaccounted for": abs(self.unaccounted) <= 2,
            f"{self.missing} frames sent and not recorded": self.missing == 0,
            "it never drove": self.with_torque * SHARE_DRIVEN > self.frames,
        }
        return [what for what, good in checks.items() if not good]

    def __str__(self) -> str:
        return (
            f"{self.seconds:.0f} s, {self.faults} faults, {self.frames} command frames"
            f" ({self.with_torque / max(self.frames, 1):.0%} with torque) without a violation;"
            f" {self.ticks} ticks and {self.skipped} skipped, {self.unaccounted} unaccounted for;"
            f" {self.missing} sent frames not recorded; {self._memory}"
            f"{self.descriptors_left} descriptors left over"
        )

    @property
    def _memory(self) -> str:
        if not self.long:
            return ""
        return f"memory {self.growth_kb:+} kB, {self.slope_kb_per_h:+.0f} kB/h; "


class Soak:
    """One gateway, one vehicle, one driver, and what goes wrong with them."""

    def __init__(self, one: Breaking, seed: int, tell: Callable[[str], None]) -> None:
        self.one = one
        self.trouble = Trouble(one, random.Random(seed))
        self.watcher = Watcher(one.recording.path, one.gateway.err)
        self._tell = tell
        self._samples: list[Sample] = []
        self._told_s = 0.0

    def run(self, duration_s: float) -> Soaked:
        """Until the time is over; AssertionError where an invariant does not hold."""
        self.drive()
        calm = len(descriptors(self.trouble.pid))
        begun_s = time.monotonic()
        while (now_s := time.monotonic() - begun_s) < duration_s or self._has_stood(
            now_s, duration_s
        ):
            self.look(now_s)
            self.trouble.one_of_many()
            self.drive()
        return self._ended(now_s, self._left_over(calm))

    def _has_stood(self, now_s: float, duration_s: float) -> bool:
        """Hardly driven so far, on a machine that stalls: some time more."""
        hardly = self.watcher.with_torque * SHARE_DRIVEN <= self.watcher.frames
        return hardly and now_s < 3 * duration_s

    def _left_over(self, calm: int) -> int:
        """Descriptors more than in the beginning; a connection that has ended takes a moment."""
        end_s = time.monotonic() + PATIENCE_S
        while (left := len(descriptors(self.trouble.pid)) - calm) > 0 and time.monotonic() < end_s:
            time.sleep(0.1)
        return left

    def look(self, now_s: float) -> None:
        self.watcher.look()
        self._samples.append(Sample(now_s, resident_kb(self.trouble.pid)))
        if now_s - self._told_s >= TELL_EVERY_S:
            self._told_s = now_s
            ticks = self.one.client.health()["ticks"]
            self._tell(
                f"{now_s:5.0f} s: {self.trouble.done.total()} faults, {self.watcher.frames}"
                f" command frames good, {ticks['skipped']} ticks skipped,"
                f" {self._samples[-1].memory_kb} kB, {self.one.mode()}"
            )

    def drive(self) -> None:
        """From wherever it is to throttle, by release, reset and arm."""
        with contextlib.suppress(ClientError):
            self._ask(0)  # brake over throttle ends with a released pedal only
        time.sleep(0.1)
        end_s = time.monotonic() + RECOVERY_S
        while time.monotonic() < end_s:
            with contextlib.suppress(ClientError):
                if self._drives():
                    return
            time.sleep(0.1)
        raise AssertionError(f"it does not drive again: {self.one.client.why()['sentence']}")

    def _drives(self) -> bool:
        one = self.one
        if one.mode() != "active":
            self._ask(0)
            one._armed()
            return False
        commands = self._ask(THROTTLE_PCT)
        return all(command["throttle_pct"] > THROTTLE_PCT - 1 for command in commands.values())

    def _ask(self, throttle_pct: float) -> dict[str, Any]:
        """On in the direction that is applied: turning waits until the vehicle has rolled out."""
        commands: Any = self.one.client.state(())["commands"]
        reverse = commands["PCU1"]["motor_reverse"]
        self.one.owner.set(throttle_pct=throttle_pct, power_mode="normal", motor_reverse=reverse)
        return commands

    def _last_word(self) -> dict[str, Any]:
        """The gateway's, when all that it sent is in the recording, or will never be."""
        end_s = time.monotonic() + PATIENCE_S
        while True:
            self.watcher.look(last=True)
            stopped = self.watcher.stopped
            is_whole = stopped is not None and self.watcher.frames >= stopped["sent_frames"]
            if is_whole or time.monotonic() > end_s:
                assert stopped is not None
                return stopped
            time.sleep(0.1)

    def _ended(self, seconds: float, left: int) -> Soaked:
        self.one.let_go()
        assert self.one.gateway.stop() == 0
        stopped = self._last_word()
        points = _points(stopped, self.watcher.last_ns)
        growth_kb, slope = _growth(self._samples)
        return Soaked(
            seconds=seconds,
            faults=self.trouble.done.total(),
            frames=self.watcher.frames,
            with_torque=self.watcher.with_torque,
            ticks=stopped["ticks"],
            skipped=stopped["skipped"],
            unaccounted=points - stopped["ticks"] - stopped["skipped"],
            missing=stopped["sent_frames"] - self.watcher.frames,
            growth_kb=growth_kb,
            slope_kb_per_h=slope,
            descriptors_left=left,
        )


def _points(stopped: dict[str, Any], last_ns: int) -> int:
    """Points of the grid up to the last frame: closing the bus takes time, and ticks no more."""
    ended_ns = datetime.fromisoformat(stopped["timestamp"]).timestamp() * 1e9
    return round((stopped["elapsed_s"] - (ended_ns - last_ns) / 1e9) / PERIOD_S) + 1


def _growth(samples: list[Sample]) -> tuple[int, float]:
    """Of the last quarter over the second, and the slope, after the first quarter."""
    settled = samples[len(samples) // 4 :]
    if len(settled) < 4:
        return 0, 0.0
    part = len(settled) // 3
    first = statistics.median(one.memory_kb for one in settled[:part])
    last = statistics.median(one.memory_kb for one in settled[-part:])
    at_h = [one.at_s / 3600 for one in settled]
    slope = statistics.linear_regression(at_h, [one.memory_kb for one in settled]).slope
    return round(last - first), slope


@contextlib.contextmanager
def soaking(folder: Path, seed: int, tell: Callable[[str], None]) -> Iterator[Soak]:
    """A fresh gateway, as a person starts it, with all of the nominal traffic."""
    with ended_after(BusStand(folder)) as stand:
        one = Breaking(stand, record(stand, "", WATCHED))
        one.quiet = []
        one.start_vehicle()
        one.until_serving()
        try:
            yield Soak(one, seed, tell)
        finally:
            with contextlib.suppress(ClientError, OSError):
                one.let_go()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().getrandbits(32))
    given = parser.parse_args()
    print(f"seed {given.seed}", flush=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        soaking(Path(folder), given.seed, lambda line: print(line, flush=True)) as soak,
    ):
        try:
            soaked = soak.run(given.minutes * 60)
        except AssertionError as error:
            print(f"{error}\nafter {soak.trouble.latest}", file=sys.stderr)
            return 1
    print(f"{soaked}\n{dict(sorted(soak.trouble.done.items()))}")
    for what in soaked.wrong:
        print(f"wrong: {what}", file=sys.stderr)
    return 1 if soaked.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
