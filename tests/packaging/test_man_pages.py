"""The man pages: one for the program and each verb, complete and well-formed."""

import gzip
import re
import shutil
import subprocess
from pathlib import Path

import click
import pytest

from tests.packaging.built import BIN, REPOSITORY
from vcu_gateway.cli import group
from vcu_gateway.errors import __doc__ as exit_codes

TOP = click.Context(group)
COMMANDS = {verb: group.get_command(TOP, verb) for verb in group.list_commands(TOP)}
GROUPS = {verb: one for verb, one in COMMANDS.items() if isinstance(one, click.Group)}
NAMES = [
    "vcu-gateway",
    *(f"vcu-gateway-{verb}" for verb in COMMANDS),
    *(f"vcu-gateway-{verb}-{own}" for verb, one in GROUPS.items() for own in one.commands),
]
SECTIONS = ["NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXIT STATUS", "ENVIRONMENT", "FILES"]


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("man")
    subprocess.run([REPOSITORY / "scripts/man-pages", folder, BIN / "python"], check=True)
    return folder


def test_there_is_one_for_the_program_and_each_verb(pages):
    assert sorted(path.name for path in pages.iterdir()) == sorted(f"{name}.1" for name in NAMES)


@pytest.mark.timeout(1200)
def test_the_package_has_them_all(deb):
    there = {name for name in deb.contents if name.startswith("usr/share/man/")}
    assert there == {f"usr/share/man/man1/{name}.1.gz" for name in NAMES}
    assert gzip.decompress(deb.contents["usr/share/man/man1/vcu-gateway.1.gz"]).startswith(b".TH")


@pytest.mark.parametrize("name", NAMES)
def test_the_page_has_every_section(pages, name):
    found = re.findall(r"^\.SH (.+)$", (pages / f"{name}.1").read_text(), flags=re.MULTILINE)
    with_verbs = {"vcu-gateway", *(f"vcu-gateway-{verb}" for verb in GROUPS)}
    commands = ["COMMANDS"] if name in with_verbs else []
    assert sorted(found) == sorted([*SECTIONS, *commands, "SEE ALSO"])


@pytest.mark.skipif(shutil.which("man") is None, reason="no man here")
def test_they_render_without_a_warning(pages):
    for page in sorted(pages.iterdir()):
        said = rendered(page).stderr
        assert said == "", page.name


@pytest.mark.skipif(shutil.which("man") is None, reason="no man here")
def test_the_page_says_what_help_says(pages):
    text = " ".join(rendered(pages / "vcu-gateway-demand.1").stdout.split())
    assert "vcu-gateway demand [OPTIONS]" in text
    assert "--ttl-ms INTEGER Time to live. [default: 200]" in text
    assert "Hold a demand for both controllers until Ctrl-C, or for so many seconds." in text


@pytest.mark.skipif(shutil.which("man") is None, reason="no man here")
def test_lines_that_must_stay_apart_do(pages):
    text = rendered(pages / "vcu-gateway-decode.1").stdout
    assert re.search(r"^ +candump -L can0 \| vcu-gateway decode -$", text, flags=re.MULTILINE)


def test_every_exit_code_is_explained(pages):
    text = (pages / "vcu-gateway.1").read_text()
    codes = re.findall(r"^ +(\d+) ", exit_codes, flags=re.MULTILINE)
    assert len(codes) >= 10
    assert re.findall(r"^\\fB(\d+)\\fR$", text, flags=re.MULTILINE) == codes


def rendered(page: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["man", "--warnings", "--local-file", page],
        env={"PATH": "/usr/bin:/bin", "LC_ALL": "C.UTF-8", "MANWIDTH": "80", "MANPAGER": "cat"},
        capture_output=True,
        text=True,
    )
