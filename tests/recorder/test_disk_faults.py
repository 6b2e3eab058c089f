"""Full, slow, dead and missing disks: nothing is lost that memory holds, the rest is told."""

import shutil
import subprocess
import time
from pathlib import Path

import pytest

from tests.recorder.faulty_disk import FaultyDisk
from tests.recorder.gateway import account, core_lines, drives
from vcu_gateway.recording import layout


@pytest.fixture
def disk(recordings_in_memory, tmp_path):
    return FaultyDisk(tmp_path, tmp_path / "recordings")


def gaps(drive):
    lines = [line for segment in layout.segments(drive) for line in core_lines(segment)]
    return [line["gap"] for line in lines if "gap" in line]


def resident_kb(process):
    lines = Path(f"/proc/{process.process.pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))


def test_a_disk_that_stalls_for_five_seconds_loses_nothing(recorder, gateway, disk, tmp_path):
    process = recorder(environment=disk.environment)
    vehicle = gateway()
    vehicle.drive(1.5)
    disk.becomes("stalled")
    vehicle.drive(5)
    process.wait_for(lambda status: status["disk"] == "stalled")
    disk.becomes("ok")
    vehicle.drive(1)
    process.wait_for(lambda status: status["disk"] == "ok")
    vehicle.close()
    assert process.stop() == 0
    assert vehicle.datagrams_lost == 0
    assert account(drives(tmp_path)[0]) == (vehicle.frames, 0)
    assert process.errors.count("stalls for more than") == 1
    assert process.errors.count("stalls no longer") == 1


@pytest.mark.parametrize("word", ["full", "failing", "readonly"])
def test_a_disk_that_comes_back_has_all_or_tells_the_gap(word, recorder, gateway, disk, tmp_path):
    process = recorder(environment=disk.environment)
    vehicle = gateway()
    vehicle.drive(1.5)
    disk.becomes(word)
    vehicle.drive(3)
    state = "full" if word == "full" else "failing"
    process.wait_for(lambda status: status["disk"] == state)
    disk.becomes("ok")
    vehicle.drive(4)
    process.wait_for(lambda status: status["disk"] == "ok")
    vehicle.drive(1)
    vehicle.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    recorded, lost = account(drive)
    assert recorded + lost == vehicle.frames
    assert process.errors.count(f"the disk is {state}") == 1
    assert process.errors.count("the disk works again") == 1
    if word == "full":
        assert lost == 0
    else:
        assert lost > 0
        assert gaps(drive)[0]["why"].startswith("the disk failed: ")


def test_memory_is_bounded_and_the_newest_is_kept(recorder, gateway, disk, tmp_path):
    process = recorder("--memory-bytes", "300k", environment=disk.environment)
    vehicle = gateway()
    vehicle.drive(1.2)
    disk.becomes("stalled")
    vehicle.drive(1)
    before_kb = resident_kb(process)
    for _ in range(10):
        vehicle.begin_segment()
        vehicle.drive(0.5, frames=200)
    status = process.wait_for(lambda status: status["disk"] == "stalled")
    assert status["memory"]["bytes"] <= status["memory"]["max_bytes"] == 300 << 10
    assert resident_kb(process) - before_kb < 2000
    disk.becomes("ok")
    vehicle.drive(1.5)
    vehicle.close()
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    recorded, lost = account(drive)
    assert recorded + lost == vehicle.frames
    (gap,) = gaps(drive)
    assert gap["frames"] == lost > 10 * 200
    assert gap["why"] == "the recorder's memory was full"


def test_a_small_memory_makes_the_gateway_connect_again(recorder, gateway, disk, tmp_path):
    process = recorder("--memory-bytes", "100k", environment=disk.environment)
    vehicle = gateway()
    vehicle.drive(1.2)
    disk.becomes("stalled")
    vehicle.drive(4, frames=200)
    disk.becomes("ok")
    vehicle.drive(2)
    vehicle.close()
    assert process.stop() == 0
    recorded, lost = account(drives(tmp_path)[0])
    assert recorded + lost == vehicle.frames
    assert lost > 0


def test_a_removed_folder_is_told_and_made_again(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(1.5)
    shutil.rmtree(drives(tmp_path)[0])
    vehicle.drive(7)
    vehicle.close()
    assert process.stop() == 0
    assert "somebody removed what was being written" in process.errors
    (drive,) = drives(tmp_path)
    (segment,) = layout.segments(drive)
    lines = core_lines(segment)
    assert lines[1]["begin"]["frames"] + lines[-1]["end"]["frames"] == vehicle.frames


SIZE = 1 << 20


def test_a_full_file_system_loses_nothing_once_there_is_room(recorder, gateway, tmp_path):
    folder = tmp_path / "recordings"
    folder.mkdir()
    mount = f"mount -t tmpfs -o size={SIZE} none {folder} && echo && exec sleep 600"
    inside = ["unshare", "--map-root-user", "--mount", "sh", "-c", mount]
    with subprocess.Popen(inside, stdout=subprocess.PIPE) as holder:
        try:
            assert holder.stdout.readline()
            full_disk(recorder, gateway, Path(f"/proc/{holder.pid}/root{folder}"), holder.pid)
        finally:
            holder.kill()


def full_disk(recorder, gateway, seen, holder_pid):
    enter = ["nsenter", "--target", str(holder_pid), "--user", "--mount", "--preserve-credentials"]
    process = recorder(before=enter)
    vehicle = gateway()
    vehicle.drive(1.5)
    big = seen / "big"
    with pytest.raises(OSError, match="No space"):
        big.write_bytes(bytes(2 * SIZE))
    vehicle.drive(3, frames=200)
    process.wait_for(lambda status: status["disk"] == "full")
    big.unlink()
    process.wait_for(lambda status: status["disk"] == "ok", timeout_s=20)
    vehicle.drive(1)
    vehicle.close()
    time.sleep(0.5)
    assert process.stop() == 0
    (drive,) = layout.recorded_folders(seen / layout.DRIVES)
    assert account(drive) == (vehicle.frames, 0)


@pytest.mark.parametrize("word", ["full", "failing"])
def test_a_disk_that_is_well_again_is_told_though_nothing_is_recorded(
    word, recorder, gateway, disk
):
    process = recorder(environment=disk.environment)
    vehicle = gateway()
    vehicle.drive(1.5)
    disk.becomes(word)
    vehicle.drive(1.5)
    process.wait_for(lambda status: status["disk"] == word)
    vehicle.close()
    time.sleep(1.5)
    assert process.status["disk"] == word
    disk.becomes("ok")
    process.wait_for(lambda status: status["disk"] == "ok")
    assert process.errors.count("the disk works again") == 1
    assert not (process.folder / ".probe").exists()
