"""Run the tests against every mutant: python -m tests.mutation.run [MODULE...] [--list].

The libraries are imported once; each mutant is a fork of this process that imports the
gateway anew, with one module changed. A mutant that no test notices is a failure, unless
survivors.toml says why it makes no difference.
"""

import argparse
import functools
import gc
import importlib.abc
import importlib.util
import io
import os
import resource
import signal
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import hypothesis.stateful
import pytest

from tests.mutation.operators import Mutant, mutants
from vcu_gateway.protocol import dbc, packaged

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "src"
CORE = SOURCES / "vcu_gateway" / "core"
SURVIVORS = Path(__file__).with_name("survivors.toml")
TESTS = {
    "rules": ["rules", "gateway"],
    "plausibility": ["plausibility", "motor_speeds"],
    "causes": ["causes", "coded_signals", "rules", "laws", "pedal_frames"],
    "pedals": ["pedals", "pedal_frames"],
    "supervisor": ["supervisor"],
    "demand": ["demand", "pedal_frames"],
    "pedal_frames": ["pedal_frames"],
    "can_pedals": ["pedal_frames"],
    "link": ["link"],
    "mode_manager": ["lifecycle", "gateway"],
    "operator_requests": ["operator_requests", "gateway", "pedal_frames"],
    "commands": ["commands", "laws"],
    "gate": ["gate", "laws"],
    "schedule": ["schedule", "arrival_time"],
    "stop": ["stop"],
    "laws": ["laws"],
    "law_inputs": ["laws"],
    "deratings": ["laws"],
    "caps": ["caps", "commands"],
    "curve": ["curve", "laws"],
    "state": ["state", "freshness", "laws"],
    "judge.tuning_rules": ["slip", "tuning", "caps_agree"],
}
"""Module of the core -> its test files; what survives them without a reason meets WHOLE.

Of another package with its name, and that package's tests alone.
"""
UNCHANGED = [f"vcu_gateway.core.{name}" for name in ("spec", "j1939", "codec", "codegen")]
"""Modules that no mutant changes and that take long to import."""
WHOLE = ["mutants_more", "transmit", "causes", "between_ticks", "driving"]
CPU_AT_MOST_S = 60
"""Of a mutant: an endless loop is noticed, a machine with other work is not."""
TOLD_EVERY = 25


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds one module, as TESTS names it, with another source."""

    def __init__(self, module: str, source: str) -> None:
        self.path = str(path_of(module))
        self.name = ".".join(Path(self.path).relative_to(SOURCES).with_suffix("").parts)
        self.source = source
        self.was_executed = False

    def find_spec(self, name, path=None, target=None):
        if name != self.name:
            return None
        return importlib.util.spec_from_loader(name, self, origin=self.path)

    def exec_module(self, module):
        module.__file__ = self.path
        self.was_executed = True
        exec(compile(self.source, self.path, "exec"), module.__dict__)


def path_of(module: str) -> Path:
    """Source of a module that TESTS names."""
    package, _, name = module.rpartition(".")
    return SOURCES / "vcu_gateway" / (package or "core") / f"{name}.py"


def _files(module: str) -> list[list[str]]:
    """Its own tests, then those that what survives these meets."""
    package = module.rpartition(".")[0] or "core"
    several = [TESTS[module], WHOLE] if package == "core" else [TESTS[module]]
    folder = ROOT / "tests" / package
    return [[str(folder / f"test_{name}.py") for name in names] for names in several]


def forget_the_core() -> None:
    """Have the gateway imported anew, but for what describes the protocol.

    A module that this process has imported already would not be the changed one.
    """
    for name in [name for name in sys.modules if name.startswith("vcu_gateway.")]:
        if name.startswith("vcu_gateway.protocol") or name in UNCHANGED:
            continue
        package, _, own = name.rpartition(".")
        del sys.modules[name]
        if hasattr(sys.modules.get(package), own):
            delattr(sys.modules[package], own)


def _survives(module: str, source: str, has_reason: bool) -> bool:
    """In the child: True where every test passes; where it has a reason, its own tests."""
    forget_the_core()
    changed = Changed(module, source)
    sys.meta_path.insert(0, changed)
    arguments = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", "--timeout=0"]
    arguments += ["-p", "no:unraisableexception"]  # it collects the garbage of all libraries
    arguments += ["-m", "not slow", "--assert=plain", "--tb=no"]  # nobody reads why one failed
    for files in _files(module)[: 1 if has_reason else None]:
        # The second run imports its modules anew.
        for name in [name for name in sys.modules if name.startswith("tests.c")]:
            del sys.modules[name]
        if pytest.main([*arguments, *files]) != 0:
            return False
    if not changed.was_executed:
        raise ImportError(f"no test imported the changed {module}")
    return True


def _child(module: str, source: str, has_reason: bool = False) -> int:
    """Fork; the pid of the process that exits with 0 where the mutant is noticed."""
    pid = os.fork()
    if pid:
        return pid
    code = 3
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_AT_MOST_S, CPU_AT_MOST_S))
        signal.alarm(10 * CPU_AT_MOST_S)  # one that waits for ever takes no processor
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        sys.stdout = sys.stderr = io.StringIO()
        code = 1 if _survives(module, source, has_reason) else 0
    except BaseException:  # noqa: BLE001 - whatever it raises, the tests did not pass
        code = 0
    finally:
        os._exit(code)


def _verdicts(jobs: list[tuple[str, Mutant]], width: int) -> Iterator[tuple[str, Mutant, bool]]:
    """Each mutant with True where it survived, `width` at a time."""
    waiting, running, reasons = list(reversed(jobs)), {}, _reasons()
    gc.freeze()  # what is imported already is no child's garbage
    while waiting or running:
        while waiting and len(running) < width:
            module, mutant = waiting.pop()
            pid = _child(module, mutant.source, (module, mutant.key) in reasons)
            running[pid] = (module, mutant)
        pid, status = os.waitpid(-1, 0)
        if pid in running:
            yield *running.pop(pid), os.waitstatus_to_exitcode(status) == 1


def _reasons() -> dict[tuple[str, str], str]:
    entries = tomllib.loads(SURVIVORS.read_text(encoding="utf-8")).get("survivor", [])
    return {(one["module"], one["key"]): one["reason"] for one in entries}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", default=list(TESTS), metavar="MODULE")
    parser.add_argument("--list", action="store_true", help="show the mutants, run nothing")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    os.chdir(ROOT)
    hypothesis.settings.register_profile(
        "mutants", max_examples=20, derandomize=True, database=None, deadline=None,
        phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate),
    )  # fmt: skip
    os.environ["HYPOTHESIS_PROFILE"] = "mutants"
    dbc.load = functools.cache(dbc.load)  # the protocol is no target: read it once
    dbc.load(packaged("vcu.dbc"))
    jobs = [
        (module, mutant)
        for module in options.modules
        for mutant in mutants(path_of(module).read_text(encoding="utf-8"))
    ]
    if options.list:
        for module, mutant in jobs:
            print(f"{path_of(module).name}:{mutant.line}: {mutant.key}")
        return 0
    if not _all_pass(options.modules):
        return 2
    code = _report(jobs, options)
    return code if _all_pass(options.modules) else 2


def _all_pass(modules: list[str]) -> bool:
    """Without a mutant; before the run, and after it lest somebody edited meanwhile."""
    for module in modules:
        pid = _child(module, path_of(module).read_text(encoding="utf-8"))
        if os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) != 1:
            print(f"{module}: its tests fail or import another one; the figures mean nothing")
            return False
    return True


def _report(jobs: list[tuple[str, Mutant]], options: argparse.Namespace) -> int:
    begun, reasons = time.monotonic(), _reasons()
    survived, unexplained = set(), 0
    for number, (module, mutant, survives) in enumerate(_verdicts(jobs, options.jobs), 1):
        if number % TOLD_EVERY == 0:
            print(f"{number} of {len(jobs)}: {module}", file=sys.stderr, flush=True)
        if not survives:
            continue
        survived.add((module, mutant.key))
        if (module, mutant.key) not in reasons:
            unexplained += 1
            where = path_of(module).relative_to(ROOT)
            print(f"SURVIVED {where}:{mutant.line}\n{mutant.diff}")
            print(f"key = {mutant.key!r}\n", flush=True)
    for module, key in reasons:
        if module in options.modules and (module, key) not in survived:
            print(f"no longer survives, remove it from survivors.toml: {module}: {key}")
    print(
        f"{len(jobs)} mutants in {time.monotonic() - begun:.0f} s: "
        f"{len(jobs) - len(survived)} killed, {len(survived) - unexplained} with a reason, "
        f"{unexplained} survived"
    )
    return 1 if unexplained else 0


if __name__ == "__main__":
    sys.exit(main())
