"""Frames lost, twice, out of order, wrong, or not taken: netem and tbf on a vcan0 with echo."""

import functools
import itertools
import statistics
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Any, NamedTuple

import pytest

from tests.faults import reference_ticks
from tests.faults.conftest import Seen
from tests.faults.driving import MS, BusStand, Driving
from tests.vcan.conftest import wait_until
from vcu_gateway.api.results import StopState
from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.core.transmit import OutFrame

# A busy machine has what is measured taken once more.
pytestmark = [pytest.mark.ci, pytest.mark.timeout(300)]

Disturb = Callable[[str], None]
WHOLE = "steps: []\n"
COMMAND = OutFrame("PCU1", 0x0008A7D0, bytes.fromhex("0c000000e02e0000"))
DISTURBED_S = 4
SEND_MAX_US = 1000
IMU = (0x040AD079, 0x040BD079, 0x040CD079)


@pytest.fixture
def driving(alone: BusStand, disturb: Disturb) -> Iterator[Driving]:
    """With throttle on the bus, nothing disturbed yet, and the inertial unit speaking.

    Frames that nobody knows reach the gateway too.
    """
    del disturb
    alone.bus = ", kernel_filters: false"
    one = Driving(alone)
    one.until_serving()
    one.start_vehicle(WHOLE)
    one.until_driving()
    yield one
    one.let_go()


def causes(driving: Driving, since: int) -> list[str]:
    """Subject and effect of every cause since that line of the log."""
    log = [entry for entry in driving.gateway.log()[since:] if entry["event"] == "cause_began"]
    return [f"{entry['cause']} {entry['subject']} {entry['effect']}" for entry in log]


def counted(state: dict[str, Any]) -> int:
    """How many frames the counters tell of, each by what became of it."""
    counters = state["counters"]
    groups = (counters["rejected"], counters["confirmed"], counters["foreign_commands"])
    taken = sum(message["frame_count"] for message in state["messages"].values())
    return taken + counters["out_of_order"] + sum(sum(group.values()) for group in groups)


def _is_told(driving: Driving, lines: int, told: str) -> bool:
    return any(one.startswith(told) for one in causes(driving, lines))


def test_f31_frames_that_come_twice_or_out_of_order_are_no_news(
    driving: Driving, disturb: Disturb, seen: Seen
):
    lines = len(driving.gateway.log())
    disturb("netem delay 20ms 10ms reorder 25% 50% duplicate 100%")
    time.sleep(DISTURBED_S)
    # Twice is no sign of life, and a copy is another sender's.
    for told in ("life_signal BMS_Status.LifeSignal power limit", "foreign_sender"):
        wait_until(functools.partial(_is_told, driving, lines, told), told)
    state = driving.ended()
    driving.check_own_choice(lines)
    assert state["bus"]["receiver_bugs"] == 0
    assert counted(state) == state["bus"]["received"]
    seen(
        f"{state['bus']['received']} frames, each counted once; the battery's doubled frames "
        "limit the power, our own doubled ones count as another sender: latched"
    )


def test_f32_with_a_third_of_the_frames_lost_fast_messages_stay_fresh(
    driving: Driving, disturb: Disturb, seen: Seen
):
    lines = len(driving.gateway.log())
    disturb("netem loss 30%")
    begin = lines
    for _ in range(2):  # a stall of the machine makes them stale, too: once more
        skipped, begun_ns = driving.skipped(), time.time_ns()
        time.sleep(DISTURBED_S)
        found = causes(driving, begin)
        stale = [one for one in found if one.startswith("stale IMU")]
        begin = len(driving.gateway.log())
        stalls = driving.skipped() - skipped + pauses(driving, begun_ns)
        if not stale:
            break
    state = driving.ended()
    others = {one.partition(" ")[0] for one in found} - {"stale"}
    driving.check_own_choice(lines)
    assert state["bus"]["receiver_bugs"] == 0
    assert others <= {"late", "life_signal", "unconfirmed", "tick_late"}
    seen(
        f"{len(stale)} of the 10 ms messages stale in {DISTURBED_S} s, {stalls} stalls of the "
        "machine; reported, each by its rule: "
        f"{', '.join(sorted(set(found) - set(stale))) or 'nothing'}"
    )
    assert len(stale) <= 3 + 3 * stalls, "a stall of the machine at most"


def pauses(driving: Driving, since_ns: int) -> int:
    """How often the recorder, too, heard none of the inertial unit's messages for 80 ms."""
    frames = [frame for frame in driving.recording.frames() if frame.stamp_ns > since_ns]
    found = 0
    for can_id in IMU:
        stamps_ns = [frame.stamp_ns for frame in frames if frame.can_id == can_id]
        found += sum(b - a > 80 * MS for a, b in itertools.pairwise(stamps_ns))
    return found


def test_f33_frames_with_a_wrong_bit_each_do_no_harm_and_are_all_counted(
    driving: Driving, disturb: Disturb, seen: Seen
):
    lines = len(driving.gateway.log())
    disturb("netem corrupt 100%")
    time.sleep(DISTURBED_S)
    state = driving.ended()
    bus, rejected = state["bus"], state["counters"]["rejected"]
    driving.check_own_choice(lines)
    assert bus["receiver_bugs"] == 0
    assert not state["counters"]["blocked_by_gate"]
    # A command with a wrong length or a wrong kind counts twice: rejected, and foreign.
    assert bus["received"] <= counted(state) <= bus["received"] + sum(rejected.values())
    named = ", ".join(f"{reason} {count}" for reason, count in rejected.items() if count)
    seen(f"{bus['received']} frames, no exception; rejected: {named}; the gate blocked none")


