"""The ring: the oldest recordings go, and never more than is needed."""

import os
import shutil
import time

import pytest

from tests.recorder.gateway import Gateway, account, core_lines, drives
from vcu_gateway.recording import layout

SEGMENT_FRAMES = 6000


def segment_numbers(folder):
    return [segment.number for segment in layout.segments(folder)]


def size_of(folder):
    return sum(path.stat().st_size for path in folder.rglob("*.gz"))


def long_drive(vehicle, segments):
    for _ in range(segments):
        vehicle.begin_segment()
        vehicle.drive(0.3, frames=SEGMENT_FRAMES // 6)


@pytest.mark.ci
@pytest.mark.clock  # a segment has its seconds, too
def test_the_oldest_segments_go_above_the_budget(recorder, gateway, tmp_path):
    budget = 400_000
    process = recorder("--max-bytes", str(budget))
    vehicle = gateway()
    recordings = tmp_path / "recordings" / "drives"
    largest = 0
    for _ in range(20):
        long_drive(vehicle, 2)
        vehicle.tick(mode="standby")  # written at once
        time.sleep(0.1)
        largest = max(largest, size_of(recordings))
    vehicle.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    left = segment_numbers(drive)
    segment = max(sum(path.stat().st_size for path in one.paths) for one in layout.segments(drive))
    assert left[-1] == 40
    assert left[0] > 20
    assert largest <= budget + segment
    assert process.status["totals"]["removed_segments"] == left[0] - 1


def test_what_is_left_of_a_drive_begins_with_a_checkpoint(recorder, gateway, tmp_path):
    process = recorder("--max-bytes", "300k")
    vehicle = gateway()
    long_drive(vehicle, 12)
    vehicle.tick(mode="standby")
    vehicle.drive(0.5)
    vehicle.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    first = layout.segments(drive)[0]
    assert first.number > 1
    assert "checkpoint" in core_lines(first)[0]


def test_the_oldest_drive_is_known_by_its_number_and_not_by_its_clock(recorder, gateway, tmp_path):
    process = recorder()
    first = Gateway(tmp_path / "tap.sock")
    first.clock["wall_ns"] += 10**18  # a clock that was far ahead
    first.connect()
    long_drive(first, 4)
    first.close()
    second = gateway()
    long_drive(second, 1)
    second.close()
    assert process.stop() == 0
    later, earlier = drives(tmp_path)  # by their names
    assert layout.read_description(earlier / "drive.json")["run"] == first.run
    budget = size_of(tmp_path) - size_of(earlier) // 2
    process = recorder("--max-bytes", str(budget))
    second.connect()
    second.drive(1.5)
    second.close()
    assert process.stop() == 0
    assert segment_numbers(earlier)[0] > 1
    assert segment_numbers(later) == [1, 2]


def test_a_drive_without_segments_goes_with_its_folder(recorder, gateway, tmp_path):
    process = recorder("--max-bytes", "300k")
    first = gateway()
    long_drive(first, 4)
    first.close()
    second = gateway()
    long_drive(second, 10)
    second.tick(mode="standby")
    second.drive(0.5)
    second.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    assert layout.read_description(drive / "drive.json")["run"] == second.run


def test_a_drive_that_somebody_keeps_stays(recorder, gateway, tmp_path):
    process = recorder("--max-bytes", "300k")
    first = gateway()
    long_drive(first, 2)
    first.close()
    process.wait_for(lambda status: not status["connections"])
    (kept,) = drives(tmp_path)
    (kept / layout.KEEP_FILE).touch()
    second = gateway()
    long_drive(second, 10)
    second.tick(mode="standby")
    second.drive(0.5)
    second.close()
    assert process.stop() == 0
    assert segment_numbers(kept) == [1, 2]
    assert account(kept) == (first.frames, 0)


def test_below_the_free_room_only_the_last_minute_is_kept(recorder, gateway, tmp_path):
    more_than_there_is = shutil.disk_usage(tmp_path).free * 2
    process = recorder("--keep-free-bytes", str(more_than_there_is))
    vehicle = gateway()
    for _ in range(4):
        long_drive(vehicle, 2)
        vehicle.tick(mode="standby")
    vehicle.drive(0.5)
    vehicle.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    assert len(segment_numbers(drive)) <= 4
    assert segment_numbers(drive)[-1] == 8


def test_what_is_not_a_recording_is_left_alone(recorder, gateway, tmp_path):
    process = recorder("--max-bytes", "100k")
    first = gateway()
    long_drive(first, 2)
    first.close()
    process.wait_for(lambda status: not status["connections"])
    (drive,) = drives(tmp_path)
    (drive / "notes.txt").write_text("mine")
    second = gateway()
    long_drive(second, 6)
    second.tick(mode="standby")
    second.drive(0.5)
    assert process.stop() == 0
    assert os.listdir(drive) == ["notes.txt"]
