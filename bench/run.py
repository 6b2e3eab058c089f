"""Run the benchmarks, print the table, write docs/benchmarks.md."""

import argparse
import importlib
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

from bench.figures import HEADER, Figure, Options, counts_finely
from bench.live import c_program
from bench.wire import bus_name

_NAMES = (
    "decode",
    "encode",
    "receive",
    "whole",
    "tick",
    "lateness",
    "priority",
    "gather",
    "startup",
)
_LONG = ("gather", "priority")
_PAGE = Path(__file__).parent.parent / "docs" / "benchmarks.md"
_QUICK_SHARE = 0.15
_PACKAGES = ("python-can", "cantools", "structlog")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"about 20 s instead of 3 min; coarse, without {' and '.join(_LONG)}, writes no page",
    )
    parser.add_argument("--only", choices=_NAMES, action="append", metavar="NAME", help=str(_NAMES))
    parser.add_argument("--check", action="store_true", help="exit 1 where a target is missed")
    asked = parser.parse_args()
    names = asked.only or [name for name in _NAMES if not (asked.quick and name in _LONG)]
    start_s, load = time.monotonic(), os.getloadavg()[0]
    found = list(_run(names, Options(_QUICK_SHARE if asked.quick else 1.0)))
    table = _table(found)
    print(f"\nbus: {bus_name()}\n\n{table}\n")
    if not counts_finely():
        print("left out: processor time at low load, counted in whole ticks here, and start-up")
    if not asked.quick and not asked.only:
        _PAGE.write_text(_page(table, time.monotonic() - start_s, load), encoding="utf-8")
        print(f"written to docs/{_PAGE.name}")
    missed = [figure.name for figure in found if figure.verdict == "MISSED"]
    if missed:
        print("missed: " + "; ".join(missed))
    return 1 if missed and asked.check else 0


def _run(names: list[str], options: Options) -> Iterator[Figure]:
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


def _page(table: str, took_s: float, load: float) -> str:
    packages = " · ".join(f"{name} {version(name)}" for name in _PACKAGES)
    yardstick = "compiled with cc" if c_program() else "left out: no C compiler here"
    return f"""# Benchmarks

Written by `make bench` (`python -m bench`) on {time.strftime("%Y-%m-%d")} in {took_s:.0f} s; run \
it again rather than edit it. Lower is better everywhere. Absolute figures belong to the machine; \
the ratios hold, because both sides ran in turns (A B A B …) in the same run and the medians are \
shown. The ratio is ours / peer; target and stretch are limits for the ratio, or for our own \
figure where there is nothing to divide by.

- machine: {_processor()}, {os.cpu_count()} cores, load average {load:.1f} before the run
- system: {platform.system()} {platform.release()}, {platform.python_implementation()} \
{platform.python_version()}, vcu-gateway {version("vcu-gateway")} · {packages}
- bus: {bus_name()}
- traffic: that of docs/protocol.md, 358 frames/s; 7600 frames/s is a saturated bus of 1 Mbit/s
- C program beside ours, sleeping to absolute deadlines: {yardstick}

{table}

- **naive** is what one would write first: python-can's Notifier on its own SocketcanBus, \
`decode_message` into a dictionary, and a `time.sleep(0.05)` loop that encodes and sends both \
commands (`bench/program.py`).
- **bus to store** is the processor time of the whole process, waking up included, without ticks.
- **whole program** has kernel filters, store, gate, both commands and our own frames coming back.
- **tick** is measured in the running program, with the caches as cold as 50 ms of sleep leave them.
- **under fifo on a busy machine** is with one busy process for each processor, with the policy \
that systemd/vcu-gateway.service gives and without.
- **drift** is how far the 50 ms grid moved between the first and the last second of a run; the \
kernel's stamps at the receiving end are compared.
"""


def _processor() -> str:
    with Path("/proc/cpuinfo").open(encoding="utf-8") as file:
        names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    return names[0] if names else platform.machine()
