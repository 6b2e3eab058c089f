"""Starts are counted from one boot to the next, unexpected ones from one drive to the next."""

import subprocess
import sys

import pytest

from vcu_gateway.daemon import restart_state
from vcu_gateway.daemon.restart_state import CountedStart, RestartCounter


def started(folder, *, end: bool = False) -> CountedStart | None:
    one = RestartCounter(folder)
    now = one.begin()
    if end:
        one.end()
    return now


def test_the_first_start_is_expected(tmp_path):
    assert started(tmp_path) == CountedStart(1, 0)


def test_a_start_that_no_end_came_before_is_unexpected(tmp_path):
    assert [started(tmp_path) for _ in range(4)] == [CountedStart(n, n - 1) for n in (1, 2, 3, 4)]


def test_an_orderly_end_begins_a_new_drive(tmp_path):
    started(tmp_path)
    started(tmp_path, end=True)
    assert started(tmp_path) == CountedStart(3, 0)
    assert started(tmp_path) == CountedStart(4, 1)


def test_a_new_boot_begins_anew(tmp_path, monkeypatch):
    started(tmp_path)
    boot = tmp_path / "boot_id"
    boot.write_text("another\n")
    monkeypatch.setattr(restart_state, "_BOOT_ID", boot)
    assert started(tmp_path) == CountedStart(1, 0)


def test_where_the_number_of_the_boot_is_hidden_starts_are_counted_all_the_same(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(restart_state, "_BOOT_ID", tmp_path / "hidden")
    assert [started(tmp_path) for _ in range(2)] == [CountedStart(1, 0), CountedStart(2, 1)]


@pytest.mark.parametrize("contents", [b"", b"nonsense", b"a b c d", b"\xff\xfe", b"x y", b"1 2 3"])
def test_a_file_that_says_nothing_is_begun_anew(tmp_path, contents):
    (tmp_path / "starts").write_bytes(contents)
    assert started(tmp_path) == CountedStart(1, 0)


def test_where_nothing_can_be_kept_nothing_is_claimed(tmp_path):
    assert started(tmp_path / "nowhere", end=True) is None


def test_a_configuration_that_is_refused_is_no_start(tmp_path):
    """Else three mistakes in it would end arming."""
    file = tmp_path / "gateway.yaml"
    file.write_text("bus: {interface: virtual}\napi: {operator_groups: [nobody-has-this-group]}\n")
    done = subprocess.run(
        [sys.executable, "-m", "vcu_gateway", "run", "-c", str(file), "--duration", "0.1"],
        env={"RUNTIME_DIRECTORY": str(tmp_path)}, capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert done.returncode == 78, done.stderr
    assert "nobody-has-this-group" in done.stderr
    assert not (tmp_path / "starts").exists()


def test_a_start_that_cannot_be_written_down_still_knows_of_those_before(tmp_path):
    for _ in range(4):
        started(tmp_path)
    (tmp_path / "starts.new").mkdir()
    assert started(tmp_path) == CountedStart(5, 4)
