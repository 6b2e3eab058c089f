"""From exec to the first tick; the naive script's first tick is its first frame."""

import json
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator

from bench.figures import Figure, Options, counts_finely
from bench.live import await_frame, started
from bench.traffic import NOMINAL_PER_S
from bench.wire import Wire

_IMPORTS = {"bare Python": "pass", "import can, cantools": "import can, cantools"}


def figures(options: Options) -> Iterator[Figure]:
    if not counts_finely():
        return  # everything is slow there
    turns = [
        {
            "ours": _first_tick_ms(),
            "naive": _first_frame_ms(),
            **{name: _python_ms(code) for name, code in _IMPORTS.items()},
        }
        for _ in range(options.repeats(5))
    ]
    took = {name: statistics.median(turn[name] for turn in turns) for name in turns[0]}
    yield Figure(
        "start to first tick",
        "ms",
        took["ours"],
        took["naive"],
        "naive",
        target=1000,
        absolute=True,
    )
    for name in _IMPORTS:
        yield Figure("start to first tick", "ms", took["ours"], took[name], name)


def _first_tick_ms() -> float:
    with Wire(NOMINAL_PER_S, echo=True) as wire:
        start_ns = time.time_ns()
        with started(wire, "ours") as child:
            await_frame(wire)  # SIGTERM ends it safely only once it runs
            child.send_signal(signal.SIGTERM)
            printed, _ = child.communicate()
    first_ns: int = json.loads(printed)["first_tick_ns"]
    return (first_ns - start_ns) / 1e6


def _first_frame_ms() -> float:
    with Wire(NOMINAL_PER_S) as wire:
        start_ns = time.time_ns()
        with started(wire, "naive"):
            return (await_frame(wire) - start_ns) / 1e6


def _python_ms(code: str) -> float:
    start_ns = time.perf_counter_ns()
    subprocess.run([sys.executable, "-c", code], check=True)
    return (time.perf_counter_ns() - start_ns) / 1e6
