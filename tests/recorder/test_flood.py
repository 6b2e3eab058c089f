"""A flood of odd connections beside an honest gateway: what memory holds of them is bounded."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.recorder.gateway import account, breaks, drives
from vcu_gateway.recording import layout

ROOT = Path(__file__).parent.parent.parent
MEMORY_MAX = 128 << 20
"""Of the unit."""


def peak_bytes(process):
    lines = Path(f"/proc/{process.process.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) << 10


@pytest.mark.ci
def test_what_waits_of_ten_thousand_hostile_datagrams_is_bounded(recorder, gateway, tmp_path):
    process = recorder()
    honest = gateway()
    honest.drive(0.3)
    command = [sys.executable, "-m", "tests.recorder.hostile", str(process.socket), honest.run]
    with subprocess.Popen(
        [*command, "24", "10000", "200"], cwd=ROOT, stdout=subprocess.PIPE
    ) as flood:
        while flood.poll() is None:
            honest.drive(0.2)
        sent = json.loads(flood.stdout.read())
    honest.drive(0.3)
    assert sent["datagrams"] >= 10_000
    peak = peak_bytes(process)
    honest.close()
    assert process.stop() == 0, process.errors
    assert peak < 0.8 * MEMORY_MAX
    runs = {
        layout.read_description(one / layout.DRIVE_FILE)["run"]: one for one in drives(tmp_path)
    }
    assert account(runs[honest.run]) == (honest.frames, 0), process.errors[:3000]
    assert not breaks(runs[honest.run])
