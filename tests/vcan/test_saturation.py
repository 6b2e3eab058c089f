"""A full bus of 1 Mbit/s whose every frame is for us: the ticking thread reads them all.

The kernel's own drop counter judges. A run in which the gateway missed ticks, because the machine
stalled, and that lost frames, is printed and does not count.
"""

import functools
import json
import os
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.faults.flood import EFF, Flood, poured
from tests.vcan.conftest import PATIENCE_S, Stand, ended_after, wait_until

FULL_PER_S = 7_600
LEVEL = bytes.fromhex("a81ea81ea81e0000")
IMU = tuple((EFF | can_id, LEVEL) for can_id in (0x040AD079, 0x040BD079))
NAMES = ("IMU_Acceleration", "IMU_AngularRate")
RUNS_AT_MOST = 5
SPELL_S = 0.4
LONG_S = int(os.environ.get("VCU_SATURATION_S", "60"))


class Outcome(NamedTuple):
    """Frames of one run, and ticks that the machine took from the gateway."""

    flooded: int
    received: int
    dropped: int
    skipped: int
    per_s: float

    def __str__(self) -> str:
        return (
            f"{self.flooded} frames, {self.per_s:.0f}/s: {self.dropped} dropped,"
            f" {self.skipped} ticks skipped"
        )


def flooded(folder: Path, duration_s: float, times: int) -> Outcome:
    """A gateway that hears nothing, then a full bus; so many times."""
    folder.mkdir()
    state_path, counts = folder / "state.json", Counter[int]()
    with ended_after(Stand(folder, forking=True)) as stand:
        gateway = stand.gateway("", "--state-out", str(state_path))
        wait_until(lambda: gateway.has_logged("link_open"), "the gateway")
        floods: list[tuple[Callable[[], None], Path]] = []
        for number in range(times):
            path = folder / f"counts-{number}"
            pour = functools.partial(Flood(IMU, FULL_PER_S, duration_s).pour, path)
            floods.append((stand.held(pour), path))
        busy_s = 0.0
        for begin, path in floods:
            time.sleep(0.3)
            begun_s = time.monotonic()
            begin()
            wait_until(path.exists, "the end of the flood", duration_s + PATIENCE_S)
            counts.update(poured(path))
            busy_s += time.monotonic() - begun_s
        assert gateway.stop() == 0
    state = json.loads(state_path.read_text())
    bus, messages = state["bus"], [state["messages"][name] for name in NAMES]
    # Both clocks are read at every reading, to some microseconds; frames of a batch are closer.
    received = sum(one["frame_count"] for one in messages) + state["counters"]["out_of_order"]
    flood = sum(counts.values())
    assert bus["received"] + bus["dropped"] == flood + bus["sent"], "each is here or there"
    return Outcome(
        flood,
        received,
        bus["dropped"],
        state["ticks"]["skipped"],
        flood / busy_s,
    )


def none_lost(tmp_path: Path, figures: list[str], name: str, duration_s: float, times: int) -> None:
    """Measure until nothing was lost or nothing but the program can have lost it."""
    for number in range(RUNS_AT_MOST):
        outcome = flooded(tmp_path / str(number), duration_s, times)
        figures.append(f"{name}: {outcome}")
        if not outcome.dropped or not outcome.skipped:
            break
    assert outcome.dropped == 0, figures
    assert outcome.received == outcome.flooded


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "duration_s", [3, pytest.param(LONG_S, marks=[pytest.mark.slow, pytest.mark.timeout(900)])]
)
def test_a_bus_that_stays_full_loses_no_frame(tmp_path: Path, figures: list[str], duration_s: int):
    none_lost(tmp_path, figures, f"full for {duration_s} s", duration_s, times=1)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("times", [3, pytest.param(10, marks=pytest.mark.ci)])
def test_a_quiet_bus_that_becomes_full_at_once_loses_no_frame(
    tmp_path: Path, figures: list[str], times: int
):
    none_lost(tmp_path, figures, f"quiet to full {times} times", SPELL_S, times)
