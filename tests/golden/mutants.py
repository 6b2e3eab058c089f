"""Small mistakes in the core, each replayed: does a golden drive turn out otherwise?

    python -m tests.golden.mutants [MODULE...] [--jobs N] [--one]

A mutant is a fork that imports the gateway anew with one module changed, and replays golden drives
until one differs; then it drives those anew that end. The table has a line for each safety rule:
how many mutants of it, how many of them seen, and the drives that saw most. Status 1 where a rule
has mutants and none was seen. `--one` is for every day: each rule until its first mutant is seen.
"""

import argparse
import hashlib
import os
import re
import resource
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NamedTuple

from tests.golden.broken_cores import BROKEN_CORES, BrokenCore
from tests.mutation.operators import Mutant, mutants
from tests.mutation.run import CORE, TOLD_EVERY, Changed, forget_the_core

MODULES = (
    "rules", "causes", "supervisor", "mode_manager", "operator_requests", "commands", "pedals",
    "plausibility", "link", "demand", "gate", "laws", "law_inputs", "deratings", "caps", "curve",
    "can_pedals", "pedal_frames",
)  # fmt: skip
BESIDE_A_MISTAKE = ("gate", "rules.blocked", "rules.gate_blocked", "commands.Commander.replaced")
"""Rules that act on mistakes of the rest of the core alone."""
ENDED = ("ended-in-order", "ended-without-a-bus", "ended-while-listening")
"""Drives that end when the core says so: a replay does not ask it, so they are driven anew."""
CANNOT = {
    "link.ERROR_CLASSES": "the socket's filter: frames that it keeps away reach no core",
    "causes.Severity": "logging's numbers: everything goes by the names",
    "laws.Laws.__eq__": "what a recording leaves out; replay compares what is left",
    "deratings.Deratings.worst": "shown, and decides nothing",
    "can_pedals.CanPedals": "defaults; a recording has every value",
    "can_pedals.values": "writes settings; a recording has them written already",
    "pedal_frames.PedalState.difference_pct": "shown, and decides nothing",
    "pedal_frames.PedalState.sentence": "shown, and decides nothing",
    "pedal_frames.PedalFrames.__eq__": "what a recording leaves out; replay compares what is left",
    "pedal_frames.PedalFrames.rejected": "counted, and decides nothing",
    "pedal_frames.PedalFrames.now": "shown, and decides nothing",
}
"""What no recording can show, with the reason."""
CPU_AT_MOST_S = 60
DRIVES_SHOWN = 3
BROKEN = "cannot be imported"
ENDLESS = "takes no end"
NOT_IMPORTED = "no drive imports the changed module"


class Rule(NamedTuple):
    """A rule of safety, as far as the source tells one from another: a function or a table."""

    module: str
    name: str

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"

    @property
    def is_of_the_gate(self) -> bool:
        return not {self.module, str(self)}.isdisjoint(BESIDE_A_MISTAKE)


class Job(NamedTuple):
    rule: Rule
    mutant: Mutant


def jobs_of(module: str) -> list[Job]:
    """Every mutant of a module of the core, with its rule."""
    source = (CORE / f"{module}.py").read_text(encoding="utf-8")
    jobs = (Job(_rule(module, one), one) for one in mutants(source))
    return [job for job in jobs if str(job.rule) not in CANNOT]


def _rule(module: str, mutant: Mutant) -> Rule:
    scope, _, changed = mutant.key.partition(": ")
    name = re.match(r"\w+", changed) if scope == "module" else None
    return Rule(module, name[0] if name else scope)


# In the child.


def first_differing(order: list[str], ends: str = "") -> str:
    """The first of these drives that is replayed, or ends, otherwise; empty where none is."""
    from tests.golden.every import DRIVES
    from tests.golden.replayed import replay

    for name in order or list(DRIVES):
        if not _is_equal(replay, DRIVES[name]):
            return name
    pairs = zip(ENDED, ends.split(), digests(ENDED).split(), strict=True) if ends else ()
    return next((name for name, end, found in pairs if found != end), "")


def digests(names: tuple[str, ...]) -> str:
    """Of these drives, driven anew: the vehicle reacts, and the core says when it has ended."""
    from tests.golden.every import DRIVES
    from tests.golden.simulate import core_text

    found = []
    for name in names:
        try:
            text = core_text(DRIVES[name])
        except Exception as error:  # noqa: BLE001 - the mistake of a core, or a mutant's
            text = repr(error)
        found.append(hashlib.sha256(text.encode()).hexdigest())
    return " ".join(found)


def _is_equal(replay: Callable, golden: object) -> bool:
    with suppress(Exception):  # a mutant may raise anything: that is seen
        return replay(golden, to_the_end=False).is_equal
    return False


class Child(NamedTuple):
    """A fork with one module of the core changed; its pipe gives what it found."""

    pid: int
    reading: int

    @classmethod
    def of(cls, work: Callable[[], str], *changed: tuple[str, str]) -> "Child":
        reading, writing = os.pipe()
        if pid := os.fork():
            os.close(writing)
            return cls(pid, reading)
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_AT_MOST_S, CPU_AT_MOST_S))
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        try:
            forget_the_core()
            changes = [Changed(*one) for one in changed]
            sys.meta_path[:0] = changes
            found = work()
            if not all(one.was_executed for one in changes):
                found = NOT_IMPORTED
            os.write(writing, found.encode())
        except BaseException:  # noqa: BLE001 - a mutant may end the program, too
            os.write(writing, BROKEN.encode())
        finally:
            os._exit(0)

    def found(self) -> str:
        """What it found, at its end."""
        with os.fdopen(self.reading) as pipe:
            return pipe.read()


