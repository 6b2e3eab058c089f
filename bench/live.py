"""A whole program on the bus for some seconds, watched from outside."""

import contextlib
import json
import signal
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, NamedTuple, TextIO

from bench import under_test
from bench.api_loop import Connection
from bench.under_test import Program
from bench.wire import Wire, cpu_ns, has_vcan, resident_mb, times_woken

PERIOD_NS = 50_000_000
_WARM_UP_S = 0.5
_SETTLE_S = 0.2
_FIRST_COMMAND = 0x0008A7D0
_START_WITHIN_S = 60.0


@dataclass(frozen=True)
class Cadence:
    """What the wire saw of a 50 ms cycle.

    Attributes:
        mean_off_ms: how far the mean period is from 50 ms.
        drift_ms: how far the cycle moved against 50 ms from the first second to the last.
        errors_us: of each distance between two frames, against 50 ms.
        missed: cycles without a frame.
    """

    mean_off_ms: float
    drift_ms: float
    errors_us: list[float]
    missed: int


def cadence(stamps_ns: list[int]) -> Cadence:
    """Judge a cycle from the stamps of its frames, at least two."""
    gaps = [after - before for before, after in pairwise(stamps_ns)]
    turns = [max(1, round(gap / PERIOD_NS)) for gap in gaps]
    errors = [gap - turn * PERIOD_NS for gap, turn in zip(gaps, turns, strict=True)]
    phases = list(accumulate(errors, initial=0))
    few = max(1, min(20, len(phases) // 3))
    return Cadence(
        abs(statistics.fmean(errors)) / 1e6,
        (statistics.median(phases[-few:]) - statistics.median(phases[:few])) / 1e6,
        [abs(error) / 1e3 for error in errors],
        sum(turns) - len(turns),
    )


@dataclass(frozen=True)
class TimedTick:
    """A tick that a program timed itself.

    Attributes:
        cpu_ns: processor time from the snapshot until the last frame was sent.
    """

    deadline_ns: int
    lateness_ns: int
    cpu_ns: int = 0
    mode: str = ""


@dataclass(frozen=True)
class Live:
    """One run, from the end of the warm-up.

    Attributes:
        share_pct: of one core.
        woken_per_s: how often its threads began to wait.
        stamps_ns: arrival of the first command of each cycle.
        ticks: empty where the program does not time them.
        lost: frames of `offered` that found the receive buffer full; None where that is unknown.
    """

    share_pct: float
    woken_per_s: float
    resident_mb: float
    stamps_ns: list[int]
    ticks: list[TimedTick]
    lost: int | None
    offered: int

    @property
    def cadence(self) -> Cadence:
        return cadence(self.stamps_ns)


class Running(NamedTuple):
    """A program under test.

    Attributes:
        folder: its configuration, socket and state.
        begun_ns: monotonic time shortly before it was started.
    """

    process: subprocess.Popen[str]
    folder: Path
    begun_ns: int


@contextmanager
def started(
    wire: Wire, program: Program, *options: str, notify: str | None = None
) -> Iterator[Running]:
    """A program at the other end of the wire; what it said is shown if all fails."""
    with tempfile.TemporaryFile("w+") as said, under_test.run_folder(program.config) as folder:
        environment = program.environment(folder)
        if notify is not None:
            environment["NOTIFY_SOCKET"] = notify
        with under_test.on_its_processor():
            begun_ns = time.monotonic_ns()
            child = subprocess.Popen(
                [*program.command(wire.far_fd, folder), *options],
                cwd=under_test.HERE,
                env=environment,
                pass_fds=() if wire.far_fd is None else (wire.far_fd,),
                stdout=subprocess.PIPE,
                stderr=said,
                text=True,
            )
        try:
            with child:
                try:
                    yield Running(child, folder, begun_ns)
                finally:
                    if child.poll() is None:
                        child.send_signal(signal.SIGTERM)
                        child.communicate()
        except Exception as error:
            error.add_note(_said(program, said))
            raise


def _said(program: Program, file: TextIO) -> str:
    file.seek(0)
    return f"{program.name} said: {file.read()[-2000:]}"


def run(program: Program, per_s: float, seconds: float, *options: str) -> Live:
    """Start, warm up, watch for `seconds`, stop."""
    with (
        Wire(per_s, echo=program.tree is not None) as wire,
        started(wire, program, *options) as running,
    ):
        await_frame(wire)
        time.sleep(_WARM_UP_S)
        dropped_before = _dropped(program, running)
        time.sleep(_SETTLE_S)
        before = _Reading(wire, running)
        time.sleep(seconds)
        after = _Reading(wire, running)
        dropped = _dropped(program, running) - dropped_before
        memory_mb = resident_mb(running.process.pid)
        running.process.send_signal(signal.SIGTERM)
        printed, _ = running.process.communicate(timeout=10)
    took_ns = after.monotonic_ns - before.monotonic_ns
    refused = after.refused - before.refused
    return Live(
        share_pct=100 * (after.cpu_ns - before.cpu_ns) / took_ns,
        woken_per_s=(after.woken - before.woken) / took_ns * 1e9,
        resident_mb=memory_mb,
        stamps_ns=wire.stamps_ns(_FIRST_COMMAND, before.wall_ns, after.wall_ns),
        ticks=_ticks(program, printed, before.monotonic_ns, after.monotonic_ns),
        lost=refused + dropped if program.tree or not has_vcan() else None,
        offered=after.sent - before.sent + refused,
    )


class _Reading:
    """All counters at one instant."""

    def __init__(self, wire: Wire, running: Running) -> None:
        pid = running.process.pid
        self.monotonic_ns, self.wall_ns = time.monotonic_ns(), time.time_ns()
        self.cpu_ns, self.woken = cpu_ns(pid), times_woken(pid)
        self.sent, self.refused = wire.sent, wire.refused


def _dropped(program: Program, running: Running) -> int:
    """Frames that a gateway's receive buffer had no room for, as its API tells; else 0."""
    if program.tree is None:
        return 0
    with contextlib.closing(Connection(running.folder / "control.sock")) as connection:
        return int(connection.request("health")["result"]["frames"]["dropped"])


def _ticks(program: Program, printed: str, from_ns: int, to_ns: int) -> list[TimedTick]:
    if not printed:
        return []
    found: dict[str, Any] = json.loads(printed)
    if program.tree is not None and not found["source"].startswith(str(program.tree)):
        raise RuntimeError(f"{program.name} ran {found['source']}, not {program.tree}")
    return [TimedTick(*tick) for tick in found["ticks"] if from_ns <= tick[0] < to_ns]


def await_frame(wire: Wire) -> int:
    """When the program's first frame arrived, wall-clock ns."""
    end = time.monotonic() + _START_WITHIN_S
    while not wire.arrivals:
        if time.monotonic() > end:
            raise TimeoutError("the program under test sent nothing")
        time.sleep(0.005)
    return wire.arrivals[0][0]
