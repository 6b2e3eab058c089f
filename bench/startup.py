"""From exec to the first tick, and for the naive script to its first frame."""

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial

from bench import under_test
from bench.figures import Figure, Options, alone, compared
from bench.live import await_frame, started
from bench.traffic import NOMINAL_PER_S
from bench.under_test import NAIVE, OTHER, Program
from bench.wire import Wire

_TURNS = 9
_READY_WITHIN_S = 60.0
_BARE, _IMPORTS = "bare Python", "import can, cantools"


def figures(options: Options) -> Iterator[Figure]:
    ways: dict[str, Callable[[], float]] = {
        program.name: partial(_first_tick_ms, program)
        for program in under_test.gateways(options, way="run")
    }
    ways |= {NAIVE.name: _first_frame_ms}
    ways |= {_BARE: partial(_python_ms, "pass"), _IMPORTS: partial(_python_ms, _IMPORTS)}
    for way in ways.values():
        way()  # files and byte code are in memory then
    found: dict[str, list[float]] = {name: [] for name in ways}
    turns = options.turns(_TURNS)
    for turn in range(turns):
        for name, way in ways.items() if turn % 2 == 0 else reversed(ways.items()):
            found[name].append(way())
        took = ", ".join(f"{name} {of[-1]:.0f} ms" for name, of in found.items())
        print(f"   start, turn {turn + 1} of {turns}: {took}", file=sys.stderr)
    ours = found["ours"]
    yield compared("start to first tick", "ms", ours, found[NAIVE.name], NAIVE.name, 2.0, 1.4)
    for name in (OTHER, _BARE, _IMPORTS):
        if name in found:
            yield compared("start to first tick", "ms", ours, found[name], name)
    yield alone("start to first tick", "ms", ours, 1000)


def _first_tick_ms(program: Program) -> float:
    """Until it tells the service manager that it is ready: right after its first tick."""
    name = f"\0bench-{time.monotonic_ns()}"
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager,
        Wire(NOMINAL_PER_S, echo=True) as wire,
    ):
        manager.bind(name)
        manager.settimeout(_READY_WITHIN_S)
        with started(wire, program, notify=name.replace("\0", "@")) as running:
            while b"READY=1" not in manager.recv(4096):
                pass
            ready_ns = time.monotonic_ns()
            await_frame(wire)  # SIGTERM ends it safely only once it runs
    return (ready_ns - running.begun_ns) / 1e6


def _first_frame_ms() -> float:
    with Wire(NOMINAL_PER_S) as wire:
        wall_ns = time.time_ns() - time.monotonic_ns()
        with started(wire, NAIVE) as running:
            return (await_frame(wire) - wall_ns - running.begun_ns) / 1e6


def _python_ms(code: str) -> float:
    start_ns = time.perf_counter_ns()
    with under_test.on_its_processor(), under_test.run_folder() as folder:
        environment = NAIVE.environment(folder)
        subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    return (time.perf_counter_ns() - start_ns) / 1e6
