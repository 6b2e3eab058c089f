"""How fast the real gateway stops the motors of the real simulator, by the kernel's stamps.

Every case has a recorder, a gateway and a vehicle of its own. A figure beyond its bound is
measured once more on a fresh run, and both are printed. A run in which the gateway missed ticks,
because the machine stalled, and that found such a figure, is printed and does not count.

What is marked for CI alone tests/faults/vcan shows on one gateway, by the same stamps: undervoltage
and cut (f15), a silent battery (f13), another sender (f74), a stopped process (f50).
"""

import contextlib
import functools
import itertools
import math
import re
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.vcan.conftest import (
    COMMANDS,
    Process,
    Recorded,
    Recording,
    Stand,
    ended_after,
    wait_until,
)

MS = 1_000_000
PERIOD_MS = 50
LEEWAY_MS = 5
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")
POWER_CUT = bytes.fromhex("8c000000e02e0000")
BMS_STATUS, PCU1_STATUS2, PCU2_STATUS2 = 0x1808D0F4, 0x0809D0A7, 0x0809D0A8
BENCH = """
bench:
  auto_arm: true
  demand: {bench_use_only: true, throttle_pct: 50, power_mode: normal}
"""
FOREIGN_THROTTLE_RAW = 231  # 90 %, which the bench demand never reaches
AFTERWARDS_FRAMES = 15  # of each controller, watched after the reaction
PATIENCE_S = 30.0
RUNS_AT_MOST = 5


# What breaks; at_s counts from the vehicle's start, and it drives less than two seconds later.
# The inertial unit is silent: it is nine tenths of the traffic, and the lab has one processor.
QUIET = """steps:
  - {at_s: 0, fault: silence, of: IMU}
"""
UNDERVOLTAGE_THEN_TOO_HOT = f"""{QUIET}
  - {{at_s: 3, for_s: 1.9, fault: set, signal: BMS_Status.CellUndervoltage, raw: 2}}
  - {{at_s: 6, fault: set, signal: BMS_Status.Overtemperature, raw: 2}}
"""
FOREIGN_SENDER = f"""{QUIET}
  - {{at_s: 3, for_s: 0.5, fault: foreign_sender, controller: PCU2, throttle_pct: 90}}
"""


@dataclass
class Run:
    """One case under way.

    The recording is read after the reaction: reading costs the lab's one processor.
    """

    stand: Stand
    recording: Recording
    gateway: Process
    vehicle: Process

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        wait_until(condition, f"{what}; the gateway: {self.gateway.err}", PATIENCE_S)

    def broke(self, fault: str) -> bool:
        """Whether the vehicle has told that this fault began."""
        return re.search(rf": {fault}\b.* begins", self.vehicle.err.read_text()) is not None

    def until_driving(self) -> None:
        def drives() -> bool:
            return drove(Bus(self.recording.frames()), time.time_ns())

        self.wait_for(drives, "throttle on the bus")

    def until_seen(self, since_ns: int, count: int) -> None:
        """Until each controller has had so many frames since then."""

        def are_there() -> bool:
            bus = Bus(self.recording.frames())
            since = ([f for f in bus.commands(c) if f.stamp_ns > since_ns] for c in (0, 1))
            return all(len(frames) >= count for frames in since)

        self.wait_for(are_there, f"{count} frames for each")

    def skipped_ticks(self) -> int:
        """Ticks that the gateway could not do because the machine stalled."""
        events = (entry for entry in self.gateway.log() if entry["event"] == "ticks_skipped")
        return sum(int(str(entry["skipped"])) for entry in events)

    def end(self) -> "Bus":
        """Everything that was on the bus."""
        for child in self.stand.children:
            child.popen.kill()
        return Bus(self.recording.frames())


@dataclass
class Bus:
    """What was on one bus from the beginning to the end."""

    frames: list[Recorded]

    def of(self, can_id: int) -> list[Recorded]:
        return [frame for frame in self.frames if frame.can_id == can_id]

    def commands(self, controller: int) -> list[Recorded]:
        """The gateway's own; what the foreign sender asks for is nobody else's throttle."""
        frames = self.of(COMMANDS[controller])
        return [frame for frame in frames if frame.data[1] != FOREIGN_THROTTLE_RAW]


