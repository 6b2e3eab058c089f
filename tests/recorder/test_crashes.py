"""A recorder killed at any moment: what it leaves can be read, and the next one tells the gap."""

import itertools
import os
import random
import time

import pytest

from tests.processors import started_on
from tests.recorder.faulty_disk import FaultyDisk
from tests.recorder.gateway import account, core_lines, damage, drives, recorded_frames
from vcu_gateway.recording import layout

FRAMES_PER_S = 18 / 0.05
CALM_S = 3.5
"""After so long without anything urgent the recorder wakes up twice a second."""


@pytest.fixture
def one_processor():
    """What is started runs where this program does, which knows how long that one stood still."""
    with started_on({max(os.sched_getaffinity(0))}):
        yield


def is_begun(folder, number):
    """Whether so many segments are there, and the last one says where it begins."""
    segments = [segment for drive in drives(folder) for segment in layout.segments(drive)]
    if len(segments) != number or len(segments[-1].paths) < 2:
        return False
    return len(core_lines(segments[-1])) > 1


@pytest.mark.timeout(300)
@pytest.mark.parametrize("kills", [8, pytest.param(50, marks=pytest.mark.ci)])
@pytest.mark.usefixtures("one_processor", "recordings_in_memory")
def test_kills_at_any_moment_lose_a_second_each_and_tell_it(recorder, gateway, tmp_path, kills):
    chance = random.Random(15)
    process = recorder()
    vehicle = gateway()
    vehicle.drive(CALM_S)  # the first one is killed where it takes several ticks together
    for number in range(1, kills + 1):
        connected_s, waited_s, slow_s = time.monotonic(), process.waited_s, 0.0
        while not is_begun(tmp_path, number):
            slow_s += vehicle.drive(0.05, reconnect=False)
        took_s = time.monotonic() - connected_s
        assert took_s <= 0.3 + slow_s + max(0.0, process.waited_s - waited_s)
        slow_s += vehicle.drive(0.3 + chance.random(), reconnect=False)
        # What the machine lets this program wait, or the recorder, is not the recorder's.
        slow_s += max(0.0, process.waited_s - waited_s)
        handed_on = vehicle.frames
        process.kill()
        segment = layout.segments(drives(tmp_path)[0])[-1]
        begin = core_lines(segment)[1]["begin"]["frames"]
        lost_s = (handed_on - begin - recorded_frames(segment)) / FRAMES_PER_S
        assert lost_s <= 1.0 + slow_s
        process = recorder()
        vehicle.close()
        vehicle.connect()
    vehicle.drive(0.5)
    vehicle.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    recorded, lost = account(drive)
    assert recorded + lost == vehicle.frames
    assert len(layout.segments(drive)) == kills + 1
    for segment in layout.segments(drive):
        assert all(one.torn for path in segment.paths for one in damage(path))


def test_a_second_recorder_does_not_write_into_the_same_folder(recorder):
    first = recorder()
    first.wait_for(lambda status: True)
    second = recorder("--socket", "/nonexistent/tap.sock")
    assert second.process.wait(10) == 69
    assert "another recorder writes into" in second.errors


@pytest.mark.ci
@pytest.mark.clock
def test_a_latched_fault_is_on_the_disk_at_once_and_what_follows_it(recorder, gateway, tmp_path):
    disk = FaultyDisk(tmp_path, tmp_path / "recordings")
    recorder(environment=disk.environment)
    vehicle = gateway()
    vehicle.drive(CALM_S)
    latched_s = time.monotonic()
    vehicle.latch()
    vehicle.drive(3)
    after = [at_s - latched_s for at_s in disk.syncs_s if at_s > latched_s]
    assert after[0] < 0.1
    within = [at_s for at_s in after if at_s < 2.0]
    assert within[-1] > 1.7
    assert max(later - at for at, later in itertools.pairwise(within)) < 0.25
    assert not [at_s for at_s in after if 2.5 < at_s < 3]


@pytest.mark.clock
def test_what_follows_a_mode_change_is_on_the_disk_at_once(recorder, gateway, tmp_path):
    disk = FaultyDisk(tmp_path, tmp_path / "recordings")
    recorder(environment=disk.environment)
    vehicle = gateway()
    vehicle.drive(1)
    changed_s = time.monotonic()
    vehicle.tick(mode="active")
    vehicle.drive(0.5)
    assert [at_s for at_s in disk.syncs_s if changed_s < at_s < changed_s + 0.1]
