"""The wall clock is set while the vehicle drives."""

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from tests.faults import invariants
from tests.faults.conftest import Seen
from tests.faults.driving import MS, BusStand, Driving
from tests.faults.vcan.test_process import not_sent
from tests.vcan.conftest import Recorded

NS = 1_000_000_000
HOUR_NS = 3600 * NS
# A leap second that is inserted is a step of a second back.
STEPS_NS = {"+1 h": HOUR_NS, "-1 h": -HOUR_NS, "leap second": -NS, "+1 s": NS}
DRIVEN_S = 1.0


def distance_ns() -> int:
    """Wall clock minus monotonic."""
    return time.clock_gettime_ns(time.CLOCK_REALTIME) - time.monotonic_ns()


def set_distance(wanted_ns: int) -> None:
    time.clock_settime_ns(time.CLOCK_REALTIME, time.monotonic_ns() + wanted_ns)


@dataclass
class Clock:
    """The wall clock, which the test sets; right again at the end.

    Attributes:
        distances_ns: to the monotonic clock, one after the other.
    """

    distances_ns: list[int]

    def step_to(self, wanted_ns: int) -> None:
        set_distance(wanted_ns)
        self.distances_ns.append(wanted_ns)

    def monotonic(self, frames: list[Recorded]) -> list[Recorded]:
        """The frames with stamps of the monotonic clock: each step shows as a jump of its size."""
        found, at = [], 0
        last_ns = None
        for frame in frames:
            stamp_ns = frame.stamp_ns
            if last_ns is not None and at + 1 < len(self.distances_ns):
                step_ns = self.distances_ns[at + 1] - self.distances_ns[at]
                at += abs(stamp_ns - last_ns - step_ns) < NS // 2
            last_ns = stamp_ns
            found.append(frame._replace(stamp_ns=stamp_ns - self.distances_ns[at]))
        assert at == len(self.distances_ns) - 1, "every step is in the recording"
        return found


@pytest.fixture
def clock() -> Iterator[Clock]:
    if os.environ.get("VCU_LAB") != "uml":
        pytest.skip("the clock is set only in a kernel that nobody else uses: LAB_WAY=uml")
    right_ns = distance_ns()
    yield Clock([right_ns])
    set_distance(right_ns)


def test_f55_steps_of_the_wall_clock_change_neither_cadence_nor_torque(
    alone: BusStand, clock: Clock, seen: Seen
):
    one = Driving(alone)
    try:
        one.start_vehicle()
        one.until_driving()
        before = not_sent(one)
        begun_ns = time.monotonic_ns()
        for step_ns in STEPS_NS.values():
            clock.step_to(clock.distances_ns[-1] + step_ns)
            time.sleep(DRIVEN_S)
        right_ns = clock.distances_ns[-1]
        clock.step_to(60 * NS)  # a minute after 1970 began, and as long as it has run
        time.sleep(DRIVEN_S)
        clock.step_to(right_ns)  # and now it hears the time
        time.sleep(DRIVEN_S)
        missed, mode = not_sent(one) - before, one.mode()
        ended_ns = time.monotonic_ns()
    finally:
        one.let_go()
    frames = clock.monotonic(one.recording.frames())
    driven = [f for f in frames if begun_ns < f.stamp_ns < ended_ns]
    checked = invariants.check(driven)
    throttles = {f.data[1] for f in driven if f.can_id in invariants.COMMANDS}
    stalled = [e for e in one.events("cause_began") if e.get("subject") == "tick"]
    if not stalled:
        assert (throttles, mode) == ({51}, "active"), one.events("cause_began")[-5:]
    assert checked.missing <= missed
    assert checked.narrowest_ms >= 25
    assert checked.frames >= 2 * (len(STEPS_NS) + 2) * 15
    assert (driven[-1].stamp_ns - begun_ns) / MS < 60_000, "the stamps were put right"
    seen(
        f"{', '.join(STEPS_NS)}, to 1970 and back while driving: {checked}, {missed} ticks"
        f" without frames, {mode} all the while"
    )
