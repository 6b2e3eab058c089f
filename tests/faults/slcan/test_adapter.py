"""The controller's states, a queue that fills, and the adapter that is pulled out: on slcan."""

import itertools
import time

import pytest

from tests.faults.conftest import Seen
from tests.faults.driving import (
    MS,
    ZERO_TORQUE,
    Driving,
    first_frames_ms,
    measured,
    set_up,
    stopped_within_ms,
    told,
)
from tests.faults.slcan.adapter import Adapter
from tests.vcan.conftest import Recorded, wait_until

RETURN_MS = 1000
TICK_MS = 50 + 5


def test_f37_the_controllers_states_are_told_and_passive_stops_after_a_second(
    driving: Driving, adapter: Adapter, seen: Seen
):
    def stop_ms() -> float:
        adapter.report("w096000")
        driving.until_link("error warning")
        passive_ns = adapter.report("p128000")
        driving.until_mode("fault")
        assert driving.link() == "error passive"
        found_ms = stopped_within_ms(driving, passive_ns)
        assert found_ms > 1000
        adapter.report("a000000")
        driving.until_link("up")
        return found_ms

    found = measured(driving, 1000 + 2 * TICK_MS, stop_ms)
    seen(f"warning told; zero torque {told(found)} after passive", reaction_ms=found[-1])


def test_f38_bus_off_is_known_though_sending_succeeds_and_the_bus_is_safe_when_it_is_back(
    driving: Driving, adapter: Adapter, seen: Seen
):
    before = driving.client.health()["frames"]
    off_ns = adapter.report("b000000")
    driving.until_mode("fault")
    fault_ms = driving.told_ms("fault_latched", off_ns)
    reason = str(driving.events("fault_latched")[-1]["reason"])
    time.sleep(1)
    after = driving.client.health()["frames"]
    taken = after["sent"] - before["sent"]
    assert driving.link() == "bus off"
    assert "bus off" in reason
    back_ns = restart(adapter)
    first_ms = first_frames_ms(driving, back_ns)
    driving.until_link("up")
    assert driving.mode() == "fault"
    on_wire = driving.commands(off_ns, back_ns)
    seen(
        f"fault after {fault_ms:.0f} ms although the kernel took {taken} frames meanwhile, of "
        f"which {len(on_wire)} left; "
        f"zero torque first when it was back, after {first_ms:.0f} ms; fault until reset",
        reaction_ms=fault_ms,
    )
    assert fault_ms <= 2 * TICK_MS
    assert {frame.data for frame in driving.commands(off_ns + TICK_MS * MS)} == {ZERO_TORQUE}
    assert first_ms <= RETURN_MS


def restart(adapter: Adapter) -> int:
    """What mends an slcan adapter in bus-off; when, wall clock."""
    adapter.report("a000000")
    set_up(adapter.name, up=False)
    return set_up(adapter.name)


def test_f40_a_bus_that_takes_nothing_is_a_fault_and_no_frame_is_kept_for_later(
    driving: Driving, adapter: Adapter, seen: Seen
):
    before = driving.client.health()["frames"]
    stuck_ns = adapter.stick()
    driving.until_mode("fault")
    fault_ms = driving.told_ms("fault_latched", stuck_ns)
    time.sleep(5)
    after = driving.client.health()["frames"]
    refused = after["unsent"]["ENOBUFS"] - before["unsent"].get("ENOBUFS", 0)
    taken = after["sent"] - before["sent"]
    waited = wake(driving, adapter)
    assert {frame.data for frame in waited if not frame.data[1]} <= {ZERO_TORQUE}
    assert "own frames" in str(driving.events("cause_began")), "the missing confirmation is told"
    seen(
        f"fault after {fault_ms:.0f} ms; in 5 s the kernel took {taken} frames, {refused} were "
        f"refused, dropped and counted; {len(waited)} came out when the bus went on",
        reaction_ms=fault_ms,
    )
    assert refused >= 5 * 2 * 20 * 0.8
    assert len(waited) <= taken + 2
    assert fault_ms <= 200 + 2 * TICK_MS


