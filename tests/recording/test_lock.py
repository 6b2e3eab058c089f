"""The mark of a drive that is being written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vcu_gateway.recording import layout

_HOLD = "import sys; from vcu_gateway.recording import layout; from pathlib import Path; \
layout.hold(Path(sys.argv[1])); print(flush=True); sys.stdin.read()"


def test_a_folder_is_free_until_somebody_holds_it_and_when_it_is_let_go(tmp_path: Path):
    assert not layout.is_held(tmp_path)
    descriptor = layout.hold(tmp_path)
    assert layout.is_held(tmp_path)
    os.close(descriptor)
    assert not layout.is_held(tmp_path)


def test_looking_does_not_take_it(tmp_path: Path):
    assert not layout.is_held(tmp_path)
    os.close(layout.hold(tmp_path))


def test_it_ends_with_the_process_that_is_killed(tmp_path: Path):
    with subprocess.Popen(
        [sys.executable, "-c", _HOLD, tmp_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout is not None
        writer.stdout.readline()
        assert layout.is_held(tmp_path)
        writer.kill()
    assert not layout.is_held(tmp_path)


def test_a_link_to_a_folder_is_none(tmp_path: Path):
    (tmp_path / "link").symlink_to(tmp_path)
    with pytest.raises(OSError, match="link"):
        layout.is_held(tmp_path / "link")
