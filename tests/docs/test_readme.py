"""The README's way from the demo to a what-if report: run in its own words."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, blocks

README = ROOT / "README.md"
LINES = [
    line.strip()
    for block in blocks(README, "sh")
    if "demo --record" in block
    for line in block.splitlines()
]

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone, as far as the lines look at it."""
    found = tmp_path_factory.mktemp("clone")
    (found / ".venv").symlink_to(ROOT / ".venv")
    return found


def run(line: str, folder: Path, code: int = 0) -> str:
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "LC_ALL": "C.UTF-8", "XDG_RUNTIME_DIR": str(folder)},
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.ci
@pytest.mark.clock  # the verdict of a replay judges how soon the gateway reacted
def test_three_commands_lead_from_the_demo_to_a_what_if_report(folder: Path):
    demo, replay, what_if = LINES
    said = run(demo, folder)
    assert re.search(r"recorded in black-box/drives/\S+; next:", said)
    next_lines = re.findall(
        r"^  (\.venv/bin/vcu-gateway (?:recordings check|replay) .*)$", said, re.MULTILINE
    )
    assert len(next_lines) == 3
    assert "equal" in run(replay, folder)
    differing = run(what_if, folder, code=1)
    assert "what if: limits.throttle_slew_pct_per_s=10" in differing
    assert re.search(r"^PCU1, PCU2 +Throttle +\d+ ", differing, re.MULTILINE)
    page = (folder / "what-if.html").read_text()
    assert page.startswith("<!doctype html>")
    assert len(page) > 50_000
    assert not re.search(r"(?:src|href)=.?https?:", page)
    assert "whole" in run(next_lines[0], folder)
