"""Clean systems in which the commands of README and docs are run as a newcomer types them.

Each system is a minimal root (mmdebstrap) with an ordinary user who may use sudo, and nothing
installed but what the README says. What was typed and seen is in build/systems/SYSTEM.log. Where a
system cannot be had, an installed Python of its version runs the tests instead, and it is said.
"""

import argparse
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from tests import stalls
from tests.packaging.built import RELEASES
from tests.systems import promises, systems
from tests.systems.systems import FOLDER, SYSTEMS, CannotError, System
from tests.systems.terminal import FailedError, Terminal

INSTALL_S = 900
DEMO_S = 900
TEST_S = 5400
PACKAGE_S = 900
COMMAND_S = 120
LOOK_S = 3  # as long as somebody looks at the live view
END_DEMO = "kill %1; wait %1; unset VCU_GATEWAY_SOCKET"
CLONE = f"git clone {systems.BUNDLE} vcu-gateway && cd vcu-gateway"
# pytest's closing lines, and what failed.
TOLD = re.compile(
    r"^ ?\d*:?\d*\s*(test-\S+ .* in \d[\d.]*s\b.*|(?:test-\S+ +|lint +)?FAILED .*|ERROR .*)$",
    re.MULTILINE,
)
PYTHON = re.compile(r"^python +(\d+\.\d+)[\d.]*", re.MULTILINE | re.IGNORECASE)
EX_UNAVAILABLE = 69


class Outcome(NamedTuple):
    """What came of one system, and the version of Python that ran the tests to their end."""

    status: int
    line: str
    python: str | None = None


class Visit:
    """A newcomer's visit to one system: to the demo, and to this command for the tests."""

    def __init__(self, system: System, test: str) -> None:
        self.system = system
        self.test = test
        self.folder = FOLDER / system.suite
        self.log = FOLDER / f"{system.suite}.log"
        self.done: list[str] = []

    def say(self, text: str) -> None:
        print(f"{self.system.suite:<9} {text}", flush=True)

    def outcome(self) -> Outcome:
        """Run the README's commands there; where it cannot be had, the tests alone here."""
        systems.remove(self.folder)
        try:
            command = systems.clean_root(self.system, self.folder)
            return self.watched(command, self.folder / "home/user", self.newcomer)
        except CannotError as error:
            self.say(f"{error}; an installed Python {self.system.python} runs the tests instead")
            return self.instead(str(error))
        finally:
            systems.remove(self.folder)

    def instead(self, why: str) -> Outcome:
        python = systems.installed_python(self.system.python)
        if python is None:
            return Outcome(EX_UNAVAILABLE, f"{why}, nor is python{self.system.python} installed")
        systems.remove(self.folder)
        self.folder.mkdir()
        systems.lay_home(self.folder)
        clean = f"env -i HOME={self.folder} PATH={os.environ['PATH']} TERM=screen bash --login"
        self.done.append(f"no {self.system.name}, but {python} of this machine")

        def steps(terminal: Terminal) -> None:
            self.clone(terminal)
            self.tests(terminal, f"{self.test} PYTHON={python}")

        return self.watched(f"cd {self.folder} && {clean}", self.folder, steps)

    def watched(self, command: str, home: Path, steps: Callable[[Terminal], None]) -> Outcome:
        """Take these steps in a terminal, and keep what was typed and seen."""
        terminal = Terminal(self.system.suite, command, home)
        try:
            steps(terminal)
        except FailedError as error:
            return Outcome(1, f"FAILED: {error}; see {self.log}")
        finally:
            text = terminal.text()
            self.log.write_text(text)
            terminal.close()
            for line in TOLD.findall(text):
                self.say(line)
        found = PYTHON.search(text)
        return Outcome(0, "; ".join(self.done), found[1] if found else None)

    def newcomer(self, terminal: Terminal) -> None:
        """From nothing: what the README says, the demo until it drives, and the package."""
        words = promises.commands()
        self.run(terminal, words.install, INSTALL_S, answer="y")
        self.clone(terminal)
        begun_s = time.monotonic()
        terminal.begin(words.demo)
        terminal.show(r"^ ACTIVE ", DEMO_S)
        self.took(f"{words.demo}: ACTIVE", begun_s)
        time.sleep(LOOK_S)
        terminal.press("q")
        terminal.end(words.demo, 30)
        for line in promises.program():
            terminal.run(line, COMMAND_S)
        self.examples(terminal)
        if self.system.suite in RELEASES:
            self.package(terminal)
        self.tests(terminal, self.test)

    def examples(self, terminal: Terminal) -> None:
        """The programs of docs/examples; again where the machine stood still: it ends a drive."""
        watch = stalls.Watch()
        try:
            for left in (2, 1, 0):
                begun_s = time.monotonic()
                try:
                    self.each_example(terminal)
                except FailedError as error:
                    stall_s = watch.longest_s(begun_s)
                    if not (left and stall_s):
                        raise
                    stood = f"stood still for {stall_s * 1000:.0f} ms"
                    self.say(f"{stalls.TAKEN_AGAIN}: {stood}: {error}")
                    terminal.run(END_DEMO, COMMAND_S)
                else:
                    break
        finally:
            watch.end()
        self.done.append("examples")

    def each_example(self, terminal: Terminal) -> None:
        """Beside a demo that has no terminal of its own."""
        demo, programs = promises.examples()
        terminal.run(f"{demo} </dev/null >~/demo.txt 2>&1 &", COMMAND_S)
        named = "grep -o 'export VCU_GATEWAY_SOCKET=.*' ~/demo.txt"
        terminal.run(f"until {named}; do sleep 1; done", COMMAND_S)
        terminal.run(f"$({named})", COMMAND_S)
        for line in programs:
            if "--output" in line:  # it writes until Ctrl-C
                terminal.begin(line)
                time.sleep(LOOK_S)
                terminal.press("C-c")
                terminal.end(line, COMMAND_S)
            else:
                terminal.run(line, COMMAND_S)
        terminal.run(END_DEMO, COMMAND_S)

    def package(self, terminal: Terminal) -> None:
        """Build it, install it, and do with it what docs/recordings.md says without a vehicle."""
        for line in promises.package():
            self.run(terminal, line, PACKAGE_S, answer="y")
        terminal.run("cd", COMMAND_S)
        for line in promises.recordings():
            # That commands would have differed is an answer too.
            terminal.run(line, COMMAND_S, ends=("0", "1") if " --set " in line else ("0",))
        self.done.append("recordings.md")
        terminal.run("sudo apt purge --yes vcu-gateway", PACKAGE_S)  # the tests look for none
        terminal.run("cd vcu-gateway", COMMAND_S)

    def tools(self, terminal: Terminal, tools: str) -> None:
        try:
            self.run(terminal, tools, INSTALL_S)
        except FailedError as error:
            if not self.system.lacks:
                raise
            self.done.append(f"{error}, as it has no {self.system.lacks}")

    def clone(self, terminal: Terminal) -> None:
        self.run(terminal, CLONE, 60)

    def tests(self, terminal: Terminal, test: str) -> None:
        if self.test != promises.commands().test_smoke:
            self.tools(terminal, promises.commands().tools)
        self.run(terminal, test, TEST_S)
        terminal.run(".venv/bin/vcu-gateway version", 60)

    def run(self, terminal: Terminal, line: str, wait_s: float, answer: str = "") -> None:
        begun_s = time.monotonic()
        terminal.run(line, wait_s, answer)
        self.took(line, begun_s)

    def took(self, what: str, begun_s: float) -> None:
        self.done.append(f"{what} {time.monotonic() - begun_s:.0f} s")
        self.say(self.done[-1])


