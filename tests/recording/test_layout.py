"""Folders of drives and incidents: made whole or not at all."""

import os

import pytest

from vcu_gateway.errors import DataError, MissingInputError
from vcu_gateway.recording import layout

WALL_NS = 1_795_456_452_000_000_000


def test_names_tell_the_time_and_nothing_that_a_path_could_mean():
    assert layout.drive_name(WALL_NS, "1f3a9c2e-aaaa") == "20261123T175412Z-1f3a9c2e"
    assert layout.drive_name(0, "../../etc") == "19700101T000000Z-______et"
    assert layout.incident_name(WALL_NS, "a b/c") == "20261123T175412Z-a_b_c"


def test_segments_are_in_the_order_of_their_numbers(tmp_path):
    for name in ("10000.core.jsonl.gz", "9999.frames.log.gz", "9999.core.jsonl.gz", "1.txt"):
        (tmp_path / name).touch()
    first, second = layout.segments(tmp_path)
    assert (first.number, len(first.paths)) == (9999, 2)
    assert (second.number, second.frames) == (10000, None)


def test_a_folder_is_made_with_all_its_files_and_links(tmp_path):
    (tmp_path / "0001.core.jsonl.gz").write_text("x")
    links = [tmp_path / "0001.core.jsonl.gz", tmp_path / "removed.gz"]
    layout.create_folder(tmp_path / "a" / "drive", {"drive.json": b"{}"}, links)
    assert sorted(os.listdir(tmp_path / "a" / "drive")) == ["0001.core.jsonl.gz", "drive.json"]
    assert os.listdir(tmp_path / "a") == ["drive"]


def test_a_folder_that_cannot_be_made_whole_is_not_made(tmp_path):
    with pytest.raises(OSError, match=r"drive\.json"):
        layout.create_folder(tmp_path / "drive", {"b": b"", "no/drive.json": b"{}"})
    assert os.listdir(tmp_path) == []


def test_a_folder_that_is_there_stays_as_it_is(tmp_path):
    (tmp_path / "drive").mkdir()
    (tmp_path / "drive" / "drive.json").write_text("mine")
    with pytest.raises(FileExistsError):
        layout.create_folder(tmp_path / "drive", {"drive.json": b"{}"})
    assert (tmp_path / "drive" / "drive.json").read_text() == "mine"
    assert os.listdir(tmp_path) == ["drive"]


def test_what_a_crash_left_is_no_folder_of_a_drive_and_goes(tmp_path):
    (tmp_path / ".partial-drive").mkdir()
    (tmp_path / "drive").mkdir()
    assert layout.recorded_folders(tmp_path) == [tmp_path / "drive"]
    layout.remove_partial_folders(tmp_path)
    assert os.listdir(tmp_path) == ["drive"]


def test_incident_files_are_in_the_order_of_what_came(tmp_path):
    names = ["incident.json", "incident-2.json", "incident-10.json"]
    for name in [*reversed(names), "incident-x.json"]:
        (tmp_path / name).touch()
    assert [path.name for path in layout.incident_files(tmp_path)] == names


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "is no JSON"),
        ("[1]", "has no format number"),
        ('{"format": "1"}', "has no format number"),
        ('{"format": 2}', "has format 2, and this version reads up to 1"),
    ],
)
def test_a_description_that_cannot_be_used_says_why(text, told, tmp_path):
    (tmp_path / "drive.json").write_text(text)
    with pytest.raises(DataError, match=told):
        layout.read_description(tmp_path / "drive.json")
    assert layout.description_if_any(tmp_path / "drive.json") == {}


def test_a_description_that_is_not_there_says_what_to_give(tmp_path):
    with pytest.raises(MissingInputError, match="give the folder of a drive"):
        layout.read_description(tmp_path / "drive.json")
