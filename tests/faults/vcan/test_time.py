"""The wall clock is set while the vehicle drives."""

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import pytest

from tests.faults import judged_bus
from tests.faults.conftest import Seen
from tests.faults.driving import MS, PATIENCE_S, BusStand, Driving
from tests.faults.vcan.test_process import not_sent
from tests.vcan.conftest import Recorded, wait_until

# A busy machine has what is measured taken once more.
pytestmark = pytest.mark.timeout(300)

NS = 1_000_000_000
HOUR_NS = 3600 * NS
# A leap second that is inserted is a step of a second back.
STEPS_NS = {"+1 h": HOUR_NS, "-1 h": -HOUR_NS, "leap second": -NS, "+1 s": NS}
DRIVEN_S = 1.0
LEEWAY_NS = NS // 4


def distance_ns() -> int:
    """Wall clock minus monotonic, of the quickest of some readings: a process may be held up."""

    def reading() -> tuple[int, int]:
        begun_ns = time.monotonic_ns()
        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        ended_ns = time.monotonic_ns()
        return ended_ns - begun_ns, wall_ns - (begun_ns + ended_ns) // 2

    return min(reading() for _ in range(20))[1]


def set_distance(wanted_ns: int) -> None:
    time.clock_settime_ns(time.CLOCK_REALTIME, time.monotonic_ns() + wanted_ns)


@dataclass
class Clock:
    """The wall clock, which the test sets; right again at the end.

    Attributes:
        distances_ns: to the monotonic clock, one after the other.
        steps_ns: when each of them but the first began, monotonic.
    """

    distances_ns: list[int]
    steps_ns: list[int] = field(default_factory=list)

    def step_to(self, wanted_ns: int) -> None:
        self.steps_ns.append(time.monotonic_ns())
        set_distance(wanted_ns)
        self.distances_ns.append(distance_ns())

    def monotonic(self, frames: list[Recorded]) -> list[Recorded]:
        """The frames with stamps of the monotonic clock.

        A step has happened where a frame would else be from before the last one, or from after
        the step.
        """
        found: list[Recorded] = []
        at, last_ns = 0, 0
        for frame in frames:
            stamp_ns = frame.stamp_ns - self.distances_ns[at]
            while at < len(self.steps_ns) and not (
                last_ns - LEEWAY_NS < stamp_ns < self.steps_ns[at] + LEEWAY_NS
            ):
                at += 1
                stamp_ns = frame.stamp_ns - self.distances_ns[at]
            last_ns = stamp_ns
            found.append(frame._replace(stamp_ns=stamp_ns))
        assert at == len(self.steps_ns), "every step is in the recording"
        return found


@pytest.fixture
def clock() -> Iterator[Clock]:
    if os.environ.get("VCU_LAB") != "uml":
        pytest.skip("the clock is set only in a kernel that nobody else uses: LAB_WAY=uml")
    right_ns = distance_ns()
    yield Clock([right_ns])
    set_distance(right_ns)


@pytest.mark.ci
def test_f55_steps_of_the_wall_clock_change_neither_cadence_nor_torque(
    alone: BusStand, clock: Clock, seen: Seen
):
    one = Driving(alone)
    try:
        one.start_vehicle()
        drives = [stepped(one, clock)]
        if not drives[0].good:  # a stall of the machine stops it: once more, and both are told
            drives.append(stepped(one, clock))
    finally:
        one.let_go()
    frames = clock.monotonic(one.recording.frames())
    for drive in drives:
        driven = [f for f in frames if drive.begun_ns < f.stamp_ns < drive.ended_ns]
        checked = judged_bus.check(driven)
        throttles = {f.data[1] for f in driven if f.can_id in judged_bus.COMMANDS}
        assert checked.missing <= drive.missed
        assert checked.narrowest_ms >= 25
        assert checked.frames + 2 * drive.missed >= 2 * (len(STEPS_NS) + 2) * 15
        assert (driven[-1].stamp_ns - drive.begun_ns) / MS < 60_000, "the stamps were put right"
        seen(
            f"{', '.join(STEPS_NS)}, to 1970 and back while driving: {checked}, {drive.missed}"
            f" ticks without frames and {drive.calm} before, {drive.mode}"
        )
    assert drives[-1].is_punctual, drives
    if drives[-1].good:
        assert throttles == {51}, one.events("cause_began")[-5:]
    else:
        stood_still = [e for e in one.events("ticks_skipped") if int(str(e["skipped"])) >= 2]
        assert stood_still, one.events("cause_began")[-5:]


class Drive(NamedTuple):
    """One drive through all the steps, by the monotonic clock.

    Attributes:
        missed: ticks without frames; calm: as many as that in as long a time without steps.
    """

    begun_ns: int
    ended_ns: int
    missed: int
    calm: int
    mode: str
    faults: int

    @property
    def is_punctual(self) -> bool:
        return self.missed <= 2 * self.calm + 12

    @property
    def good(self) -> bool:
        return self.is_punctual and self.mode == "active" and not self.faults


def stepped(one: Driving, clock: Clock) -> Drive:
    one.until_driving()
    calm = not_sent(one)
    time.sleep(DRIVEN_S * (len(STEPS_NS) + 2))
    calm = not_sent(one) - calm
    one.until_driving()
    before, faults = not_sent(one), len(one.events("fault_latched"))
    begun_ns = time.monotonic_ns()
    for step_ns in STEPS_NS.values():
        clock.step_to(clock.distances_ns[-1] + step_ns)
        time.sleep(DRIVEN_S)
    right_ns = clock.distances_ns[-1]
    clock.step_to(60 * NS)  # a minute after 1970 began, and as long as it has run
    time.sleep(DRIVEN_S)
    clock.step_to(right_ns)  # and now it hears the time
    time.sleep(DRIVEN_S)
    ended_ns = time.monotonic_ns()
    missed, mode = not_sent(one) - before, one.mode()
    recorded = len(one.recording.frames())
    wait_until(lambda: len(one.recording.frames()) > recorded + 40, "the recorder", PATIENCE_S)
    faults = len(one.events("fault_latched")) - faults
    return Drive(begun_ns, ended_ns, missed, calm, mode, faults)
