"""scripts/deb's build tools, with a dpkg-checkbuilddeps and an apt-get of the test's."""

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.packaging.built import REPOSITORY

NOT_HERE = 69
DEBIAN_12 = "dpkg-checkbuilddeps: error: Unmet build dependencies: debhelper (>= 13.11) python3"
DEBIAN_13 = DEBIAN_12.replace("Unmet", "unmet")
TOOLS_ARE_THERE = "error: systemd/vcu-gateway.service is missing"
"""What comes next: the tree has no units."""


class Machine:
    """A tree of the builder alone, on a machine that has these programs."""

    def __init__(self, folder: Path) -> None:
        self.tree, self.programs = folder / "tree", folder / "programs"
        self.installed = folder / "installed"
        self.programs.mkdir()
        for name in ("scripts/deb", "scripts/apt-install", "packaging/debian/control"):
            (self.tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(REPOSITORY / name, self.tree / name)
        for path in (*Path("/usr/bin").iterdir(), *Path("/bin").iterdir()):
            if not path.name.startswith(("dpkg-", "apt")) and not self.program(path.name).exists():
                self.program(path.name).symlink_to(path)
        self.write("sudo", '[ "$1" != -n ] || shift; exec "$@"')

    def program(self, name: str) -> Path:
        return self.programs / name

    def write(self, name: str, script: str) -> None:
        self.program(name).unlink(missing_ok=True)
        self.program(name).write_text(f"#!/bin/sh\n{script}\n")
        self.program(name).chmod(0o755)

    def answer(self, said: str, fixed: bool = True) -> None:
        """Let dpkg-checkbuilddeps say so until something was installed, if that helps."""
        helped = f"[ ! -e {self.installed} ] || exit 0; " if fixed else ""
        self.write("dpkg-checkbuilddeps", f"{helped}echo '{said}' >&2; exit 1")

    def install(self, script: str = "") -> None:
        """Let apt-get install, and note what."""
        note = f'all="$*"; echo "${{all##*recommends }}" >>{self.installed}'
        self.write("apt-get", f"{note}\n{script}")


class Built(NamedTuple):
    status: int
    last: str
    installed: list[str]


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def build(machine: Machine, **environment: str) -> Built:
    own = {"PATH": str(machine.programs), "SOURCE_DATE_EPOCH": "1", "APT_PAUSES": ""}
    done = subprocess.run(
        [machine.tree / "scripts/deb", machine.programs],
        env={**os.environ, **own, **environment},
        capture_output=True,
        text=True,
    )
    noted = machine.installed.read_text().splitlines() if machine.installed.exists() else []
    return Built(done.returncode, done.stderr.splitlines()[-1], noted)


@pytest.mark.parametrize("said", [DEBIAN_12, DEBIAN_13], ids=["Debian 12", "Debian 13"])
def test_what_either_debian_calls_unmet_is_installed(machine, said):
    machine.answer(said)
    machine.install()
    assert build(machine) == Built(NOT_HERE, TOOLS_ARE_THERE, ["debhelper python3"])


def test_a_machine_without_dpkg_dev_gets_it_first(machine):
    machine.answer(DEBIAN_13)
    checker = machine.program("dpkg-checkbuilddeps")
    checker.rename(machine.tree / "checker")
    machine.install(f"[ -e {checker} ] || cp {machine.tree}/checker {checker}")
    assert build(machine) == Built(NOT_HERE, TOOLS_ARE_THERE, ["dpkg-dev"])


def test_without_leave_to_install_one_line_says_what_to_type(machine):
    line = "error: build tools are missing: sudo apt install"
    assert build(machine, DEB_INSTALL="no") == Built(NOT_HERE, f"{line} dpkg-dev", [])
    machine.answer(DEBIAN_13)
    assert build(machine, DEB_INSTALL="no") == Built(NOT_HERE, f"{line} debhelper python3", [])


def test_a_build_tool_that_the_release_does_not_have_is_named(machine):
    machine.answer(DEBIAN_13, fixed=False)
    machine.install()
    last = "error: this release has no debhelper (>= 13.11) python3"
    assert build(machine)[:2] == (NOT_HERE, last)


def test_another_error_of_dpkg_is_shown_and_nothing_is_installed(machine):
    said = "dpkg-checkbuilddeps: error: cannot read packaging/debian/control"
    machine.answer(said)
    machine.install()
    assert build(machine) == Built(NOT_HERE, f"error: {said}", [])


def test_an_installation_that_fails_ends_the_build_with_its_own_line(machine):
    machine.answer(DEBIAN_13)
    machine.install('echo "E: the mirror is gone"; exit 100')
    built = build(machine)
    assert built[:2] == (
        NOT_HERE,
        "error: cannot install debhelper python3: E: the mirror is gone",
    )


@pytest.mark.parametrize("page", ["README.md", "docs/install.md"])
def test_the_pages_name_what_a_newcomers_machine_lacks_for_the_package(page):
    control = (REPOSITORY / "packaging/debian/control").read_text()
    wanted = control.split("Build-Depends:\n")[1].split("\nStandards")[0]
    named = {line.split()[0].strip(",") for line in wanted.splitlines()}
    text = " ".join((REPOSITORY / page).read_text().split())
    (said,) = re.findall(r"with sudo, what it builds with and the \w+ lacks\W+([\w, -]+)", text)
    assert set(re.split(r", | and ", said)) == {"dpkg-dev", *named} - {
        "debhelper-compat",
        "python3",
    }
