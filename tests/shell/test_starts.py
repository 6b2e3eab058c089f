"""Starts are counted from one boot to the next."""

import pytest

from vcu_gateway import starts
from vcu_gateway.starts import count_start


def test_each_start_since_the_boot_is_counted(tmp_path):
    assert [count_start(tmp_path) for _ in range(3)] == [1, 2, 3]


def test_a_new_boot_begins_anew(tmp_path, monkeypatch):
    count_start(tmp_path)
    boot = tmp_path / "boot_id"
    boot.write_text("another\n")
    monkeypatch.setattr(starts, "_BOOT_ID", boot)
    assert count_start(tmp_path) == 1


@pytest.mark.parametrize("contents", [b"", b"nonsense", b"a b c", b"\xff\xfe", b"x y"])
def test_a_file_that_says_nothing_is_begun_anew(tmp_path, contents):
    (tmp_path / "starts").write_bytes(contents)
    assert count_start(tmp_path) == 1


def test_where_nothing_can_be_kept_nothing_is_claimed(tmp_path):
    assert count_start(tmp_path / "nowhere") is None
