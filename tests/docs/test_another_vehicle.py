"""docs/another-vehicle.md: its steps, one after the other, in a clone of its own."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, blocks

PAGE = ROOT / "docs" / "another-vehicle.md"


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    for name in tracked.stdout.splitlines():
        if (ROOT / name).is_file() and not name.startswith("tests/golden/"):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, tmp_path / name, follow_symlinks=False)
    (tmp_path / ".venv").symlink_to(ROOT / ".venv")
    return tmp_path


def run(block: str, clone: Path, code: int = 0) -> str:
    own = {"PYTHONPATH": f"{clone / 'src'}:{clone}", "XDG_RUNTIME_DIR": str(clone)}
    done = subprocess.run(
        ["bash", "-ec", block],
        cwd=clone,
        capture_output=True,
        text=True,
        env={**os.environ, "LC_ALL": "C.UTF-8", **own},
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def driven(block: str, clone: Path) -> str:
    """What the block says once there was torque: held up before the foot presses, it has none."""
    for _ in range(5):
        said = run(block, clone)
        if re.search(r" commands, [1-9][0-9]* with torque", said):
            return said
    raise AssertionError(said)


@pytest.mark.ci
@pytest.mark.clock  # the verdict of a replay judges how soon the gateway reacted
@pytest.mark.timeout(300)
def test_its_steps_lead_from_a_foreign_dbc_to_a_drive_with_a_pedal(clone: Path):
    foreign, identifiers, generate, drive = blocks(PAGE, "sh")
    differs, fits = (block.splitlines() for block in blocks(PAGE, "console"))
    (ends,) = blocks(PAGE, "text")
    run(foreign, clone)
    refused = run(differs[0].removeprefix("$ "), clone, code=os.EX_DATAERR)
    assert all(line.removeprefix("error: ") in refused for line in differs[1:])
    assert len(re.findall(r"^error: ", refused, re.MULTILINE)) == len(differs) - 1
    run(identifiers, clone)
    run(generate, clone)
    assert fits[1] in run(fits[0].removeprefix("$ "), clone)
    said = driven(drive, clone)
    assert "Pedals_Position " in said
    assert "BMS_Energy " in said
    equal, verdict = ends.splitlines()
    assert re.search(rf"^{re.sub('[0-9]+', '[0-9]+', equal)}", said, re.MULTILINE)
    assert re.search(rf"^{verdict} in \d+ commands, [1-9]", said, re.MULTILINE)
    recorded = next(clone.glob("black-box/drives/*"))
    frames = run(f"zcat -f {recorded}/*frames.log*", clone)
    for identifier in ("18FF50F4#", "18FF51F4#", "18FEC9F4#"):
        assert identifier in frames
    assert "1808D0F4#" not in frames
