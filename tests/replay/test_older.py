"""Recordings that the version before made: read, found whole and replayed to the byte by this one.

Each was recorded by `demo --record` beside a simulated vehicle: `faults` with an emergency stop, an
incident and a silent IMU, `tuned` with other limits and an arm by request, `unchained` by a
version whose members did not name the ones before.
"""

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from vcu_gateway.cli import group

OLDER = Path(__file__).with_name("older")
DRIVES = sorted(OLDER.glob("*/*/*"))
NAMES = [f"{drive.parts[-3]}-{drive.parts[-2]}" for drive in DRIVES]


def shown(*arguments: str) -> str:
    result = CliRunner().invoke(group, list(arguments))
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("drive", DRIVES, ids=NAMES)
def test_an_older_recording_is_whole_equal_to_the_byte_and_its_verdict_holds(drive):
    text = shown("replay", str(drive))
    assert "recording: whole" in text
    assert re.search(r"^equal: (\d+) of \1 ticks to the byte", text, re.MULTILINE)
    assert "verdict: holds; 0 violations" in text


@pytest.mark.parametrize("folder", sorted(OLDER.iterdir()), ids=lambda folder: folder.name)
def test_a_check_calls_an_older_recording_whole(folder):
    lines = shown("recordings", "check", "--folder", str(folder)).splitlines()
    assert lines
    assert all(": whole, " in line for line in lines)