class Reaction(NamedTuple):
    """How to measure a reaction, ms, and between what it must lie."""

    name: str
    measure: Callable[[Bus], float]
    bound_ms: float
    above_ms: float = 0.0

    def holds(self, found_ms: float) -> bool:
        return self.above_ms < found_ms <= self.bound_ms


@pytest.fixture
def stand_in() -> Callable[[Path], Stand]:
    """Makes the stand of one run; on another bus where a conftest beside the test says so."""
    return functools.partial(Stand, forking=True)


@pytest.fixture
def begin(tmp_path: Path, stand_in: Callable[[Path], Stand]) -> Iterator[Callable[[str], Run]]:
    """Begins a run with this scenario; the one before is over, the last one ends with the test."""
    with contextlib.ExitStack() as runs:

        def begin(scenario: str) -> Run:
            runs.close()
            folder = tmp_path / str(len(list(tmp_path.iterdir())))
            folder.mkdir()
            stand = runs.enter_context(ended_after(stand_in(folder)))
            recording = stand.record()
            gateway = stand.gateway(BENCH)
            wait_until(lambda: "link_open" in gateway.err.read_text(), "the gateway")
            return Run(stand, recording, gateway, stand.vehicle(scenario))

        yield begin


@pytest.fixture
def within(begin: Callable[[str], Run], figures: list[str]) -> Callable[..., Bus]:
    """Measure reactions to the last fault of a scenario; once more where one is too slow."""

    def within(scenario: str, last_fault: str, watched_s: float, *reactions: Reaction) -> Bus:
        found: dict[Reaction, list[float]] = {reaction: [] for reaction in reactions}
        stalls: list[int] = []
        left = 2
        while left and len(stalls) < RUNS_AT_MOST:
            run = begin(scenario)
            run.wait_for(functools.partial(run.broke, last_fault), last_fault)
            time.sleep(watched_s)
            run.until_seen(time.time_ns(), AFTERWARDS_FRAMES)
            bus = run.end()
            stalls.append(run.skipped_ticks())
            for reaction, all_ms in found.items():
                all_ms.append(reaction.measure(bus))
            early = [one for one, ms in found.items() if ms[-1] <= one.above_ms]
            assert not early or stalls[-1], "not before the deadline"
            left -= stalls[-1] == 0
            if all(reaction.holds(ms[-1]) for reaction, ms in found.items()):
                break
        wrong = []
        for reaction, all_ms in found.items():
            each = zip(all_ms, stalls, strict=True)
            told = ", then ".join(f"{ms:.1f} ms ({n} ticks skipped)" for ms, n in each)
            figures.append(f"{reaction.name}: {told}; at most {reaction.bound_ms} ms")
            wrong += [] if any(map(reaction.holds, all_ms)) else [figures[-1]]
        assert not wrong
        return bus

    return within


def reaction_ms(bus: Bus, caused_ns: int, until_ns: float = math.inf) -> float:
    """From the cause to the later of both controllers' first ZERO_TORQUE; only such follow.

    Infinite where the vehicle did not drive when it came: the machine stalled before.
    """
    return safe_after_ms(bus, caused_ns, until_ns) if drove(bus, caused_ns) else math.inf


def safe_after_ms(
    bus: Bus, caused_ns: int, until_ns: float = math.inf, safe: bytes = ZERO_TORQUE
) -> float:
    """As `reaction_ms`, for any safe frame, whether it drove or not."""
    first_ns = []
    for controller in (0, 1):
        frames = [f for f in bus.commands(controller) if caused_ns < f.stamp_ns < until_ns]
        follow = list(itertools.dropwhile(lambda frame: frame.data != safe, frames))
        assert {frame.data for frame in follow} == {safe}, "it stays safe"
        assert len(follow) >= AFTERWARDS_FRAMES
        first_ns.append(follow[0].stamp_ns)
    return (max(first_ns) - caused_ns) / MS


def drove(bus: Bus, until_ns: int) -> bool:
    """Both controllers had throttle in the last frame until then."""
    before = [[f for f in bus.commands(c) if f.stamp_ns <= until_ns] for c in (0, 1)]
    return all(frames and frames[-1].data[1] > 0 for frames in before)


def shows(can_id: int, byte: int, bits: int) -> Callable[[Bus], int]:
    """When the first frame came that has one of these bits."""
    return lambda bus: next(f.stamp_ns for f in bus.of(can_id) if f.data[byte] & bits)


