"""Frames lost, twice, out of order, wrong, or not taken: netem and tbf on a vcan0 with echo."""

import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.faults.conftest import Seen
from tests.faults.driving import MS, BusStand, Driving
from tests.vcan.conftest import wait_until
from vcu_gateway.bus.door import BusSettings, Door
from vcu_gateway.core.output import OutFrame

Disturb = Callable[[str], None]
WHOLE = "steps: []\n"
COMMAND = OutFrame("PCU1", 0x0008A7D0, bytes.fromhex("0c000000e02e0000"))
DISTURBED_S = 4
SEND_MAX_US = 1000


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


def test_f31_frames_that_come_twice_or_out_of_order_are_no_news(
    driving: Driving, disturb: Disturb, seen: Seen
):
    lines = len(driving.gateway.log())
    disturb("netem delay 20ms 10ms reorder 25% 50% duplicate 100%")
    time.sleep(DISTURBED_S)
    found = causes(driving, lines)
    state = driving.ended()
    driving.check_own_choice(lines)
    assert "life_signal BMS_Status.LifeSignal power limit" in found, "twice is no sign of life"
    assert any(one.startswith("foreign_sender") for one in found), "a copy is another sender's"
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
        time.sleep(DISTURBED_S)
        found = causes(driving, begin)
        stale = [one for one in found if one.startswith("stale IMU")]
        begin = len(driving.gateway.log())
        if not stale:
            break
    state = driving.ended()
    others = {one.partition(" ")[0] for one in found} - {"stale"}
    driving.check_own_choice(lines)
    assert state["bus"]["receiver_bugs"] == 0
    assert others <= {"late", "life_signal", "unconfirmed", "tick_late"}
    seen(
        f"{len(stale)} of the 10 ms messages stale in {DISTURBED_S} s; told, each by its rule: "
        f"{', '.join(sorted(set(found) - set(stale))) or 'nothing'}"
    )
    assert len(stale) <= 3, "a stall of the machine at most"


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
    disturb(how)
    door = Door(BusSettings("socketcan", "vcan0"), [COMMAND.can_id], lambda frame: None)
    door.open()
    door.admit()
    took_us = []
    for _ in range(200):
        begun_ns = time.monotonic_ns()
        door.send(COMMAND)
        took_us.append((time.monotonic_ns() - begun_ns) / 1000)
    slow_us = statistics.quantiles(took_us, n=10)[-1]
    sent, refused = door.counters.sent, door.counters.refused
    door.close()
    seen(
        f"{sent} frames queued, then {refused} of 200; sending takes "
        f"{statistics.median(took_us):.0f} us, one in ten more than {slow_us:.0f} us",
        reaction_ms=slow_us / 1000,
    )
    assert refused == {"ENOBUFS": 200 - sent}
    assert sent <= 8
    assert slow_us < SEND_MAX_US, "the slowest tenth is the machine's own stalls"


def test_f42_a_queue_that_stays_full_holds_up_no_tick_and_ends_in_a_fault(
    driving: Driving, disturb: Disturb, seen: Seen
):
    before = driving.client.health()
    disturb("tbf rate 1kbit burst 20 limit 100000")
    full_ns = time.time_ns()
    driving.until_mode("fault")
    fault_ms = driving.told_ms("fault_latched", full_ns)
    time.sleep(2)
    after = driving.client.health()
    refused = after["frames"]["unsent"]["ENOBUFS"] - before["frames"]["unsent"].get("ENOBUFS", 0)
    skipped = after["ticks"]["skipped"] - before["ticks"]["skipped"]
    queued_ns = time.time_ns()
    disturb("pfifo_fast")
    time.sleep(0.5)
    wait_until(lambda: len(driving.commands(queued_ns + 300 * MS)) > 3, "frames again")
    seen(
        f"fault within {fault_ms:.0f} ms; {refused} frames refused, {skipped} ticks skipped",
        reaction_ms=fault_ms,
    )
    assert refused >= 40
    assert skipped <= 3
