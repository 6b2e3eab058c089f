"""A whole program on the bus for some seconds, watched from outside."""

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
from typing import Any, TextIO

from tests.processors import started_on

from bench import under_test
from bench.under_test import Program
from bench.wire import Wire, cpu_ns, resident_mb, times_woken

PERIOD_NS = 50_000_000
_WARM_UP_S = 0.7
_FIRST_COMMAND = 0x0008A7D0
_START_WITHIN_S = 20.0


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
        refused: frames for which the bus had no room, of so many `offered`.
    """

    share_pct: float
    woken_per_s: float
    resident_mb: float
    stamps_ns: list[int]
    ticks: list[TimedTick]
    refused: int
    offered: int

    @property
    def cadence(self) -> Cadence:
        return cadence(self.stamps_ns)


@contextmanager
def started(
    wire: Wire, program: Program, *options: str, notify: str | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A program at the other end of the wire; what it said is shown if all fails."""
    command = [*program.command(wire.far_fd), *options]
    environment = under_test.environment(program.tree)
    if notify is not None:
        environment["NOTIFY_SOCKET"] = notify
    with tempfile.TemporaryFile("w+") as said:
        with started_on(under_test.processors()[0]):
            child = subprocess.Popen(
                command,
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
                    yield child
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
        started(wire, program, *options) as child,
    ):
        await_frame(wire)
        time.sleep(_WARM_UP_S)
        before = _Reading(wire, child.pid)
        time.sleep(seconds)
        after = _Reading(wire, child.pid)
        memory_mb = resident_mb(child.pid)
        child.send_signal(signal.SIGTERM)
        printed, _ = child.communicate(timeout=10)
    took_ns = after.monotonic_ns - before.monotonic_ns
    return Live(
        share_pct=100 * (after.cpu_ns - before.cpu_ns) / took_ns,
        woken_per_s=(after.woken - before.woken) / took_ns * 1e9,
        resident_mb=memory_mb,
        stamps_ns=wire.stamps_ns(_FIRST_COMMAND, before.wall_ns, after.wall_ns),
        ticks=_ticks(program, printed, before.monotonic_ns, after.monotonic_ns),
        refused=after.refused - before.refused,
        offered=after.sent - before.sent + after.refused - before.refused,
    )


class _Reading:
    """All counters at one instant."""

    def __init__(self, wire: Wire, pid: int) -> None:
        self.monotonic_ns, self.wall_ns = time.monotonic_ns(), time.time_ns()
        self.cpu_ns, self.woken = cpu_ns(pid), times_woken(pid)
        self.sent, self.refused = wire.sent, wire.refused


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
