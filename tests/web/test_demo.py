"""`vcu-gateway demo --web`: the page of a simulated vehicle, and nothing left behind."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

WAIT_S = 60


@pytest.fixture
def demo() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts it; whatever goes on after the test is ended."""
    started: list[subprocess.Popen[str]] = []
    folder = Path(tempfile.mkdtemp(prefix="vcu."))

    def start(*options: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "vcu_gateway", "demo", "--web", *options]
        command += ["--socket", str(folder / f"{len(started)}.sock")]
        pipe = subprocess.PIPE
        started.append(subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
            process.communicate(timeout=WAIT_S)
    folder.rmdir()


def address(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found
    return found[0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_says_where_the_page_is_and_a_signal_ends_it_with_a_summary(demo, number):
    process = demo()
    with urllib.request.urlopen(address(process), timeout=WAIT_S) as answer:
        assert b"vcu-gateway" in answer.read()
    assert process.stdout is not None
    assert process.stdout.readline() == "in another terminal:\n"
    assert process.stdout.readline().startswith("  export VCU_GATEWAY_SOCKET=/")
    process.send_signal(number)
    output, errors = process.communicate(timeout=WAIT_S)
    assert (process.returncode, errors) == (0, "")
    assert re.search(r"\d+ ticks, \d+ skipped, \d+ command frames sent", output)


def test_its_duration_ends_it_and_what_was_recorded_is_named(demo, tmp_path):
    done = demo("--duration", "3", "--record", str(tmp_path / "recordings"))
    output, _ = done.communicate(timeout=WAIT_S)
    assert done.returncode == os.EX_OK
    assert "vcu-gateway replay" in output


def test_a_second_one_says_that_the_port_is_taken(demo):
    first = demo()
    address(first)
    second = demo()
    _, errors = second.communicate(timeout=WAIT_S)
    assert second.returncode == os.EX_UNAVAILABLE
    assert "ss -ltnp" in errors