UNDERVOLTAGE = shows(BMS_STATUS, 5, 0b1100)
OVERTEMPERATURE = shows(BMS_STATUS, 6, 0b1100)


@pytest.mark.ci
def test_undervoltage_stops_both_motors_within_one_tick_and_a_cut_cause_cuts_the_power(within):
    def stop_ms(bus: Bus) -> float:
        caused_ns = UNDERVOLTAGE(bus)
        return reaction_ms(bus, caused_ns, OVERTEMPERATURE(bus))

    def cut_ms(bus: Bus) -> float:
        return safe_after_ms(bus, OVERTEMPERATURE(bus), safe=POWER_CUT)

    bus = within(
        UNDERVOLTAGE_THEN_TOO_HOT,
        "set signal BMS_Status.Overtemperature",
        1.0,
        Reaction("undervoltage 2", stop_ms, PERIOD_MS + LEEWAY_MS),
        Reaction("overtemperature 2", cut_ms, PERIOD_MS + LEEWAY_MS),
    )
    well = [f for f in bus.of(BMS_STATUS) if f.stamp_ns < OVERTEMPERATURE(bus)][-1]
    assert well.data[5] & 0b1100 == 0, "the fault stayed although the battery said all is well"


@pytest.mark.parametrize(
    ("node", "can_id", "silence_ms"),
    [
        ("PCU1", PCU1_STATUS2, 200),
        pytest.param("PCU2", PCU2_STATUS2, 200, marks=pytest.mark.ci),
        pytest.param("BMS", BMS_STATUS, 1600, marks=pytest.mark.ci),
    ],
)
def test_silence_stops_both_motors_within_its_deadline_and_one_tick(
    within, node: str, can_id: int, silence_ms: int
):
    def stop_ms(bus: Bus) -> float:
        return reaction_ms(bus, bus.of(can_id)[-1].stamp_ns)

    bound_ms = silence_ms + PERIOD_MS + LEEWAY_MS
    reaction = Reaction(f"{node} silent", stop_ms, bound_ms, above_ms=silence_ms)
    scenario = f"{QUIET}\n  - {{at_s: 3.03, fault: silence, of: {node}}}"
    within(scenario, f"silence of {node}", silence_ms / 1000 + 0.7, reaction)


@pytest.mark.ci
def test_another_sender_of_a_command_stops_both_motors_and_latches(within):
    def foreign(bus: Bus) -> list[Recorded]:
        return [f for f in bus.of(COMMANDS[1]) if f.data[1] == FOREIGN_THROTTLE_RAW]

    def stop_ms(bus: Bus) -> float:
        caused_ns = foreign(bus)[0].stamp_ns
        return reaction_ms(bus, caused_ns)

    reaction = Reaction("foreign sender", stop_ms, PERIOD_MS + LEEWAY_MS)
    bus = within(FOREIGN_SENDER, "foreign_sender", 2.2, reaction)
    gone_ns = bus.commands(1)[-1].stamp_ns - foreign(bus)[-1].stamp_ns
    assert gone_ns > 1200 * MS, "zero torque long after the other has gone"


@pytest.mark.ci
def test_a_gateway_that_was_stopped_for_a_second_goes_on_with_zero_torque_and_no_burst(begin):
    run = begin(QUIET)
    run.until_driving()
    run.gateway.popen.send_signal(signal.SIGSTOP)
    time.sleep(0.5)
    held_ns = time.time_ns()
    time.sleep(0.5)
    run.gateway.popen.send_signal(signal.SIGCONT)
    run.until_seen(held_ns, AFTERWARDS_FRAMES)
    bus = run.end()
    assert drove(bus, held_ns)
    for controller in (0, 1):
        after = [frame for frame in bus.commands(controller) if frame.stamp_ns > held_ns]
        assert after[0].stamp_ns > held_ns + 400 * MS, "it was really stopped"
        assert len(after) >= AFTERWARDS_FRAMES
        assert {frame.data for frame in after} == {ZERO_TORQUE}
        gaps_ms = [(b.stamp_ns - a.stamp_ns) / MS for a, b in itertools.pairwise(after)]
        assert min(gaps_ms) >= PERIOD_MS / 2
