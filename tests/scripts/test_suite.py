"""scripts/suite: that it runs what it should, beside each other, and tells how it went."""

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "suite"
QUICK = """
lint test-core test-serving test-shell test-faults-pure test-others test-exhaustive \
test-golden test-recorder test-web-server:
\t@echo "1 passed in 0.01s"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project whose steps of the quick suite all pass."""
    (tmp_path / "Makefile").write_text(QUICK)
    return tmp_path


def replace_step(folder: Path, step: str, *recipe: str) -> None:
    makefile = folder / "Makefile"
    rest = makefile.read_text().replace(f"{step} ", "", 1)
    makefile.write_text(rest + f"\n{step}:\n" + "".join(f"\t{line}\n" for line in recipe))


def suite(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command: list[str | Path] = [SCRIPT, "quick", "-C", folder, *options]
    return subprocess.run(command, capture_output=True, text=True)


def runs(pid: str) -> bool:
    try:
        return Path("/proc", pid, "stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def test_each_step_is_told_with_its_tests_and_then_the_verdict(folder: Path) -> None:
    done = suite(folder)
    assert done.returncode == 0
    assert len(re.findall(r"^ \d:\d\d  [a-z-]+ +\d+ s  1 passed", done.stdout, re.MULTILINE)) == 10
    assert re.search(r"first verdict after \d+ s: style, types and core are right", done.stdout)
    assert "\n10 passed, 0 failed, 0 skipped\n" in done.stdout
    assert re.search(r"10 steps in 0 min \d+ s: all right", done.stdout)
    assert "\033" not in done.stdout


def test_a_step_that_fails_is_shown_and_the_others_run_on(folder: Path) -> None:
    replace_step(folder, "test-core", "@echo the reason; exit 3")
    done = suite(folder)
    assert done.returncode == 1
    assert "test-core         FAILED" in done.stdout
    assert "the reason" in done.stdout
    assert "all of it: build/suite/test-core.log; again: make test-core" in done.stdout
    assert "first verdict" in done.stdout
    assert "10 steps" in done.stdout
    assert done.stdout.splitlines()[-1].endswith("failed: test-core")


def test_the_slowest_tests_of_all_steps_are_told_with_what_they_set_up(folder: Path) -> None:
    shown = [f"@echo '{seconds}.00s call     tests/test_a.py::{seconds}'" for seconds in range(9)]
    replace_step(folder, "test-shell", *shown)
    replace_step(
        folder,
        "test-others",
        "@echo '5.00s setup    tests/test_b.py::one'",
        "@echo '6.50s call     tests/test_b.py::one'",
        "@echo '0.60s call     tests/test_b.py::two'",
        "@echo '0.50s call     tests/test_b.py::three'",
    )
    slowest = suite(folder).stdout.partition("the slowest 10 tests")[2].splitlines()[1:11]
    assert slowest[0].split() == ["11.5", "s", "tests/test_b.py::one"]
    assert slowest[1].split() == ["8.0", "s", "tests/test_a.py::8"]
    assert slowest[-1].split() == ["0.6", "s", "tests/test_b.py::two"]


def test_what_was_skipped_is_told(folder: Path) -> None:
    replace_step(folder, "test-others", "@echo 'SKIPPED [1] tests/a.py:3: no bus'")
    assert "skipped: tests/a.py:3: no bus" in suite(folder).stdout


def test_no_more_steps_run_at_once_than_asked_for(folder: Path) -> None:
    steps = ["lint", "test-core", "test-serving", "test-shell"]
    for step in steps:
        replace_step(folder, step, f"@echo began {step} >>order; sleep 0.3; echo ended >>order")
    suite(folder, "--jobs", "1")
    order = (folder / "order").read_text().splitlines()
    assert order == [line for step in steps for line in (f"began {step}", "ended")]


def test_a_step_whose_tests_wait_takes_no_other_steps_place(folder: Path) -> None:
    wait = "@for _ in $$(seq 100); do [ -e other ] && exit; sleep 0.1; done; exit 1"
    replace_step(folder, "test-recorder", wait)
    replace_step(folder, "test-others", "@touch other")
    assert suite(folder, "--jobs", "1").returncode == 0


def test_no_two_steps_that_judge_by_the_clock_run_at_once_and_the_others_give_way(
    folder: Path,
) -> None:
    """Of the suite on the bus every step judges by the clock."""
    steps = [
        "test-vcan",
        "test-recorded",
        "test-faults-vcan",
        "test-faults-netem",
        "test-faults-slcan",
    ]
    tell = "nice >>niceness; [ ! -e timed ] || echo two; touch timed; sleep 0.2; rm timed"
    (folder / "Makefile").write_text(f"{' '.join(steps)}:\n\t@{tell}\n")
    done = subprocess.run(
        [SCRIPT, "bus", "-C", folder, "--jobs", "4"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    assert "two" not in "".join(
        (folder / "build/suite" / f"{step}.log").read_text() for step in steps
    )
    assert set((folder / "niceness").read_text().split()) == {str(os.nice(0))}
    (folder / "Makefile").write_text(QUICK)
    replace_step(folder, "lint", "@sleep 0.3; nice >niceness")
    suite(folder)
    assert (folder / "niceness").read_text().split() == [str(min(19, os.nice(0) + 10))]


def test_a_step_that_measures_the_machine_runs_alone_after_all_others(folder: Path) -> None:
    steps = re.findall(r'"(test-[a-z-]+)"', SCRIPT.read_text().partition("ELSEWHERE")[2])
    elsewhere = steps[: steps.index("test-web-figures") + 1]
    (folder / "Makefile").write_text(
        f"{' '.join(elsewhere)}:\n\t@echo $@ >>order; sleep 0.2; echo end $@ >>order\n"
    )
    command: list[str | Path] = [SCRIPT, "elsewhere", "-C", folder, "--jobs", "8"]
    assert subprocess.run(command, capture_output=True).returncode == 0
    order = (folder / "order").read_text().splitlines()
    assert order[-2:] == ["test-web-figures", "end test-web-figures"]
    assert len(order) == 2 * len(elsewhere) > 10


def test_an_interrupt_ends_every_step(folder: Path) -> None:
    replace_step(folder, "lint", "@sleep 300 & echo $$! >pid; wait")
    process = subprocess.Popen([SCRIPT, "quick", "-C", folder], stdout=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (folder / "pid").exists() or not (folder / "pid").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.splitlines()[-1].endswith("interrupted")
    while runs((folder / "pid").read_text().strip()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
