"""Files that are replaced as a whole."""

import os
import stat

import pytest

from vcu_gateway import files


@pytest.fixture
def path(tmp_path):
    old = tmp_path / "state"
    old.write_text("old")
    return old


def mode_of(path):
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize(
    ("contents", "written"), [("später\n", b"sp\xc3\xa4ter\n"), (b"\0", b"\0")]
)
def test_a_file_is_replaced_and_nothing_is_left_beside_it(path, contents, written):
    files.replace(path, contents)
    assert path.read_bytes() == written
    assert os.listdir(path.parent) == ["state"]


@pytest.mark.parametrize(("mode", "umask", "found"), [(None, 0o077, 0o600), (0o644, 0o077, 0o644)])
def test_the_mode_is_the_umasks_or_the_one_that_is_given(path, mode, umask, found):
    before = os.umask(umask)
    try:
        files.replace(path, "new", mode)
    finally:
        os.umask(before)
    assert mode_of(path) == found


def test_a_file_that_was_left_beside_gets_the_mode_that_is_given(path):
    left_over = path.with_name("state.new")
    left_over.write_text("much longer than what follows")
    left_over.chmod(0o666)
    files.replace(path, "new", 0o600)
    assert (path.read_text(), mode_of(path)) == ("new", 0o600)


def test_nothing_is_written_through_a_link_that_lies_in_the_way(path, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("untouched")
    path.with_name("state.new").symlink_to(elsewhere)
    with pytest.raises(OSError, match="symbolic links"):
        files.replace(path, "new")
    assert (path.read_text(), elsewhere.read_text()) == ("old", "untouched")


def test_where_replacing_fails_the_old_file_stays_and_nothing_beside_it(path):
    path.unlink()
    path.mkdir()
    with pytest.raises(OSError, match="directory"):
        files.replace(path, "new")
    assert os.listdir(path.parent) == ["state"]


def test_files_and_folders_are_synced(path, monkeypatch):
    synced = []
    monkeypatch.setattr(
        os, "fsync", lambda number: synced.append(os.readlink(f"/proc/self/fd/{number}"))
    )
    files.sync(path)
    files.sync(path.parent)
    assert synced == [str(path), str(path.parent)]
