"""From exec to the first tick, and for the naive script to its first frame."""

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

from bench import under_test
from bench.figures import Figure, Options, alone, compared, counts_finely
from bench.live import await_frame, started
from bench.traffic import NOMINAL_PER_S
from bench.under_test import NAIVE, OTHER, Program
from bench.wire import Wire, cpu_ns

_TURNS = 9
_READY_WITHIN_S = 60.0
_BARE, _IMPORTS = "bare Python", "import can, cantools"


class Start(NamedTuple):
    """One start: how long it took, and how much processor time of that, nan where not measured."""

    took_ms: float
    cpu_ms: float


def figures(options: Options) -> Iterator[Figure]:
    ways: dict[str, Callable[[], Start]] = {
        program.name: partial(_first_tick, program)
        for program in under_test.gateways(options, way="run")
    }
    ways |= {NAIVE.name: _first_frame}
    ways |= {_BARE: partial(_python, "pass"), _IMPORTS: partial(_python, _IMPORTS)}
    for way in ways.values():
        way()  # files and byte code are in memory then
    found: dict[str, list[Start]] = {name: [] for name in ways}
    turns = options.turns(_TURNS)
    for turn in range(turns):
        for name, way in ways.items() if turn % 2 == 0 else reversed(ways.items()):
            found[name].append(way())
        took = ", ".join(f"{name} {of[-1].took_ms:.0f} ms" for name, of in found.items())
        print(f"   start, turn {turn + 1} of {turns}: {took}", file=sys.stderr)
    took_ms = {name: [start.took_ms for start in of] for name, of in found.items()}
    name, ours_ms = "start to first tick", took_ms["ours"]
    yield compared(name, "ms", ours_ms, took_ms[NAIVE.name], NAIVE.name, 2.0, 1.4)
    for peer in (OTHER, _BARE, _IMPORTS):
        if peer in found:
            yield compared(name, "ms", ours_ms, took_ms[peer], peer)
    yield alone(name, "ms", ours_ms, 1000)
    if counts_finely():
        yield from _cpu_figures(found)


def _cpu_figures(found: dict[str, list[Start]]) -> Iterator[Figure]:
    """What a busy machine lengthens less than the whole time."""
    for peer in (NAIVE.name, OTHER):
        if peer in found:
            ours_ms, peer_ms = ([start.cpu_ms for start in found[who]] for who in ("ours", peer))
            yield compared("start to first tick, processor time", "ms", ours_ms, peer_ms, peer)


def _first_tick(program: Program) -> Start:
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
            ready_ns, spent_ns = time.monotonic_ns(), cpu_ns(running.process.pid)
            await_frame(wire)  # SIGTERM ends it safely only once it runs
    return Start((ready_ns - running.begun_ns) / 1e6, spent_ns / 1e6)


def _first_frame() -> Start:
    with Wire(NOMINAL_PER_S) as wire:
        wall_ns = time.time_ns() - time.monotonic_ns()
        with started(wire, NAIVE) as running:
            took_ns = await_frame(wire) - wall_ns - running.begun_ns
            return Start(took_ns / 1e6, cpu_ns(running.process.pid) / 1e6)


def _python(code: str) -> Start:
    start_ns = time.perf_counter_ns()
    with under_test.on_its_processor(), under_test.run_folder() as folder:
        environment = NAIVE.environment(folder)
        subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    return Start((time.perf_counter_ns() - start_ns) / 1e6, float("nan"))