def visit(system: System, test: str) -> Outcome:
    one = Visit(system, test)
    outcome = one.outcome()
    one.say(outcome.line if outcome.status else "ok")
    return outcome


def main() -> int:
    options = parse()
    if os.geteuid() != 0:
        print("error: only root can make a system's root; use sudo", file=sys.stderr)
        return EX_UNAVAILABLE
    FOLDER.mkdir(parents=True, exist_ok=True)
    chosen = options.systems or [asked(suite) for suite in SYSTEMS]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with ThreadPoolExecutor(options.at_once) as pool:
        each = pool.map if options.at_once > 1 else map  # without threads Ctrl-C ends at once
        outcomes = list(each(visit, *zip(*chosen, strict=True)))
    print("\nfrom nothing, in a clean")
    for (system, test), outcome in zip(chosen, outcomes, strict=True):
        python = f"Python {outcome.python or system.python}"
        print(f"  {system.name:<15} {python}: {test}: {outcome.line}")
    worst = max(outcome.status for outcome in outcomes)
    if worst:
        failed = zip(chosen, outcomes, strict=True)
        told = [
            f"{system.name}: {outcome.line}" for (system, _), outcome in failed if outcome.status
        ]
        print(f"error: {'; '.join(told)}")
        return worst
    unproven = promises.unproven(outcome.python for outcome in outcomes)
    if unproven and len(chosen) == len(SYSTEMS):
        print(f"error: {unproven}")
        return 1
    return 0


def asked(text: str) -> tuple[System, str]:
    """A system and the command for its tests: "trixie:smoke"; of "trixie" that of `make test`."""
    suite, _, what = text.partition(":")
    words = promises.commands()
    tests = {
        "": words.test,
        "whole": words.test,
        "quick": words.test_quick,
        "smoke": words.test_smoke,
    }
    if suite not in SYSTEMS or what not in tests:
        raise argparse.ArgumentTypeError(f"there is {', '.join(SYSTEMS)}, with {', '.join(tests)}")
    return SYSTEMS[suite], tests[what]


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser("python -m tests.systems", description=__doc__)
    known = ", ".join(f"{one.suite} ({one.name}, Python {one.python})" for one in SYSTEMS.values())
    text = f"all, or some of {known}; which tests it runs: whole (the default), quick or smoke"
    parser.add_argument("systems", nargs="*", metavar="SYSTEM[:TESTS]", type=asked, help=text)
    text = "systems at a time (default: %(default)s)"
    parser.add_argument("--at-once", type=int, default=1, metavar="COUNT", help=text)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
