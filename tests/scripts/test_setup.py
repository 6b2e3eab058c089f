"""scripts/setup: what it lacks is one line, what is done stays, and layers fit on each other."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAYERS = ("build", "test", "lint", "browser", "export")
LOCKED = re.compile(r"^([a-z0-9-]+)==(\S+)", re.MULTILINE)


@pytest.fixture
def setup(tmp_path: Path):
    """Run it in an empty folder with a python3 that runs this script first."""

    def run(python: str, *words: str) -> subprocess.CompletedProcess[str]:
        fake = tmp_path / "bin" / "python3"
        fake.parent.mkdir()
        fake.write_text(f'#!/bin/sh\n{python}\nexec {sys.executable} "$@"\n')
        fake.chmod(0o755)
        return subprocess.run(
            [ROOT / "scripts" / "setup", *words],
            cwd=tmp_path,
            env={**os.environ, "PATH": f"{fake.parent}:{os.environ['PATH']}"},
            capture_output=True,
            text=True,
        )

    return run


def versions(layer: str = "") -> dict[str, str]:
    name = f"requirements-{layer}.lock" if layer else "requirements.lock"
    return dict(LOCKED.findall((ROOT / name).read_text()))


def test_without_the_module_venv_one_line_says_what_to_type(setup) -> None:
    done = setup('case "$*" in *ensurepip*) exit 1 ;; esac', "python3", ".venv")
    line = "error: python3 has no module venv: sudo apt install python3-venv\n"
    assert (done.returncode, done.stderr) == (os.EX_UNAVAILABLE, line)


def test_an_old_python_is_told(setup, tmp_path: Path) -> None:
    done = setup('case "$*" in *version_info*) exit 1 ;; esac', "python3", ".venv")
    assert done.returncode == os.EX_UNAVAILABLE
    assert done.stderr.startswith("error: python3 is not Python 3.11 or newer; ")
    assert not (tmp_path / ".venv").exists()


def test_what_another_make_has_done_meanwhile_is_left_as_it_is(setup, tmp_path: Path) -> None:
    stamps = [".venv/.set-up", "requirements-lint.lock", ".venv/.lint"]
    (tmp_path / ".venv").mkdir()
    for age, name in enumerate(reversed(stamps)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, ns=(0, 10**18 - age))
    done = setup("echo asked >&2; exit 1", "python3", ".venv", "lint")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("layer", LAYERS)
def test_a_layer_changes_no_version_of_another(layer: str) -> None:
    own = versions(layer)
    assert not own.keys() & versions().keys(), "the program's are below"
    for other in LAYERS:
        both = own.keys() & versions(other).keys()
        assert {name: own[name] for name in both} == {name: versions(other)[name] for name in both}


def test_the_programs_layer_is_without_the_tools_of_its_tests() -> None:
    tools = {"pytest", "hypothesis", "coverage", "mypy", "ruff", "playwright", "pre-commit"}
    assert not tools & (versions() | versions("build")).keys()
