"""scripts/suite: that it runs what it should, beside each other, and tells how it went."""

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "suite"
PURE = (
    *("test-serving", "test-shell", "test-faults-pure", "test-others", "test-exhaustive"),
    *("test-golden", "test-recorder", "test-recordings", "test-web-server", "test-clock"),
)
QUICK = f"""
lint test-core {" ".join(PURE)}:
\t@echo "1 passed in 0.01s"
"""
BUS = ("test-vcan", "test-recorded", "test-faults-vcan", "test-faults-slcan")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project whose steps of the quick suite all pass."""
    (tmp_path / "Makefile").write_text(QUICK)
    return tmp_path


def replace_step(folder: Path, step: str, *recipe: str) -> None:
    makefile = folder / "Makefile"
    rest = makefile.read_text().replace(f"{step} ", "", 1)
    makefile.write_text(rest + f"\n{step}:\n" + "".join(f"\t{line}\n" for line in recipe))


def suite(
    folder: Path, *options: str, name: str = "quick", first: tuple[str, ...] = ()
) -> subprocess.CompletedProcess[str]:
    command: list[str | Path] = [*first, SCRIPT, name, "-C", folder, *options]
    return subprocess.run(command, capture_output=True, text=True)


def runs(pid: str) -> bool:
    try:
        return Path("/proc", pid, "stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def test_each_step_is_told_with_its_tests_and_then_the_verdict(folder: Path) -> None:
    done = suite(folder)
    assert done.returncode == 0
    assert (
        len(
            re.findall(
                r"^ \d:\d\d  [a-z-]+ +\d+ s, +\d+ s of a processor  1 passed",
                done.stdout,
                re.MULTILINE,
            )
        )
        == 12
    )
    assert re.search(r"first verdict after \d+ s: style, types and core are right", done.stdout)
    assert "\n12 passed, 0 failed, 0 skipped\n" in done.stdout
    assert re.search(r"12 steps in 0 min \d+ s: all right", done.stdout)
    assert "\033" not in done.stdout


def test_a_step_that_fails_is_shown_and_the_others_run_on(folder: Path) -> None:
    replace_step(folder, "test-core", "@echo the reason; exit 3")
    done = suite(folder)
    assert done.returncode == 1
    assert "test-core         FAILED" in done.stdout
    assert "the reason" in done.stdout
    assert "all of it: build/suite/test-core.log; again: make test-core" in done.stdout
    assert "first verdict" in done.stdout
    assert "12 steps" in done.stdout
    last, verdict = done.stdout.splitlines()[-2:]
    assert last.endswith("test-core: the reason")
    assert verdict.endswith("failed: test-core")


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


def test_what_was_taken_again_since_the_machine_stood_still_is_told(folder: Path) -> None:
    replace_step(folder, "test-others", "@echo 'taken again: tests/a.py::b: stood still for 30 ms'")
    assert "taken again: tests/a.py::b: stood still for 30 ms" in suite(folder).stdout


def test_no_more_steps_run_at_once_than_asked_for(folder: Path) -> None:
    steps = ["lint", "test-core", "test-others", "test-shell"]
    for step in steps:
        replace_step(folder, step, f"@echo began {step} >>order; sleep 0.3; echo ended >>order")
    suite(folder, "--jobs", "1")
    assert order(folder) == [line for step in steps for line in (f"began {step}", "ended")]


def test_a_step_whose_tests_wait_takes_no_other_steps_place(folder: Path) -> None:
    wait = "@for _ in $$(seq 100); do [ -e other ] && exit; sleep 0.1; done; exit 1"
    replace_step(folder, "test-recorder", wait)
    replace_step(folder, "test-others", "@touch other")
    assert suite(folder, "--jobs", "1").returncode == 0


def test_as_many_timed_steps_as_processors_run_at_once_and_the_others_give_way(
    folder: Path,
) -> None:
    """Of the suite on the bus every step judges by the clock."""
    tell = "nice >>niceness; echo + >>begun; sleep 0.3; wc -l <begun"
    (folder / "Makefile").write_text(f"{' '.join(BUS)}:\n\t@{tell}\n")
    assert suite(folder, "--jobs", "2", name="bus").returncode == 0
    first, second = ((folder / f"build/suite/{step}.log").read_text() for step in BUS[2::-2])
    assert {first.strip(), second.strip()} == {"2"}, "two began, and no third before one ended"
    assert set((folder / "niceness").read_text().split()) == {str(os.nice(0))}
    (folder / "Makefile").write_text(QUICK)
    replace_step(folder, "lint", "@nice >niceness")  # the first verdict gives way to none
    replace_step(folder, "test-shell", "@nice >>niceness")
    suite(folder)
    niceness = (folder / "niceness").read_text().split()
    assert niceness == [str(os.nice(0)), str(min(19, os.nice(0) + 10))]


# A kernel without groups of sessions has no such rank to ask for.
@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="no groups by session here")
def test_the_session_of_a_timed_step_is_before_the_others_as_far_as_this_user_may(
    folder: Path,
) -> None:
    rank, tell = "echo -10 >/proc/self/autogroup", "@sleep 0.5; cat /proc/self/autogroup"
    may = subprocess.run(["sh", "-c", rank], start_new_session=True, capture_output=True)
    replace_step(folder, "test-clock", f"{tell} >timed")
    replace_step(folder, "test-shell", f"{tell} >gives-way")
    assert suite(folder).returncode == 0
    ranks = [(folder / name).read_text().split()[-1] for name in ("timed", "gives-way")]
    assert ranks == ["0" if may.returncode else "-10", "19"]


NIGHTLY = re.findall(
    r'"([a-z-]+)"', SCRIPT.read_text().partition('"nightly": Plan(')[2].partition('"nightly",')[0]
)


@pytest.fixture
def nightly(folder: Path) -> Path:
    """A project under git whose steps of the nightly suite tell that they ran, with their level."""
    recipe = "@echo $@ $(LEVEL) >>order; sleep 0.1; echo end $@ >>order"
    (folder / "Makefile").write_text(f"{' '.join(NIGHTLY)}:\n\t{recipe}\n")
    (folder / ".gitignore").write_text("build\norder\n")
    subprocess.run(["git", "init", "--quiet", folder], check=True)
    return folder


def order(folder: Path) -> list[str]:
    lines = (folder / "order").read_text().splitlines()
    (folder / "order").unlink()
    return lines


def test_steps_that_measure_the_machine_run_alone_after_all_others(nightly: Path) -> None:
    assert suite(nightly, "--jobs", "8", name="nightly").returncode == 0
    lines = order(nightly)
    assert lines[-4:] == [
        *("test-clock nightly", "end test-clock"),
        *("test-web-figures nightly", "end test-web-figures"),
    ]
    assert len(lines) == 2 * len(NIGHTLY) > 20


@pytest.mark.ci
def test_the_nightly_suite_goes_on_where_it_was_ended_unless_a_file_changed(nightly: Path) -> None:
    replace_step(nightly, "mutants", "@[ -e build/well ]")
    assert suite(nightly, name="nightly").returncode == 1
    order(nightly)
    (nightly / "build" / "well").touch()
    again = suite(nightly, name="nightly")
    assert again.returncode == 0
    others = len(NIGHTLY) - 1
    assert f"1 step in 0 min 0 s, {others} passed before (--anew runs them again)" in again.stdout
    assert not (nightly / "order").exists()
    suite(nightly, "--anew", name="nightly")
    assert len(order(nightly)) == 2 * others
    (nightly / "new").touch()
    assert "passed before" not in suite(nightly, name="nightly").stdout
    assert len(order(nightly)) == 2 * others


def test_in_ci_each_step_has_its_level(folder: Path) -> None:
    (folder / "Makefile").write_text(".DEFAULT:\n\t@echo $@ $(LEVEL) >>order\n")
    assert suite(folder, name="ci").returncode == 0
    told = {line.split()[1] for line in order(folder)}
    assert told == {"ci"}


def test_a_background_job_hands_its_ignored_signals_to_no_step(folder: Path) -> None:
    (folder / "Makefile").write_text(QUICK)
    replace_step(folder, "lint", "@grep SigIgn /proc/self/status")
    deaf = ("sh", "-c", "trap '' INT HUP QUIT TERM; exec \"$@\"", "-")
    assert suite(folder, first=deaf).returncode == 0
    ignored = int((folder / "build/suite/lint.log").read_text().split()[1], 16)
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT, signal.SIGTERM):
        assert not ignored >> number - 1 & 1, number


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
