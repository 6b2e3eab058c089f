"""Output files: whole or not there; break the writing, and what stood there before stays."""

import os

import pytest

from vcu_gateway.errors import UnavailableError
from vcu_gateway.export.formats import written_file, written_folder, written_text


def interrupted(out, end):
    out.write("new")
    raise end


def test_a_file_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "drive.csv"
    with written_text(path) as out:
        out.write("é\n")
        assert not path.exists()
    assert path.read_bytes() == b"\xc3\xa9\n"
    assert os.listdir(tmp_path) == ["drive.csv"]


def test_who_reads_the_old_file_meanwhile_reads_it_to_its_end(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("old")
    with path.open() as reader:
        with written_text(path) as out:
            out.write("new")
        assert reader.read() == "old"


def test_its_rights_are_those_of_any_new_file(tmp_path):
    (tmp_path / "other").touch()
    with written_text(tmp_path / "drive.csv"):
        pass
    assert (tmp_path / "drive.csv").stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize("end", [RuntimeError, KeyboardInterrupt])
def test_an_interrupted_file_leaves_the_old_one(tmp_path, end):
    path = tmp_path / "drive.csv"
    path.write_text("old")
    with pytest.raises(end), written_text(path) as out:
        interrupted(out, end)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["drive.csv"]


def test_a_folder_that_is_not_there_is_told(tmp_path):
    with pytest.raises(UnavailableError) as told, written_text(tmp_path / "no" / "drive.csv"):
        pass
    problem = told.value.problems[0]
    assert problem.where == f"{tmp_path}/no/drive.csv"
    assert "No such file" in problem.what


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path):
    path = tmp_path / "drive.mf4"
    with pytest.raises(UnavailableError, match="No space left"), written_file(path):
        raise OSError(28, "No space left on device")
    assert os.listdir(tmp_path) == []


def test_the_suffix_of_the_temporary_name_is_the_formats(tmp_path):
    with written_file(tmp_path / "drive.mdf", ".mf4") as temporary:
        assert temporary.suffix == ".mf4"
    assert os.listdir(tmp_path) == ["drive.mdf"]


def fill(folder, name="a.parquet", text="new"):
    (folder / name).write_text(text)


def test_a_folder_appears_when_it_is_whole_and_replaces_its_like(tmp_path):
    path = tmp_path / "drive.parquet"
    for text in ("first", "second"):
        with written_folder(path, ".parquet") as folder:
            fill(folder, f"{text}.parquet")
    assert os.listdir(path) == ["second.parquet"]
    assert os.listdir(tmp_path) == ["drive.parquet"]


@pytest.mark.parametrize("strange", ["notes.txt", "folder"])
def test_a_folder_with_something_else_in_it_is_never_replaced(tmp_path, strange):
    path = tmp_path / "drive.parquet"
    (path / strange).mkdir(parents=True)
    with (
        pytest.raises(UnavailableError, match=f"cannot be replaced: {strange}"),
        written_folder(path, ".parquet") as folder,
    ):
        fill(folder)
    assert os.listdir(path) == [strange]


def test_a_file_is_never_replaced_by_a_folder(tmp_path):
    path = tmp_path / "drive.parquet"
    path.write_text("mine")
    with pytest.raises(UnavailableError, match="it is no folder"), written_folder(path, ".parquet"):
        pass
    assert path.read_text() == "mine"


def test_an_interrupted_folder_leaves_the_old_one(tmp_path):
    path = tmp_path / "drive.parquet"
    with written_folder(path, ".parquet") as folder:
        fill(folder)
    with pytest.raises(KeyboardInterrupt), written_folder(path, ".parquet") as folder:
        interrupted((folder / "b.parquet").open("w"), KeyboardInterrupt)
    assert os.listdir(path) == ["a.parquet"]
    assert os.listdir(tmp_path) == ["drive.parquet"]
