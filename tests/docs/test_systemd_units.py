"""The files for systemd, as text; that they do what they say is shown in tests/service."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

SYSTEMD = Path(__file__).parents[2] / "systemd"
UNITS = sorted(
    path
    for path in SYSTEMD.rglob("*")
    if path.suffix in {".service", ".network", ".netdev", ".link"}
)


def settings(path: Path) -> list[tuple[int, str]]:
    """Line numbers and names of the directives; the Match section is what, not why."""
    section, found = "", []
    for number, line in enumerate(path.read_text().splitlines()):
        if line.startswith("["):
            section = line
        elif line and not line.startswith("#") and section not in ("[Match]", "[NetDev]"):
            found.append((number, line.partition("=")[0]))
    return found


@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_every_directive_has_a_comment_that_says_why(path):
    lines = path.read_text().splitlines()
    for number, name in settings(path):
        before = lines[number - 1]
        assert before.startswith(("#", f"{name}=")), f"{path.name}:{number + 1}: {name} says no why"


def test_the_instance_is_made_from_the_plain_unit():
    made = subprocess.run([SYSTEMD / "make-instance"], capture_output=True, text=True, check=True)
    assert (SYSTEMD / "vcu-gateway@.service").read_text() == made.stdout


def test_an_instance_shares_no_folder_with_another():
    text = (SYSTEMD / "vcu-gateway@.service").read_text()
    directives = [line for line in text.splitlines() if line[:1].isalpha()]
    shared = [
        line
        for line in directives
        if re.search(r"(/run|Directory=)/?vcu-gateway(?!-%i|-root|/%i)", line)
    ]
    assert shared == []


@pytest.mark.parametrize("name", ["vcu-gateway.service", "vcu-gateway@.service"])
def test_systemd_understands_every_line(name, tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze on this machine; tests/service asks the real one")
    shutil.copy(SYSTEMD / name, tmp_path)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", f"./{name}"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    said = [
        line for line in done.stderr.splitlines() if name in line and "not executable" not in line
    ]
    assert said == []
