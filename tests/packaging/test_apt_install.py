"""scripts/apt-install, with a mirror that fails: an apt-get that tells what it was asked."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.packaging.built import REPOSITORY

NOT_HERE = 69


@pytest.fixture
def install(tmp_path: Path):
    """Install two packages; the installation fails so many times. The end, and what was asked."""

    def run(failures: int) -> tuple[subprocess.CompletedProcess[str], list[str]]:
        asked = tmp_path / "asked"
        programs = {
            "apt-get": f'echo "$*" >>{asked}\n'
            'case "$*" in *" update") exit 0 ;; esac\n'
            f'[ "$(grep -c " install " {asked})" -gt {failures} ] && exit 0\n'
            'echo "E: the mirror is gone"; exit 100',
            "sudo": '[ "$1" != -n ] || shift; exec "$@"',
        }
        for name, script in programs.items():
            (tmp_path / name).write_text(f"#!/bin/sh\n{script}\n")
            (tmp_path / name).chmod(0o755)
        done = subprocess.run(
            [REPOSITORY / "scripts" / "apt-install", "one", "two"],
            env={**os.environ, "PATH": f"{tmp_path}:/usr/bin:/bin", "APT_PAUSES": "0 0"},
            capture_output=True,
            text=True,
        )
        return done, [line.rpartition("s::Timeout=60 ")[2] for line in asked.open()]

    return run


INSTALL, UPDATE = "install -y --no-install-recommends one two\n", "update\n"


@pytest.mark.parametrize("failures", [0, 1, 2])
def test_a_mirror_that_fails_is_asked_again_with_new_lists(install, failures):
    done, asked = install(failures)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert asked == [INSTALL, *[UPDATE, INSTALL] * failures]


def test_one_that_fails_for_good_is_told_in_apts_words(install):
    done, asked = install(100)
    assert done.returncode == NOT_HERE
    assert done.stderr == "error: cannot install one two: E: the mirror is gone\n"
    assert len(asked) == 5
