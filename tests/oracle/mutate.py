"""Make one mistake at a time in what the program does: the oracle alone must see each.

    python -m tests.oracle.mutate [--jobs N] [NAME...]

tests/oracle/mutations.toml has the mistakes. Each gets a copy of the source, a batch of them one
lab; the part of the oracle that should see it stops at its first failure.
"""

import argparse
import os
import shutil
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path
from queue import Empty, Queue
from typing import NamedTuple

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
COPIES = REPOSITORY / "build" / "oracle-mutants"
LAB = REPOSITORY / "tests" / "lab" / "lab"
BATCH = 8
PATIENCE_S = 240  # of one mistake; a run that hangs has seen it


class Mistake(NamedTuple):
    name: str
    file: str
    old: str
    new: str
    sees: str  # arguments of pytest, below tests/oracle
    survives: str = ""  # why nobody on the bus can see it


def read() -> list[Mistake]:
    with (HERE / "mutations.toml").open("rb") as file:
        return [Mistake(**entry) for entry in tomllib.load(file)["mistake"]]


def copied(mistake: Mistake) -> Path:
    """A source tree of its own with that mistake in it."""
    source = COPIES / mistake.name / "src"
    shutil.rmtree(source.parent, ignore_errors=True)
    shutil.copytree(REPOSITORY / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
    file = source / "vcu_gateway" / mistake.file
    text = file.read_text("utf-8")
    if text.count(mistake.old) != 1:
        raise SystemExit(
            f"{mistake.name}: {mistake.file} has its text {text.count(mistake.old)} times, not once"
        )
    file.write_text(text.replace(mistake.old, mistake.new), "utf-8")
    return source


def arguments(mistake: Mistake) -> list[str]:
    """What pytest is asked: the first word is a file of the oracle, the rest an expression."""
    file, _, expression = mistake.sees.partition(" ")
    return [str(HERE / file), *(["-k", expression] if expression else [])]


def try_inside(mistake: Mistake) -> str:
    """In the lab: `seen`, `SURVIVED`, `UNCLEAR` or `BROKEN`, how long it took and what was seen."""
    began = time.monotonic()
    log = COPIES / mistake.name / "log"
    with log.open("wb") as output:
        try:
            status = subprocess.run(
                [
                    sys.executable, "-m", "pytest", "-x", "-q", "--tb=short",
                    "-p", "no:cacheprovider", "-p", "no:hypothesispytest",
                    "--confcutdir", str(HERE), *arguments(mistake),
                ],
                stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                cwd=REPOSITORY, timeout=PATIENCE_S,
                env={**os.environ, "PYTHONPATH": str(COPIES / mistake.name / "src")},
            ).returncode  # fmt: skip
        except subprocess.TimeoutExpired:
            status = 1
    text = log.read_text(errors="replace")
    first = next((s[4:] for s in text.splitlines() if s.startswith("E   ")), "").strip()
    verdict = {0: "SURVIVED", 1: "seen"}.get(status, "BROKEN")
    if "not well: " in first:
        verdict = "UNCLEAR"  # a machine that is too busy to get ready says nothing
    seconds = time.monotonic() - began
    return f"{verdict:<8} {mistake.name:<40} {seconds:4.0f} s  {first[:110]}"


def inside(names: list[str]) -> int:
    for mistake in [m for m in read() if m.name in names]:
        print(try_inside(mistake), flush=True)
    return 0


def batch_in_a_lab(batch: list[Mistake], told: list[str]) -> None:
    names = [mistake.name for mistake in batch]
    lab = subprocess.Popen(
        [
            str(LAB), "run", "--env", "VCU_REQUIRE_CAN=1",
            "--timeout", str(PATIENCE_S * len(batch)), "--",
            sys.executable, "-m", "tests.oracle.mutate", "--inside", *names,
        ],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=REPOSITORY,
    )  # fmt: skip
    for line in lab.stdout:
        print(line, end="", flush=True)
        told.append(line)
    lab.wait()


def run(mistakes: list[Mistake], jobs: int) -> int:
    waiting: Queue[list[Mistake]] = Queue()
    for mistake in mistakes:
        copied(mistake)
    for begin in range(0, len(mistakes), BATCH):
        waiting.put(mistakes[begin : begin + BATCH])
    told: list[str] = []

    def work() -> None:
        while True:
            try:
                batch_in_a_lab(waiting.get_nowait(), told)
            except Empty:
                return

    workers = [threading.Thread(target=work) for _ in range(jobs)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return tell(mistakes, told)


def tell(mistakes: list[Mistake], told: list[str]) -> int:
    seen = {line.split()[1] for line in told if line.startswith("seen")}
    bad = [m for m in mistakes if m.name not in seen and not m.survives]
    excused = [m for m in mistakes if m.name not in seen and m.survives]
    print(f"{len(seen)} of {len(mistakes)} mistakes were seen")
    for mistake in excused:
        print(f"survives, and why: {mistake.name}: {mistake.survives}")
    for mistake in bad:
        log = (COPIES / mistake.name / "log").relative_to(REPOSITORY)
        print(f"NOT SEEN: {mistake.name} ({mistake.sees}), {log}")
    return 1 if bad else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help="only these mistakes")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--jobs", type=int, default=max(1, len(os.sched_getaffinity(0)) // 2))
    options = parser.parse_args()
    mistakes = read()
    unknown = set(options.names) - {mistake.name for mistake in mistakes}
    if unknown:
        parser.error(f"no such mistake: {', '.join(sorted(unknown))}")
    if options.inside:
        return inside(options.names)
    chosen = [m for m in mistakes if not options.names or m.name in options.names]
    return run(chosen, options.jobs)


if __name__ == "__main__":
    sys.exit(main())