@pytest.mark.parametrize(
    "how",
    ["tbf rate 1kbit burst 20 limit 100000", "netem delay 10s limit 3"],
    ids=["our share is full", "the queue is full"],
)
def test_f42_a_full_queue_costs_no_time_and_nothing_is_kept_for_later(
    disturb: Disturb, seen: Seen, how: str
):
    sent = [Sent.through(how, disturb)]
    if not sent[0].good:  # labs stall: once more, and both are told
        sent.append(Sent.through(how, disturb))
    seen(", then ".join(map(str, sent)), reaction_ms=sent[-1].slow_us / 1000)
    for one in sent:
        assert one.refused == {"ENOBUFS": 200 - one.taken}
    assert sent[-1].good, "the slowest tenth is the machine's own stalls"


class Sent(NamedTuple):
    """200 frames sent one after the other on a full queue."""

    taken: int
    refused: dict[str, int]
    usual_us: float
    slow_us: float

    @classmethod
    def through(cls, how: str, disturb: Disturb) -> "Sent":
        disturb("pfifo_fast")  # empty again
        disturb(how)
        connection = BusConnection(
            BusSettings("socketcan", "vcan0"), [COMMAND.can_id], lambda frame: None
        )
        connection.open()
        connection.start_sending()
        took_us = []
        for _ in range(200):
            begun_ns = time.monotonic_ns()
            connection.send(COMMAND)
            took_us.append((time.monotonic_ns() - begun_ns) / 1000)
        counters = connection.counters
        connection.close()
        slow_us = statistics.quantiles(took_us, n=10)[-1]
        return cls(counters.sent, dict(counters.refused), statistics.median(took_us), slow_us)

    @property
    def good(self) -> bool:
        return self.taken <= 8 and self.slow_us < SEND_MAX_US

    def __str__(self) -> str:
        return (
            f"{self.taken} frames queued, then {self.refused} of 200; sending takes "
            f"{self.usual_us:.0f} us, one in ten more than {self.slow_us:.0f} us"
        )


def test_f42_a_queue_that_stays_full_holds_up_no_tick_and_ends_in_a_fault(
    driving: Driving, disturb: Disturb, seen: Seen
):
    driving.start_vehicle()  # quiet: its own hundreds of frames that nobody takes cost the machine
    filled = [Filled.by(driving, disturb)]
    if not filled[0].good:  # labs stall: once more, and both are told
        filled.append(Filled.by(driving, disturb))
    seen(", then ".join(map(str, filled)), reaction_ms=filled[-1].fault_ms)
    assert filled[-1].good


class Filled(NamedTuple):
    """Four seconds, most of them with a full queue.

    Attributes:
        stalls: ticks that a bystander missed meanwhile; calm: that the gateway missed in the four
            seconds before.
    """

    fault_ms: float
    refused: int
    skipped: int
    stalls: int
    calm: int

    @classmethod
    def by(cls, driving: Driving, disturb: Disturb) -> "Filled":
        late_ticks = driving.stand.folder / "late_ticks"
        begin = driving.stand.held(functools.partial(reference_ticks.run, late_ticks, 4.0, 0.0005))
        driving.until_driving()
        calm = driving.skipped()
        time.sleep(4)
        calm = driving.skipped() - calm
        driving.until_driving()
        faults = len(driving.events("fault_latched"))
        before = driving.client.health()
        begin()
        full_ns = time.time_ns()
        disturb("tbf rate 1kbit burst 20 limit 100000")
        wait_until(lambda: len(driving.events("fault_latched")) > faults, "the fault")
        told = datetime.fromisoformat(str(driving.events("fault_latched")[faults]["timestamp"]))
        wait_until(late_ticks.exists, "the bystander")
        stalls = reference_ticks.skipped(late_ticks)
        late_ticks.unlink()
        after = driving.client.health()
        queued_ns = time.time_ns()
        disturb("pfifo_fast")
        wait_until(lambda: len(driving.commands(queued_ns + 800 * MS)) > 3, "frames again")
        return cls(
            fault_ms=told.timestamp() * 1000 - full_ns / MS,
            refused=after["frames"]["unsent"]["ENOBUFS"]
            - before["frames"]["unsent"].get("ENOBUFS", 0),
            skipped=after["ticks"]["skipped"] - before["ticks"]["skipped"],
            stalls=stalls,
            calm=calm,
        )

    @property
    def good(self) -> bool:
        return self.refused >= 40 and self.skipped <= 3 + 2 * (self.stalls + self.calm)

    def __str__(self) -> str:
        return (
            f"fault within {self.fault_ms:.0f} ms; {self.refused} frames refused, {self.skipped} "
            f"ticks skipped, {self.stalls} by a bystander, {self.calm} before"
        )


def test_a_stop_that_leads_nowhere_is_sent_and_never_on_the_bus(driving: Driving, disturb: Disturb):
    disturb("netem loss 100%")
    lost_ns = time.time_ns()
    driving.client.estop()
    stops = [one for _ in range(20) if (one := stop_soon(driving))]
    assert driving.commands(lost_ns + 10 * MS) == []
    assert {one["stage"] for one in stops} <= {"latched", "sent"}
    assert stops[-1]["sentence"] == "Stop sent; not seen on the bus for PCU1 and PCU2"
    for known in stops[-1]["controllers"].values():
        assert known["sent_ms"] is not None
        assert (known["echoed_ms"], known["obeyed"]) == (None, None)


def stop_soon(driving: Driving) -> StopState | None:
    time.sleep(0.05)
    return driving.client.state(())["stop"]
