"""Pedals on CAN on a real bus: from the frame of the pedals to that of the controllers.

By the kernel's stamps of a recorder that is a process of its own.
"""

import itertools
import random
import statistics
import time
from collections.abc import Iterator

import pytest

from tests.vcan.conftest import COMMANDS, Stand, ended_after
from tests.vcan.pedal_node import PRESSED, RELEASED, SLACK_MS, PedalDrive, configured, followed
from tests.vcan.test_api import begin

PRESSES = 40


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PedalDrive]:
    with ended_after(Stand(tmp_path_factory.mktemp("pedals"), forking=True)) as stand:
        yield begin(stand, configured(stand.folder), kind=PedalDrive)


@pytest.mark.ci
def test_the_next_tick_follows_the_foot_down_and_up(drive: PedalDrive, figures: list[str]):
    """The first tick that begins after the frame reads it: a period at most, and the sending."""
    drive.until_armed()
    since_ns, phase = time.time_ns(), random.Random(7)
    for _ in range(PRESSES):
        for travel_pct in (RELEASED, PRESSED):
            drive.press(travel_pct)
            time.sleep(phase.uniform(0.105, 0.155))
    drive.press(RELEASED)
    drive.until_let_go(time.time_ns())

    frames = [frame for frame in drive.pedal_frames() if frame.stamp_ns > since_ns]
    moves = [
        (after, drive.is_pressed(after))
        for before, after in itertools.pairwise(frames)
        if drive.is_pressed(before) != drive.is_pressed(after)
    ]
    assert len(moves) == 2 * PRESSES
    for throttle, name in ((True, "foot down to throttle"), (False, "foot up to throttle 0")):
        found = []
        for can_id in COMMANDS:
            own = [frame for frame in drive.recording.commands() if frame.can_id == can_id]
            for moved, pressed in moves:
                if pressed == throttle:
                    took_ms, period_ms = followed(moved, own, throttle=throttle)
                    assert took_ms <= period_ms + SLACK_MS, name
                    found.append(took_ms)
        p99_ms = statistics.quantiles(found, n=100, method="inclusive")[98]
        figures.append(
            f"{name}: p50 {statistics.median(found):.1f} ms, p99 {p99_ms:.1f} ms,"
            f" {PRESSES} times for each controller"
        )
