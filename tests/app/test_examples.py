"""The examples of docs/examples against a real gateway; how they behave when things go wrong:
tests/client/test_examples.py.
"""

import subprocess
import sys
from pathlib import Path

import pytest

TRIES = 4
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


def example(name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=90)


@pytest.mark.clock
def test_the_control_loop_drives_and_ends_without_motion(running):
    options = ["--throttle-pct", 10, "--ramp-s", 0.5, "--for-s", 1.5]
    for _ in range(TRIES):
        running.until_ready()
        running.throttles()
        done = example("control_loop.py", "--socket", running.socket_path, *options)
        if "the drive ended: standby" not in done.stderr:
            break
        print(f"once more, a machine that holds the loop up for 200 ms ends it: {done.stderr}")
    assert done.returncode == 0, done.stderr
    assert max(running.throttles()) in (25, 26)
    running.until_mode("standby")
    running.throttles()
    running.until(lambda: running.throttles() == {0}, "zero torque")


def test_the_logger_writes_what_the_gateway_knows(running, tmp_path):
    out = tmp_path / "battery.csv"
    arguments = ["--message", "BMS_Status", "--rate-hz", 20, "--output", out, "--count", 10]
    done = example("logger.py", "--socket", running.socket_path, *arguments)
    assert done.returncode == 0, done.stderr
    head, *rows = out.read_text().splitlines()
    assert "SOC" in head
    assert len(rows) == 10
