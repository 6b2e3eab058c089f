"""The file that the running recorder tells its state in."""

import json
from pathlib import Path

import pytest

from vcu_gateway.drive_format.recorder_status import (
    RecordedConnection,
    RecorderStatus,
    read_status,
    write_status,
)
from vcu_gateway.errors import DataError, UnavailableError

STATUS = RecorderStatus(
    pid=123,
    version="0.1.0",
    started_wall_ns=1_763_920_000_000_000_000,
    written_monotonic_ns=5_000_000_000,
    folder="/var/lib/vcu-gateway-recorder",
    total_bytes=32_000_000_000,
    free_bytes=16_000_000_000,
    max_bytes=4 << 30,
    keep_free_bytes=1 << 30,
    incident_max_bytes=1 << 30,
    drives_bytes=100_000_000,
    incidents_bytes=2_000_000,
    incidents=2,
    disk="ok",
    last_error=None,
    waiting_bytes=4096,
    last_sync_s=0.003,
    longest_sync_s=0.02,
    bytes=50_000_000,
    bytes_a_second=4000.0,
    frames=5_000_000,
    ticks=250_000,
    gaps=1,
    frames_lost=7,
    ticks_lost=1,
    syncs=2500,
    sync_failures=0,
    connections=(RecordedConnection("can0", "1f3a9c2e", "20251123T174640Z-1f3a9c2e"),),
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Written."""
    found = tmp_path / "status.json"
    write_status(found, STATUS)
    return found


def test_what_was_written_is_read(path):
    assert read_status(path) == STATUS


def test_it_is_for_all_who_may_enter_the_folder_and_alone_in_it(path):
    write_status(path, STATUS._replace(frames=1))
    assert path.stat().st_mode & 0o777 == 0o644
    assert [one.name for one in path.parent.iterdir()] == ["status.json"]


def test_its_age_is_by_the_clock_that_nobody_sets(path):
    assert read_status(path).age_s(now_ns=7_500_000_000) == 2.5


def test_a_later_version_may_tell_more(path):
    path.write_text(json.dumps(json.loads(path.read_text()) | {"more": 1}))
    assert read_status(path) == STATUS


def test_one_that_tells_less_is_of_another_version(path):
    found = json.loads(path.read_text())
    del found["gaps"]
    path.write_text(json.dumps(found))
    with pytest.raises(DataError, match="another version of the recorder: 'gaps'"):
        read_status(path)


def test_one_that_is_damaged_is_named(path):
    path.write_text("{")
    with pytest.raises(DataError, match="is no JSON"):
        read_status(path)


def test_without_a_recorder_there_is_none(tmp_path):
    with pytest.raises(UnavailableError, match="no recorder has written its state"):
        read_status(tmp_path / "status.json")


def test_where_it_cannot_be_written_nothing_is_left_behind(tmp_path):
    (tmp_path / "status.json").mkdir()
    with pytest.raises(IsADirectoryError):
        write_status(tmp_path / "status.json", STATUS)
    assert [one.name for one in tmp_path.iterdir()] == ["status.json"]
