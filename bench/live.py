"""A whole program on the bus for some seconds, a C program keeping time beside it."""

import json
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, TextIO

from bench.wire import Wire, cpu_ns, resident_mb, take

PERIOD_NS = 50_000_000
_WARM_UP_S = 0.7
_FIRST_COMMAND = 0x0008A7D0
_START_WITHIN_S = 20.0
_SO_TIMESTAMPNS = 35


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
class Live:
    """One run.

    Attributes:
        share_pct: of one core.
        stamps_ns: arrival of the first command of each cycle.
        c_stamps_ns, c_late_ns: the C program's frames, and how late it woke; empty without cc.
        found: what the program printed at its end.
    """

    share_pct: float
    resident_mb: float
    stamps_ns: list[int]
    c_stamps_ns: list[int] = field(default_factory=list)
    c_late_ns: list[int] = field(default_factory=list)
    found: dict[str, Any] = field(default_factory=dict)


@contextmanager
def started(wire: Wire, program: str, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A program of program.py at the other end of the wire; its log is shown if all fails."""
    command = [sys.executable, "-m", "bench.program", program, *wire.arguments, *options]
    with (
        tempfile.TemporaryFile("w+") as said,
        subprocess.Popen(
            command, pass_fds=wire.fds, stdout=subprocess.PIPE, stderr=said, text=True
        ) as child,
    ):
        try:
            yield child
        except Exception as error:
            error.add_note(_said(said))
            raise
        finally:
            if child.poll() is None:
                child.send_signal(signal.SIGTERM)
                child.communicate()


def _said(file: TextIO) -> str:
    file.seek(0)
    return f"the program under test said: {file.read()[-2000:]}"


def run(program: str, per_s: float, seconds: float, *options: str) -> Live:
    """Start, warm up, watch for `seconds`, stop."""
    with (
        Wire(per_s, echo=program == "ours") as wire,
        started(wire, program, *options) as child,
        _yardstick() as c_end,
    ):
        await_frame(wire)
        time.sleep(_WARM_UP_S)
        list(take(c_end))
        from_ns, cpu_before = time.time_ns(), cpu_ns(child.pid)
        time.sleep(seconds)
        to_ns, cpu_after = time.time_ns(), cpu_ns(child.pid)
        by_c = list(take(c_end))
        memory_mb = resident_mb(child.pid)
        child.send_signal(signal.SIGTERM)
        printed, _ = child.communicate(timeout=10)
    return Live(
        100 * (cpu_after - cpu_before) / (to_ns - from_ns),
        memory_mb,
        wire.stamps_ns(_FIRST_COMMAND, from_ns, to_ns),
        [at_ns for at_ns, _ in by_c],
        [int.from_bytes(frame[8:], "little") for _, frame in by_c],
        json.loads(printed) if printed else {},
    )


def await_frame(wire: Wire) -> int:
    """When the program's first frame arrived, wall-clock ns."""
    end = time.monotonic() + _START_WITHIN_S
    while not wire.arrivals:
        if time.monotonic() > end:
            raise TimeoutError("the program under test sent nothing")
        time.sleep(0.005)
    return wire.arrivals[0][0]


@contextmanager
def _yardstick() -> Iterator[socket.socket]:
    """The receiving end of the C program; silent where there is no compiler."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    near.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    program = c_program()
    child = program and subprocess.Popen([program, str(far.fileno())], pass_fds=(far.fileno(),))
    try:
        yield near
    finally:
        if child:
            child.kill()
            child.wait()
        near.close()
        far.close()


@cache
def c_program() -> str | None:
    """cadence.c compiled, or None where there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    _kept.append(tempfile.TemporaryDirectory(prefix="bench-"))
    target = str(Path(_kept[0].name) / "cadence")
    source = str(Path(__file__).with_name("cadence.c"))
    subprocess.run([compiler, "-O2", "-o", target, source], check=True)
    return target


_kept: list[tempfile.TemporaryDirectory[str]] = []
