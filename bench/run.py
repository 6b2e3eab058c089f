"""Run the benchmarks, print the table, write docs/benchmarks.md."""

import argparse
import importlib
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

from bench import under_test
from bench.figures import HEADER, Figure, Options, counts_finely
from bench.live import run
from bench.traffic import NOMINAL_PER_S, SATURATED_PER_S
from bench.under_test import NAIVE
from bench.wire import bus_name

_NAMES = (
    "decode",
    "encode",
    "receive",
    "whole",
    "saturated",
    "tick",
    "lateness",
    "priority",
    "startup",
    "recorder",
    "recorded",
    "replay",
)
_LONG = ("priority",)
_PAGE = Path(__file__).parent.parent / "docs" / "benchmarks.md"
_QUICK_SHARE = 0.15
_PACKAGES = ("vcu-gateway", "python-can", "cantools", "structlog")


def main() -> int:
    asked = _arguments()
    # Ending in order: no program under test stays behind.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    names = asked.only or [name for name in _NAMES if not (asked.quick and name in _LONG)]
    options = Options(_QUICK_SHARE if asked.quick else 1.0, asked.against)
    processors = under_test.processors()
    os.sched_setaffinity(0, processors[1])
    start_s, load = time.monotonic(), os.getloadavg()[0]
    about = _about(options, load)
    print(about, file=sys.stderr, flush=True)
    found = list(_run(names, options))
    table = _table(found)
    print(f"\n{about}\n\n{table}\n")
    if not (asked.quick or asked.only or asked.no_page):
        _PAGE.write_text(_page(about, table, time.monotonic() - start_s), encoding="utf-8")
        print(f"written to docs/{_PAGE.name}")
    missed = [figure.name for figure in found if figure.verdict == "MISSED"]
    if missed:
        print("missed: " + "; ".join(missed))
    return 1 if missed and asked.check else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"about 3 minutes instead of 8; coarse, without {' and '.join(_LONG)}, writes no page",
    )
    parser.add_argument("--only", choices=_NAMES, action="append", metavar="NAME", help=str(_NAMES))
    parser.add_argument(
        "--against", type=_tree, metavar="TREE", help="another source tree, run in turns with this"
    )
    parser.add_argument("--no-page", action="store_true", help="only print the table")
    parser.add_argument("--check", action="store_true", help="exit 1 where a target is missed")
    return parser.parse_args()


def _tree(text: str) -> Path:
    tree = Path(text).resolve()
    if not (tree / "src" / "vcu_gateway").is_dir():
        raise argparse.ArgumentTypeError(f"{text} has no src/vcu_gateway")
    return tree


def _run(names: list[str], options: Options) -> Iterator[Figure]:
    print("writing byte code ...", file=sys.stderr, flush=True)
    for program in [*under_test.gateways(options), NAIVE]:
        run(program, NOMINAL_PER_S, 0.0)
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        figures: Callable[[Options], Iterator[Figure]]
        figures = importlib.import_module(f"bench.{name}").figures
        for figure in figures(options):
            print("   " + "  ".join(filter(None, figure.cells())), file=sys.stderr, flush=True)
            yield figure


def _table(found: list[Figure]) -> str:
    rows = [HEADER, *(figure.cells() for figure in found)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEADER))]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        for row in rows
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def _about(options: Options, load: float) -> str:
    """Machine, versions, bus and what ran, as a list."""
    python = f"{platform.python_implementation()} {platform.python_version()}"
    packages = " · ".join(f"{name} {version(name)}" for name in _PACKAGES)
    lines = [
        f"machine: {_processor()}, {os.cpu_count()} cores, load average {load:.1f} before the run",
        f"system: {platform.system()} {platform.release()}, {python}, {packages}",
        f"bus: {bus_name()}",
        f"traffic: {NOMINAL_PER_S} frames/s (docs/protocol.md); {SATURATED_PER_S} is a full bus",
        f"ours: {_commit(under_test.HERE)}",
    ]
    if options.against is not None:
        lines.append(f"{under_test.OTHER}: {_commit(options.against)}")
    if not under_test.floors():
        lines.append("C programs: left out, no C compiler here")
    if not counts_finely():
        lines.append("processor time: left out, counted in whole ticks here")
    program, others = under_test.processors()
    if program.isdisjoint(others):
        lines.append("the program under test had a processor of its own")
    return "\n".join(f"- {line}" for line in lines)


def _commit(tree: Path) -> str:
    """The commit that this tree has checked out, and whether it was changed since."""
    command = ["git", "-C", str(tree), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, check=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown commit"


def _page(about: str, table: str, took_s: float) -> str:
    return f"""# Benchmarks

Written by `make bench` (`python -m bench`) on {time.strftime("%Y-%m-%d")} in {took_s:.0f} s; run \
it again rather than edit it. Lower is better everywhere.

{about}

{table}

Absolute figures belong to the machine. Ratios are of one run, in which all programs ran in turns \
(A B C, C B A, …); beside a program that is woken for every frame they also depend on what a \
wake-up costs: **whole program** at 358 frames/s has been half of **naive** on one machine and as \
much on another. **ours** and **peer** are medians of the turns, **ratio** is \
the median of ours / peer within each turn, and **spread** the quartiles of the turns, of ours \
where there is no peer. p99 and max, and their ratios, are of all turns together. Target and \
stretch are limits for the ratio, or for our own figure where there is nothing to divide by.

- **naive** is what one would write first: python-can's Notifier on its own SocketcanBus, \
`decode_message` into a dictionary, and a `time.sleep(0.05)` loop that encodes and sends both \
commands (`bench/naive.py`).
- **C** is the least that keeps a table of frames and sends two commands every 50 ms on absolute \
deadlines (`bench/floor.c`), with one wake-up for each frame, or with one a tick that reads all \
that waits (two on a saturated bus).
- **bus to store** is the processor time of the whole process, waking up included, without ticks.
- **whole program** has kernel filters, store, gate, both commands and our own frames coming back. \
The clock readings of **tick** are in it.
- **tick** is measured in the running program, with the caches as cold as 50 ms of sleep leave \
them: processor time from the snapshot until both frames are with the kernel.
- **frames lost** came while the program's receive buffer was full, in the worst turn.
- **under fifo on a busy machine** is with one busy process for each processor, with the policy \
that systemd/vcu-gateway.service gives and without.
- **while recorded** is with `vcu-gateway-recorder` beside the gateway, on other processors; the \
peer is the same gateway that hands nothing on.
- **drift** is how far the 50 ms grid moved between the first and the last second of a run, in the \
worst turn; the kernel's stamps at the receiving end are compared.
- **replay** is the processor time of one core for an hour of nominal driving, reading included; \
18 s are 200 times real time.
- **start to first tick** has all byte code there, from starting the interpreter until the \
gateway tells the service manager that it is ready, and until the naive script's first frame.
"""


def _processor() -> str:
    with Path("/proc/cpuinfo").open(encoding="utf-8") as file:
        names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    return names[0] if names else platform.machine()