# The run.


class Seen(NamedTuple):
    job: Job
    drive: str
    """The golden drive that turned out otherwise; empty where none did."""


class Run:
    """Mutants, some at a time.

    The drives that saw most of a module's go first; for the gate, the mistakes beside which most of
    the rule's were seen.
    """

    def __init__(self, jobs: list[Job], width: int, one: bool) -> None:
        self._waiting = list(reversed(jobs))
        self._width, self._one = width, one
        self._running: dict[int, tuple[Job, Child]] = {}
        self._by_module: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._by_rule: defaultdict[Rule, Counter[str]] = defaultdict(Counter)
        self._done: set[Rule] = set()
        of_the_gate = any(job.rule.is_of_the_gate for job in jobs)
        self._expected = [
            (core, Child.of(lambda: digests(core.drives), (core.module, core.source())).found())  # noqa: B023
            for core in (BROKEN_CORES if of_the_gate else ())
        ]
        self._names = Child.of(_names).found().split()
        self._ends = Child.of(lambda: digests(ENDED)).found()

    def verdicts(self) -> Iterator[Seen]:
        """Each mutant's, as they come; endless loops count as seen."""
        while self._waiting or self._running:
            while self._waiting and len(self._running) < self._width:
                self._begin(self._waiting.pop())
            with suppress(ChildProcessError):
                pid, status = os.waitpid(-1, os.WNOHANG)
                if pid in self._running:
                    yield self._ended(*self._running.pop(pid), status)
                    continue
            time.sleep(0.003)

    def _begin(self, job: Job) -> None:
        if self._one and job.rule in self._done:
            return
        seen = self._by_module[job.rule.module]
        order = sorted(self._names, key=lambda name: -seen[name])
        changed = (job.rule.module, job.mutant.source)
        if job.rule.is_of_the_gate:
            sight = self._by_rule[job.rule]
            expected = sorted(self._expected, key=lambda one: -sight[one[0].told()])
            child = Child.of(lambda: _first_mistake(expected, changed))
        else:
            child = Child.of(lambda: first_differing(order, self._ends), changed)
        self._running[child.pid] = job, child

    def _ended(self, job: Job, child: Child, status: int) -> Seen:
        drive = ENDLESS if os.WIFSIGNALED(status) else child.found()
        if drive in self._names:
            self._by_module[job.rule.module][drive] += 1
        if drive:
            self._done.add(job.rule)
            self._by_rule[job.rule][drive] += 1
        return Seen(job, drive)


def _first_mistake(expected: list[tuple[BrokenCore, str]], changed: tuple[str, str]) -> str:
    """In the child: the first mistake elsewhere beside which the mutant is seen."""
    for core, right in expected:
        mistake = core.module, core.source()
        found = Child.of(lambda: digests(core.drives), mistake, changed).found()  # noqa: B023
        if found != right:
            return core.told()
    return ""


def _names() -> str:
    from tests.golden.every import DRIVES

    return " ".join(DRIVES)


def table(found: list[Seen]) -> list[str]:
    """A line for each rule."""
    rules: defaultdict[Rule, list[Seen]] = defaultdict(list)
    for one in found:
        rules[one.job.rule].append(one)
    lines = ["| rule | mutants | seen | by |", "| --- | ---: | ---: | --- |"]
    for rule, its in rules.items():
        drives = Counter(one.drive for one in its if one.drive)
        shown = ", ".join(name for name, _ in drives.most_common(DRIVES_SHOWN))
        lines.append(f"| {rule} | {len(its)} | {drives.total()} | {shown} |")
    return lines


def unseen_rules(found: list[Seen]) -> list[Rule]:
    """Rules of which no mutant was seen."""
    seen = {one.job.rule for one in found if one.drive}
    return list(dict.fromkeys(one.job.rule for one in found if one.job.rule not in seen))


def _tell(one: Seen, number: int, of: int) -> None:
    """Where it is: all the time on a terminal, else now and then."""
    rule, by = one.job.rule, one.drive or "not seen"
    if sys.stderr.isatty() or number % TOLD_EVERY == 0:
        end = "" if sys.stderr.isatty() else "\n"
        text = f"{number} of at most {of}: {rule}: {by}"
        print(f"\r\033[K{text}" if not end else text, end=end, file=sys.stderr, flush=True)


def main() -> int:
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("modules", nargs="*", default=MODULES, metavar="MODULE")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--one", action="store_true", help="each rule until its first is seen")
    options = parser.parse_args()
    for module in options.modules:
        source = (CORE / f"{module}.py").read_text(encoding="utf-8")
        if unchanged := Child.of(lambda: first_differing([]), (module, source)).found():
            print(f"{module}: without a mutant: {unchanged}; the figures mean nothing")
            return 2
    begun_s = time.monotonic()
    jobs = [job for module in options.modules for job in jobs_of(module)]
    found = []
    for one in Run(jobs, options.jobs, options.one).verdicts():
        found.append(one)
        _tell(one, len(found), len(jobs))
        if not one.drive and not options.one:
            print(
                f"not seen: {one.job.rule.module}.py:{one.job.mutant.line}: {one.job.mutant.diff}"
            )
    print("\n".join(table(found)))
    for name, reason in CANNOT.items():
        if name.partition(".")[0] in options.modules:
            print(f"left out: {name}: {reason}")
    missing = unseen_rules(found)
    seen = sum(one.drive != "" for one in found)
    print(f"{seen} of {len(found)} mutants seen in {time.monotonic() - begun_s:.0f} s")
    for rule in missing:
        print(f"NO MUTANT SEEN of {rule}")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
