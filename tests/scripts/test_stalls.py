"""tests/stalls.py: only what failed while the machine stood still is taken again."""

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
HELD_UP = """
import os, pathlib, signal, time
import pytest

def slept(pid):
    # First while it starts, then every 10 ms.
    status = pathlib.Path("/proc", str(pid), "status").read_text()
    return int(status.partition("voluntary_ctxt_switches:")[2].split()[0])

def hold_up(seconds):
    # Stop what watches the machine, as the machine would by standing still.
    task = pathlib.Path("/proc/self/task", str(os.getpid()), "children")
    watching = [int(pid) for pid in task.read_text().split()]
    assert len(watching) == len(os.sched_getaffinity(0))
    while any(slept(pid) < 30 for pid in watching):
        time.sleep(0.01)
    for pid in watching:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    for pid in watching:
        os.kill(pid, signal.SIGCONT)
    time.sleep(0.05)

begun = []

@pytest.fixture(scope="module")
def gateway():
    begun.append("gateway")
    yield begun
    begun.append("ended")

def test_before(gateway):
    assert begun == ["gateway"]
"""


@pytest.fixture
def run(tmp_path: Path):
    """Run pytest over these tests; its closing lines."""

    def run(tests: str) -> str:
        (tmp_path / "pytest.ini").touch()  # whatever stands in the folders above
        (tmp_path / "test_one.py").write_text(HELD_UP + tests)
        command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.stalls", "--timeout=9"]
        environment = {"PYTHONPATH": str(REPOSITORY)}
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        return done.stdout + done.stderr

    return run


def test_what_failed_while_the_machine_stood_still_begins_anew_with_all_its_fixtures(run):
    said = run("""
def test_held_up(gateway):
    if len(begun) == 1:
        hold_up(0.1)
    assert begun == ["gateway", "ended", "gateway"]
""")
    assert "2 passed" in said
    assert "taken again: test_one.py::test_held_up: stood still for 1" in said


def test_a_fixture_that_ends_badly_after_it_ends_no_run(run):
    said = run("""
@pytest.fixture(scope="module")
def link():
    yield
    if len(begun) == 1:
        pytest.fail("the gateway had stopped")

def test_held_up(gateway, link):
    if len(begun) == 1:
        hold_up(0.1)
    assert begun == ["gateway", "ended", "gateway"]

def test_after(gateway):
    pass
""")
    assert "3 passed" in said


def test_what_fails_always_has_failed_after_the_fifth_time(run):
    said = run("""
def test_wrong(gateway):
    hold_up(0.1)
    assert begun.count("gateway") == 9
""")
    assert "1 failed, 1 passed" in said
    assert said.count("taken again") == 4
    assert "5 == 9" in said


def test_what_failed_while_it_did_not_has_failed_at_once(run):
    """Tried some times: this machine may stand still, too."""
    wrong = "def test_wrong(gateway):\n    assert not begun\n"
    assert any("taken again" not in run(wrong) for _ in range(5))


@pytest.mark.ci
def test_what_hangs_is_ended_each_time(run):
    said = run("""
@pytest.mark.timeout(1)
def test_hangs(gateway):
    hold_up(0.1)
    time.sleep(60)
""")
    assert "Timeout" in said
    assert said.count("taken again") == 4
