"""What a real recorder has written, checked and kept while it runs and after it was killed."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.recorder.conftest import gateway, recorder  # noqa: F401 - fixtures
from tests.recorder.gateway import drives
from vcu_gateway.recording import layout
from vcu_gateway.recording.check import CheckedRecording, RecordingState, check_recording
from vcu_gateway.recording.folder import RecordingFolder, RecordingPath, summarise

pytestmark = pytest.mark.timeout(120)


def only_drive(folder: Path) -> RecordingPath:
    (drive,) = drives(folder)
    return RecordingFolder(folder / "recordings").named(drive.name)


def checked(folder: Path) -> CheckedRecording:
    return check_recording(only_drive(folder), lambda size: None)


def test_a_drive_that_ended_in_order_is_whole(recorder, gateway, tmp_path):  # noqa: F811
    process = recorder()
    vehicle = gateway()
    vehicle.drive(1.5)
    vehicle.begin_segment()
    vehicle.drive(1.5)
    last_tick_s = int(time.time())
    vehicle.tick()
    vehicle.close()
    assert process.stop() == 0, process.errors
    found = checked(tmp_path)
    assert found.is_whole
    assert not found.is_cut_off
    assert (found.frames, found.missing_frames) == (vehicle.frames, 0)
    summary = summarise(only_drive(tmp_path))
    end_s = round((summary.begun_wall_ns or 0) / 1e9 + (summary.duration_s or 0), 3)
    assert last_tick_s <= end_s <= time.time()
    assert summary.problems == ()


def test_a_running_drive_is_being_written_and_whole(recorder, gateway, tmp_path):  # noqa: F811
    recorder()
    vehicle = gateway()
    vehicle.drive(2.5)
    found = checked(tmp_path)
    assert found.is_written
    assert found.is_whole
    assert summarise(only_drive(tmp_path)).is_written


def test_after_a_kill_and_a_new_start_all_of_it_adds_up(recorder, gateway, tmp_path):  # noqa: F811
    process = recorder()
    vehicle = gateway()
    vehicle.drive(2.5)
    process.kill()
    found = checked(tmp_path)
    assert found.is_cut_off
    assert found.state is RecordingState.INCOMPLETE
    process = recorder()
    vehicle.drive(3)
    vehicle.close()
    assert process.stop() == 0, process.errors
    found = checked(tmp_path)
    assert found.is_whole, found
    assert found.gaps.frames > 0
    assert found.frames + found.gaps.frames == vehicle.frames


def test_keep_now_makes_an_incident_of_this_moment(recorder, gateway, tmp_path):  # noqa: F811
    process = recorder()
    vehicle = gateway()
    vehicle.drive(1.5)
    process.wait_for(lambda status: status["connections"])
    command = [sys.executable, "-m", "vcu_gateway", "recordings", "keep", "now"]
    command += ["--folder", str(process.folder), "--status", str(process.status_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as keeping:
        until_s = time.monotonic() + 20
        while keeping.poll() is None and time.monotonic() < until_s:
            vehicle.drive(0.1)
        assert keeping.stdout is not None
        name = keeping.stdout.read().strip()
    assert (process.folder / layout.INCIDENTS / name / layout.INCIDENT_FILE).exists()
