"""What a power cut leaves of a recording: the guest is killed, its disk mounted by another one."""

import os
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.lab.powered import Powered, afterwards, make_disk
from tests.recorder.gateway import core_lines
from vcu_gateway.recording import layout

pytestmark = [
    pytest.mark.skipif("VCU_LAB" in os.environ, reason="inside the lab already"),
    pytest.mark.timeout(400),
]

DRIVE = (sys.executable, "-m", "tests.power_cut.drive_recorded", "/mnt")
NS_PER_S = 1_000_000_000
LOST_AT_MOST_S = 5.0
LOST_AFTER_LATCH_AT_MOST_S = 0.2
TICKS_A_SECOND = 20


class Cut(NamedTuple):
    """A power cut.

    Attributes:
        told_ns: stamps of the ticks that the recorder had been handed.
        latched_ns: stamp of the tick in which a fault latched; None without one.
        recorded_ns: stamps of the ticks that the next guest finds on the disk.
    """

    told_ns: list[int]
    latched_ns: int | None
    recorded_ns: list[int]

    @property
    def lost_s(self) -> float:
        """From the last tick on the disk to the last one that was handed over."""
        return (self.told_ns[-1] - self.recorded_ns[-1]) / NS_PER_S


def cut_after(folder: Path, ticks: int, latch_at: int = 0) -> Cut:
    """Cut the power so many ticks after the first one; a fault latches in that tick before."""
    disk = make_disk(folder / "disk.img")
    guest = Powered(disk, *DRIVE, str(latch_at))
    for _ in range(ticks):
        guest.until("")
    lines = [line.split() for line in guest.cut()]
    told = [int(words[1]) for words in lines if len(words) == 2 and words[0] in ("tick", "latched")]
    latched = [int(words[1]) for words in lines if words[0] == "latched"]
    assert not [words for words in lines if words[0] == "lost"]
    afterwards(disk, "cp", "-r", "/mnt/recordings", str(folder))
    return Cut(told, latched[0] if latched else None, recorded_ticks(folder / "recordings"))


def recorded_ticks(recordings: Path) -> list[int]:
    (drive,) = layout.recorded_folders(recordings / layout.DRIVES)
    lines = [line for segment in layout.segments(drive) for line in core_lines(segment)]
    return [line["tick"] for line in lines if "tick" in line]


@pytest.mark.parametrize("ticks", [130, 210])
def test_a_power_cut_loses_at_most_five_seconds(tmp_path: Path, ticks: int) -> None:
    cut = cut_after(tmp_path, ticks)
    print(f"lost {cut.lost_s:.2f} s of {len(cut.told_ns) / TICKS_A_SECOND:.1f} s")
    assert cut.lost_s <= LOST_AT_MOST_S
    assert len(cut.recorded_ns) > 0.9 * (len(cut.told_ns) - LOST_AT_MOST_S * TICKS_A_SECOND)


@pytest.mark.parametrize("after_latch", [5, 9, 30])
def test_a_power_cut_after_a_latched_fault_loses_at_most_200_ms(
    tmp_path: Path, after_latch: int
) -> None:
    cut = cut_after(tmp_path, 40 + after_latch, latch_at=40)
    print(f"lost {cut.lost_s * 1000:.0f} ms, {after_latch} ticks after the latched fault")
    assert cut.latched_ns is not None
    assert cut.lost_s <= LOST_AFTER_LATCH_AT_MOST_S
    assert cut.recorded_ns[-1] >= cut.latched_ns - NS_PER_S // TICKS_A_SECOND
