"""The file that the running recorder tells its state in, as a real one writes it."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.recorder.gateway import Gateway, RecorderProcess
from vcu_gateway.errors import DataError, UnavailableError
from vcu_gateway.recording.recorder_status import read_status


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Of a recorder with a gateway that has been driving for a second."""
    folder = tmp_path_factory.mktemp("recorder")
    recorder = RecorderProcess(folder)
    gateway = Gateway(folder / "tap.sock")
    gateway.connect()
    gateway.drive(1.5)
    yield recorder.wait_for(lambda status: status["totals"]["frames"] and status["connections"])
    gateway.close()
    recorder.close()


@pytest.fixture
def path(tmp_path: Path, written: dict[str, Any]) -> Path:
    found = tmp_path / "status.json"
    found.write_text(json.dumps(written))
    return found


def test_what_a_recorder_writes_is_read(path, written):
    status = read_status(path)
    assert status.text() == json.dumps(written) + "\n"
    assert (status.disk, status.last_error) == ("ok", None)
    assert status.totals.frames == written["totals"]["frames"] > 0
    assert 0 < (status.free_bytes or 0) < (status.total_bytes or 0)
    (connection,) = status.connections
    assert connection.channel == "vcan0"
    assert connection.drive is not None


def test_its_age_is_by_the_clock_that_nobody_sets(path, written):
    now_ns = written["written_monotonic_ns"] + 2_500_000_000
    assert read_status(path).age_s(now_ns) == 2.5
    assert 0 < read_status(path).age_s() < 60


def test_a_later_version_may_tell_more(path, written):
    path.write_text(json.dumps(written | {"more": 1}))
    assert read_status(path).pid == written["pid"]


def test_one_that_tells_less_is_of_another_version(path, written):
    path.write_text(json.dumps({key: value for key, value in written.items() if key != "totals"}))
    with pytest.raises(DataError, match="another version of the recorder: 'totals'"):
        read_status(path)


def test_one_that_is_damaged_is_named(path):
    path.write_text("{")
    with pytest.raises(DataError, match="is no JSON"):
        read_status(path)


def test_without_a_recorder_there_is_none(tmp_path):
    with pytest.raises(UnavailableError, match="no recorder has written its state"):
        read_status(tmp_path / "status.json")
