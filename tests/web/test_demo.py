"""`vcu-gateway demo --web`: the page of a simulated vehicle, and nothing left behind."""

import os
import re
import signal
import subprocess
import sys
import urllib.request

import pytest

WAIT_S = 60


def demo(*options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "vcu_gateway", "demo", "--web", *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def address(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found
    return found[0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_says_where_the_page_is_and_a_signal_ends_it_with_a_summary(number):
    process = demo()
    with urllib.request.urlopen(address(process), timeout=WAIT_S) as answer:
        assert b"vcu-gateway" in answer.read()
    process.send_signal(number)
    output, errors = process.communicate(timeout=WAIT_S)
    assert (process.returncode, errors) == (0, "")
    assert re.search(r"\d+ ticks, \d+ skipped, \d+ command frames sent", output)


def test_its_duration_ends_it_and_what_was_recorded_is_named(tmp_path):
    done = demo("--duration", "3", "--record", str(tmp_path / "recordings"))
    output, _ = done.communicate(timeout=WAIT_S)
    assert done.returncode == os.EX_OK
    assert "vcu-gateway replay" in output


def test_a_second_one_says_that_the_port_is_taken():
    first = demo()
    address(first)
    second = demo()
    _, errors = second.communicate(timeout=WAIT_S)
    assert second.returncode == os.EX_UNAVAILABLE
    assert "ss -ltnp" in errors
    first.terminate()
    first.communicate(timeout=WAIT_S)
