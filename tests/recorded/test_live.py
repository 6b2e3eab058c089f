"""Drives of the real gateway on vcan0, recorded by the real recorder: complete, and replayed."""

import contextlib
import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.breakable_vehicle import Breaking
from tests.faults.machine import resident_kb
from tests.faults.soak import Soak
from tests.recorded.stand import (
    NS_PER_S,
    RecordedStand,
    account,
    recorded_in,
    recorded_ticks,
    replay,
    wall_s,
)
from tests.vcan.conftest import Process, wait_until
from vcu_gateway.core.calls import NoteSent
from vcu_gateway.recording import layout
from vcu_gateway.recording.core_lines import InputRecord, TickRecord
from vcu_gateway.recording.reader import open_drive

# `make recorded-soak MINUTES=10` is the long one.
ASKED_S = os.environ.get("VCU_RECORDED_SOAK_S")
SOAKS_S = [float(ASKED_S)] if ASKED_S else [20.0, pytest.param(70.0, marks=pytest.mark.ci)]
SEED = int(os.environ.get("VCU_RECORDED_SEED", "15"))
SEGMENTS_REPLAYED = 3
STALL_S = 5.0
# A machine that is busy takes ticks itself; a disk that took one would take one every time.
TRIES = 6
GROWTH_MAX_KB = 1024
BEFORE_S, AFTER_S = 60.0, 30.0
TICK_S = 0.05


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 24 MB of its own, in a file; root only, as in the lab."""
    image, mounted = tmp_path / "disk.img", tmp_path / "disk"
    with image.open("wb") as file:
        file.truncate(24 << 20)
    subprocess.run(["mkfs.ext4", "-q", "-F", image], check=True)
    mounted.mkdir()
    subprocess.run(["mount", "-o", "loop", image, mounted], check=True)
    yield mounted
    subprocess.run(["umount", "--lazy", mounted], check=True)


def stand_of(one: Breaking) -> RecordedStand:
    assert isinstance(one.stand, RecordedStand)
    return one.stand


def end(one: Breaking, recorder: Process) -> Path:
    """End gateway and recorder in order; the only drive."""
    one.let_go()
    assert one.gateway.stop() == 0
    assert recorder.stop() == 0, recorder.err.read_text()
    (drive,) = stand_of(one).drives()
    return drive


def check_equal(path: Path, ticks: int | None = None) -> None:
    """It is replayed to the byte, wholly, and the verdict has nothing against it."""
    found = replay(path)
    told = found.told.get("replay", {})
    assert told, found.errors
    assert told["first_difference"] is None, told
    assert told["equal_ticks"] == told["ticks"] > 0
    assert ticks is None or told["ticks"] == ticks
    # A machine that is busy is late by itself.
    broken = set(found.told["verdict"]["violations_by_rule"]) - {"reaction time"}
    assert not broken, found.told["verdict"]["violations"]


@pytest.mark.timeout(float(ASKED_S or 0) * 3 + 1200)
@pytest.mark.parametrize("soak_s", SOAKS_S)
def test_a_drive_with_random_faults_is_complete_and_replayed_to_the_byte(
    tmp_path: Path, figures: list[str], soak_s: float
) -> None:
    with recorded_in(tmp_path) as (one, recorder):
        soaked = Soak(one, SEED, figures.append).run(soak_s)
        stand = stand_of(one)
        latched = [entry for entry in one.gateway.log() if entry["event"] == "fault_latched"]
        drive = end(one, recorder)
        counted = account(drive)
        figures.append(f"recorded: {soaked}; {counted}; {len(latched)} latched faults")
        assert counted.recorded + counted.lost == counted.handed_on
        assert counted.lost == 0
        check_equal(drive, counted.ticks)
        segments = layout.segments(drive)
        later = segments[1:-1] if len(segments) > SEGMENTS_REPLAYED + 1 else segments[1:]
        for segment in random.Random(SEED).sample(later, min(SEGMENTS_REPLAYED, len(later))):
            assert segment.core is not None
            check_equal(segment.core)
        check_incidents(stand, drive, latched)


def check_incidents(stand: RecordedStand, drive: Path, latched: list[dict]) -> None:
    """Every latched fault is in an incident, with what was before it and what came after."""
    spans = {folder: span(folder) for folder in stand.incidents()}
    begin_s, end_s = span(drive)
    for entry in latched:
        at_s = wall_s(str(entry["timestamp"]))
        first_s, last_s = max(begin_s, at_s - BEFORE_S), min(end_s, at_s + AFTER_S)
        holding = [
            folder
            for folder, (begun, ended) in spans.items()
            if begun <= first_s + TICK_S and ended >= last_s - 2 * TICK_S
        ]
        assert holding, (entry, spans)
        check = holding[0] / layout.INCIDENT_FILE
        assert layout.read_description(check)["drive"] == drive.name
    for folder in spans:
        check_equal(folder)


def span(folder: Path) -> tuple[float, float]:
    """Wall times of the first and the last tick."""
    drive = open_drive(folder)
    distance_ns = drive.info.clock.distance_ns
    stamps = [one.now_ns for one in drive.runs() if isinstance(one, TickRecord)]
    return (stamps[0] + distance_ns) / NS_PER_S, (stamps[-1] + distance_ns) / NS_PER_S


def test_a_killed_gateway_loses_at_most_one_tick(tmp_path: Path, figures: list[str]) -> None:
    with recorded_in(tmp_path) as (one, recorder):
        one.until_driving()
        time.sleep(2.0)
        one.gateway.stop(signal.SIGKILL)
        time.sleep(1.0)
        on_the_bus = [frame.data for frame in one.recording.commands()]
        assert recorder.stop() == 0
        (drive,) = stand_of(one).drives()
        sent = [one.input for one in open_drive(drive).runs() if isinstance(one, InputRecord)]
        recorded = [one.frame.data for one in sent if isinstance(one, NoteSent) and one.ok]
        figures.append(
            f"kill -9 of the gateway: {len(on_the_bus)} command frames on the bus,"
            f" {len(recorded)} recorded"
        )
        assert on_the_bus[: len(recorded)] == recorded[: len(on_the_bus)]
        assert len(on_the_bus) - len(recorded) <= 2
        check_equal(drive)


def test_a_killed_recorder_loses_at_most_a_second(tmp_path: Path, figures: list[str]) -> None:
    with recorded_in(tmp_path) as (one, recorder):
        stand = stand_of(one)
        one.until_driving()
        time.sleep(2.5)
        killed_ns = time.monotonic_ns()
        recorder.stop(signal.SIGKILL)
        again = stand.recorder()
        wait_until(lambda: one.client.health()["recorder"]["connected"], "the tap")
        time.sleep(2.0)
        one.let_go()
        assert one.gateway.stop() == 0
        assert again.stop() == 0
        found = [tick["tick"] for drive in stand.drives() for tick in recorded_ticks(drive)]
        lost_s = (killed_ns - max(stamp for stamp in found if stamp <= killed_ns)) / NS_PER_S
        figures.append(f"kill -9 of the recorder: lost {lost_s:.2f} s")
        assert lost_s <= 1.0 + TICK_S
        for drive in stand.drives():
            counted = account(drive)
            assert counted.recorded + counted.lost == counted.handed_on
            check_equal(drive)


def memory_kb(*processes: Process) -> list[int]:
    return [resident_kb(process.popen.pid or 0) for process in processes]


def undisturbed_s(one: Breaking, seconds: float) -> bool:
    """Let so much time go by; True where no tick was skipped meanwhile."""
    skipped = one.skipped()
    time.sleep(seconds)
    return one.skipped() == skipped


@contextlib.contextmanager
def frozen(disk: Path) -> Iterator[None]:
    """A disk that writes nothing, and fails nothing: whoever writes waits."""
    subprocess.run(["fsfreeze", "--freeze", disk], check=True)
    try:
        yield
    finally:
        subprocess.run(["fsfreeze", "--unfreeze", disk], check=True)


def fill(disk: Path) -> Path:
    """Leave no room; the file to remove."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as file:
        for size in (1 << 20, 1 << 12):
            with contextlib.suppress(OSError):
                while True:
                    file.write(bytes(size))
                    os.fsync(file.fileno())
    return filler


