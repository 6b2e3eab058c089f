"""scripts/test-tools: what is missing is one line, on a machine that has only what it is given."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ROOT / "scripts" / "test-tools"
UNAVAILABLE = 69
# Of the scripts themselves.
ORDINARY = (
    "awk cat cp cut dirname env grep id mkdir mktemp paste python3 rm sed sha256sum sh sort tail tr"
    " true"
)


class Machine:
    """A machine whose PATH has these programs alone."""

    def __init__(self, folder: Path) -> None:
        self.bin, self.cache = folder / "bin", folder / "cache"
        self.bin.mkdir()
        for name in ORDINARY.split():
            (self.bin / name).symlink_to(f"/usr/bin/{name}")

    def has(self, name: str, script: str = "") -> None:
        (self.bin / name).write_text(f"#!/bin/sh\n{script}\n")
        (self.bin / name).chmod(0o755)

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        own = {"PATH": str(self.bin), "XDG_CACHE_HOME": str(self.cache), "APT_PAUSES": ""}
        return subprocess.run(
            [TOOLS, *words], env={**os.environ, **own}, capture_output=True, text=True
        )


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_a_tool_that_is_missing_is_one_line_and_how_to_get_it(machine: Machine) -> None:
    done = machine.run("check", "--for", "test-others", "terminal")
    assert (done.returncode, done.stdout) == (UNAVAILABLE, "")
    assert done.stderr == "error: test-others needs tmux: make tools\n"


def test_one_that_is_there_is_no_line(machine: Machine) -> None:
    machine.has("tmux")
    done = machine.run("check", "--for", "test-others", "terminal")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_all_that_is_missing_is_in_the_same_line_once(machine: Machine) -> None:
    done = machine.run("check", "--for", "it", "axe", "terminal", "promtool", "compiler", "guests")
    assert done.returncode == UNAVAILABLE
    assert done.stderr.startswith("error: it needs axe-core, tmux, promtool, a C compiler, ")
    assert done.stderr.count("a C compiler") == 1
    assert done.stderr.count("\n") == 1


def test_without_names_everything_is_looked_for(machine: Machine) -> None:
    done = machine.run("check")
    assert done.returncode == UNAVAILABLE
    for thing in ("tmux", "a C compiler", "axe-core", "promtool", "the libraries of export"):
        assert thing in done.stderr


def test_a_name_that_nobody_knows_is_told_with_those_known(machine: Machine) -> None:
    done = machine.run("check", "tmux")
    assert done.returncode == os.EX_USAGE
    assert done.stderr.startswith("error: no tmux, but: terminal compiler browser ")


def test_looking_installs_nothing(machine: Machine, tmp_path: Path) -> None:
    for name in ("apt-get", "sudo"):
        machine.has(name, f"echo {name} >>{tmp_path}/asked")
    machine.run("check")
    assert not (tmp_path / "asked").exists()
    assert not machine.cache.exists()


def test_what_is_installed_is_said_before_and_is_what_is_missing(machine: Machine) -> None:
    machine.has("apt-get", "exit 0")
    machine.has("sudo", '[ "$1" != -n ] || shift; exec "$@"')
    done = machine.run("install", "terminal")
    assert (done.returncode, done.stderr) == (0, "tools: installing tmux ...\n")


def test_where_one_package_cannot_be_had_the_others_are_installed(
    machine: Machine, tmp_path: Path
) -> None:
    refused = 'case " $* " in *" gcc "*) echo "E: no gcc"; exit 100 ;; esac'
    machine.has("apt-get", f'{refused}; echo "$*" >>{tmp_path}/asked')
    machine.has("sudo", '[ "$1" != -n ] || shift; exec "$@"')
    done = machine.run("install", "terminal", "compiler")
    assert done.returncode == UNAVAILABLE
    assert done.stderr.splitlines()[-1] == "error: cannot install gcc: E: no gcc"
    assert (tmp_path / "asked").read_text().endswith("recommends tmux\n")