def wake(driving: Driving, adapter: Adapter) -> list[Recorded]:
    """Let the adapter read again; what had waited, which comes at once.

    It waited where the gateway cannot reach it, so the invariants do not hold of it.
    """
    awake_ns = time.time_ns()
    adapter.reading = True
    driving.until_receiving()
    waited = driving.commands(awake_ns)
    until_ns = next(
        (b.stamp_ns for a, b in itertools.pairwise(waited) if b.stamp_ns - a.stamp_ns > 20 * MS),
        time.time_ns(),
    )
    driving.foreign = lambda frame: awake_ns < frame.stamp_ns < until_ns
    return [frame for frame in waited if frame.stamp_ns < until_ns]


@pytest.mark.parametrize(
    "stuck_s", [3, pytest.param(30, marks=[pytest.mark.slow, pytest.mark.timeout(200)])]
)
def test_f41_what_a_peer_that_was_stuck_gets_afterwards_is_safe(
    driving: Driving, adapter: Adapter, seen: Seen, stuck_s: int
):
    stuck_ns = adapter.stick()
    time.sleep(stuck_s)
    awake_ns = time.time_ns()
    waited = wake(driving, adapter)
    time.sleep(0.5)
    assert not driving.commands(stuck_ns, awake_ns)
    late = driving.commands(awake_ns)
    driven = [frame for frame in late if frame.data[1]]
    seen(
        f"stuck for {stuck_s} s: {len(waited)} frames had waited, {len(driven)} of them with "
        f"throttle, of the first {len(driven) * 25} ms; then ZERO_TORQUE only"
    )
    assert {frame.data for frame in late[len(driven) :]} == {ZERO_TORQUE}
    # 200 ms of the controllers' silence, and the tick that sees it.
    assert len(driven) <= 2 * 5


def test_f47_an_adapter_that_is_pulled_out_and_plugged_in_again_is_used_within_a_second(
    driving: Driving, adapter: Adapter, seen: Seen
):
    pulled_ns = adapter.unplug()
    driving.until_link("lost")
    driving.until_mode("fault")
    fault_ms = driving.told_ms("fault_latched", pulled_ns)
    lost_ms = driving.told_ms("link_lost", pulled_ns)
    time.sleep(1)
    adapter.plug()
    assert adapter.name == driving.stand.channel
    up_ns = adapter.up()
    receiving_ms = (driving.until_receiving() - up_ns) / MS
    first_ms = first_frames_ms(driving, up_ns)
    assert driving.mode() == "fault"
    seen(
        f"fault after {fault_ms:.0f} ms, by the carrier or the missing answers; the kernel takes "
        f"the interface away after {lost_ms:.0f} ms; plugged in and up: received again within "
        f"{receiving_ms:.0f} ms, zero torque first after {first_ms:.0f} ms, fault until reset",
        reaction_ms=max(first_ms, receiving_ms),
    )
    assert max(first_ms, receiving_ms) <= RETURN_MS


def test_f77_a_stuck_bus_goes_passive_then_off_and_stops_the_motors(
    driving: Driving, adapter: Adapter, seen: Seen
):
    stuck_ns = time.time_ns()
    adapter.report("w096000")
    adapter.report("p128000")
    time.sleep(0.1)
    adapter.report("b256000")
    driving.until_mode("fault")
    fault_ms = driving.told_ms("fault_latched", stuck_ns)
    time.sleep(0.5)
    gone_ns = time.time_ns()
    first_ms = first_frames_ms(driving, restart(adapter))
    states = [str(entry["state"]) for entry in driving.events("link_state")]
    assert "error passive, bus off" in ", ".join(states)
    assert not driving.commands(gone_ns - 300 * MS, gone_ns), "nothing left meanwhile"
    seen(
        f"passive, then bus off: fault after {fault_ms:.0f} ms; zero torque first when the bus "
        f"was mended, after {first_ms:.0f} ms",
        reaction_ms=fault_ms,
    )
    assert fault_ms <= 100 + 2 * TICK_MS


def test_a_long_queue_is_told_with_the_command_that_mends_it_and_an_unproven_echo(
    driving: Driving, adapter: Adapter
):
    adapter.unplug()
    driving.until_link("lost")
    adapter.plug()
    adapter.up(queue_frames=10)
    wait_until(lambda: driving.events("tx_queue_long") != [], "the caution")
    caution = driving.events("tx_queue_long")[-1]
    assert caution["frames"] == 10
    assert caution["command"] == f"ip link set {adapter.name} txqueuelen 4"
    assert driving.events("echo_unproven") != [], "slcan sends our frames back before they left"