def test_a_disk_that_stalls_for_five_seconds_costs_no_tick_and_no_frame(
    tmp_path: Path, small_disk: Path, figures: list[str]
) -> None:
    with recorded_in(tmp_path, small_disk) as (one, recorder):
        one.until_driving()
        before_kb = memory_kb(one.gateway, recorder)
        tried = next(n for n in range(1, TRIES + 1) if stalls_unnoticed(one, small_disk))
        time.sleep(2.0)
        growth_kb = growth(before_kb, memory_kb(one.gateway, recorder))
        counted = account(drive := end(one, recorder))
        figures.append(
            f"disk stalled for {STALL_S:.0f} s, 0 ticks skipped (try {tried}): {counted};"
            f" memory {growth_kb} kB"
        )
        assert (counted.lost, counted.gaps) == (0, 0)
        assert counted.recorded == counted.handed_on
        assert growth_kb[0] <= GROWTH_MAX_KB
        check_equal(drive)


def stalls_unnoticed(one: Breaking, disk: Path) -> bool:
    """Have the disk stall; True where no tick was skipped meanwhile."""
    time.sleep(2.0)
    with frozen(disk):
        return undisturbed_s(one, STALL_S)


# That much memory holds what a disk does not take, a disk that stalls shows, too.
@pytest.mark.ci
@pytest.mark.parametrize(
    ("memory", "fits"),
    [
        pytest.param("32M", True, id="much memory"),
        pytest.param("16k", False, id="little memory"),
    ],
)
def test_a_full_disk_costs_no_tick_and_what_is_lost_is_told(
    tmp_path: Path, small_disk: Path, figures: list[str], memory: str, fits: bool
) -> None:
    with recorded_in(tmp_path, small_disk, "--memory-bytes", memory) as (one, recorder):
        stand = stand_of(one)
        one.until_driving()
        before_kb = memory_kb(one.gateway, recorder)
        filler = fill(small_disk)
        wait_until(lambda: stand.status().get("disk") == "full", "the disk to be full")
        tried = next(n for n in range(1, TRIES + 1) if undisturbed_s(one, STALL_S))
        growth_kb = growth(before_kb, memory_kb(one.gateway, recorder))
        filler.unlink()
        wait_until(lambda: stand.status().get("disk") == "ok", "the disk to have room")
        time.sleep(2.0)
        drive = end(one, recorder)
        counted = account(drive)
        figures.append(
            f"full disk for {STALL_S:.0f} s, {memory} of memory, 0 ticks skipped (try {tried}):"
            f" {counted}; memory {growth_kb} kB"
        )
        assert counted.recorded + counted.lost == counted.handed_on
        assert (counted.lost == 0) == fits
        assert growth_kb[0] <= GROWTH_MAX_KB
        check_equal(drive)


def growth(before: list[int], after: list[int]) -> list[int]:
    return [later - earlier for earlier, later in zip(before, after, strict=True)]
