"""The controller's states, a queue that fills, and the adapter that is pulled out: on slcan."""

import time
from pathlib import Path

import pytest

from tests.faults.conftest import Seen
from tests.faults.driving import (
    MS,
    PATIENCE_S,
    ZERO_TORQUE,
    first_frames_ms,
    measured,
    set_up,
    stopped_within_ms,
    told,
)
from tests.faults.slcan.adapter import Adapter
from tests.faults.slcan.conftest import Adapted
from tests.vcan.conftest import Recorded, wait_until

# A busy machine has what is measured taken once more.
pytestmark = pytest.mark.timeout(300)

RETURN_MS = 1000
TICK_MS = 50 + 5


def test_f38_bus_off_is_known_though_sending_succeeds_and_the_bus_is_safe_when_it_is_back(
    driving: Adapted, adapter: Adapter, seen: Seen
):
    first_ms: list[float] = []

    def stop_ms() -> float:
        before = driving.client.health()["frames"]["sent"]
        off_ns = adapter.report("b000000")
        try:
            driving.until_mode("fault")
            fault_ms = driving.told_ms("fault_latched", off_ns)
            reason = str(driving.events("fault_latched")[-1]["reason"])
            time.sleep(1)
            taken = driving.client.health()["frames"]["sent"] - before
            assert driving.link() == "bus off"
            assert "bus off" in reason
        finally:
            back_ns = restart(adapter)
        first_ms.append(first_frames_ms(driving, back_ns))
        driving.until_link("up")
        assert driving.mode() == "fault"
        on_wire = driving.commands(off_ns, back_ns)
        late = driving.commands(off_ns + TICK_MS * MS)
        assert {frame.data for frame in late} == {ZERO_TORQUE}
        seen(
            f"although the kernel took {taken} frames meanwhile, of which {len(on_wire)} left, "
            f"fault; zero torque first when it was back, after {first_ms[-1]:.0f} ms; fault until "
            "reset"
        )
        return fault_ms

    found = measured(driving, 2 * TICK_MS, stop_ms)
    seen(f"fault after {told(found)}", reaction_ms=found[-1])
    assert min(first_ms) <= RETURN_MS


def restart(adapter: Adapter) -> int:
    """What mends an slcan adapter in bus-off; when, wall clock."""
    adapter.report("a000000")
    set_up(adapter.name, up=False)
    return set_up(adapter.name)


def test_f40_a_bus_that_takes_nothing_is_a_fault_and_no_frame_is_kept_for_later(
    driving: Adapted, adapter: Adapter, seen: Seen
):
    def stop_ms() -> float:
        before = driving.client.health()
        stuck_ns = adapter.stick()
        try:
            driving.until_mode("fault")
            fault_ms = driving.told_ms("fault_latched", stuck_ns)
            time.sleep(5)
            after = driving.client.health()
        finally:
            waited = wake(driving, adapter, stuck_ns)
        frames, at_first = after["frames"], before["frames"]
        refused = frames["unsent"]["ENOBUFS"] - at_first["unsent"].get("ENOBUFS", 0)
        taken = frames["sent"] - at_first["sent"]
        ticks = after["ticks"]["done"] - before["ticks"]["done"]
        assert {frame.data for frame in waited if not frame.data[1]} <= {ZERO_TORQUE}
        assert "own frames" in str(driving.events("cause_began")), "no confirmation: it is told"
        seen(
            f"in {ticks} ticks the kernel took {taken} frames, {refused} were refused, dropped and "
            f"counted; {len(waited)} came out when the bus went on"
        )
        assert refused >= 2 * ticks * 0.8
        assert len(waited) <= taken + 2
        return fault_ms

    found = measured(driving, 200 + 2 * TICK_MS, stop_ms)
    seen(f"fault after {told(found)}", reaction_ms=found[-1])


def wake(driving: Adapted, adapter: Adapter, stuck_ns: int) -> list[Recorded]:
    """Let the adapter read again; what had waited, as many as the kernel took meanwhile."""
    awake_ns = time.time_ns()
    adapter.reading = True
    driving.until_receiving()
    wait_until(lambda: len(driving.commands(awake_ns + 1000 * MS)) >= 4, "commands", PATIENCE_S)
    taken = [frame for frame in driving.near.commands() if stuck_ns < frame.stamp_ns < awake_ns]
    return driving.commands(awake_ns)[: len(taken)]


@pytest.mark.parametrize(
    "stuck_s", [3, pytest.param(30, marks=[pytest.mark.slow, pytest.mark.timeout(200)])]
)
def test_f41_what_a_peer_that_was_stuck_gets_afterwards_is_safe(
    driving: Adapted, adapter: Adapter, seen: Seen, stuck_s: int
):
    def driven_on() -> float:
        stuck_ns = adapter.stick()
        time.sleep(stuck_s)
        awake_ns = time.time_ns()
        waited = wake(driving, adapter, stuck_ns)
        assert not driving.commands(stuck_ns, awake_ns)
        late = driving.commands(awake_ns)
        driven = [frame for frame in late if frame.data[1]]
        seen(
            f"stuck for {stuck_s} s: {len(waited)} frames had waited, {len(driven)} of them with "
            f"throttle, of the first {len(driven) * 25} ms; then ZERO_TORQUE only"
        )
        assert {frame.data for frame in late[len(driven) :]} == {ZERO_TORQUE}
        return len(driven) * 25

    # 200 ms of the controllers' silence, and the tick that sees it.
    measured(driving, 250, driven_on)


def test_f47_an_adapter_that_is_pulled_out_and_plugged_in_again_is_used_within_a_second(
    driving: Adapted, adapter: Adapter, seen: Seen
):
    def return_ms() -> float:
        pulled_ns = adapter.unplug()
        try:
            driving.until_link("lost")
            driving.until_mode("fault")
            fault_ms = driving.told_ms("fault_latched", pulled_ns)
            lost_ms = driving.told_ms("link_lost", pulled_ns)
            time.sleep(1)
        finally:
            wait_until(lambda: not interface.exists(), "the interface to go", PATIENCE_S)
            adapter.plug()
            assert adapter.name == driving.stand.channel
            up_ns = adapter.up()
        receiving_ms = (driving.until_receiving() - up_ns) / MS
        first_ms = first_frames_ms(driving, up_ns)
        assert driving.mode() == "fault"
        seen(
            f"fault after {fault_ms:.0f} ms, by the carrier or the missing answers; the kernel "
            f"takes the interface away after {lost_ms:.0f} ms; plugged in and up: received again "
            f"within {receiving_ms:.0f} ms, zero torque first after {first_ms:.0f} ms, fault until "
            "reset"
        )
        return max(first_ms, receiving_ms)

    interface = Path("/sys/class/net", adapter.name)
    found = measured(driving, RETURN_MS, return_ms)
    seen(f"in use again after {told(found)}", reaction_ms=found[-1])


def test_f77_a_stuck_bus_goes_passive_then_off_and_stops_the_motors(
    driving: Adapted, adapter: Adapter, seen: Seen
):
    def stop_ms() -> float:
        begun = len(driving.events("link_state"))

        def told_states() -> list[str]:
            return [str(entry["state"]) for entry in driving.events("link_state")[begun:]]

        try:
            adapter.report("w096000")
            adapter.report("p128000")
            # Told after a tick: a bus-off before it would be told alone.
            wait_until(lambda: told_states()[-1:] == ["error passive"], "passive", PATIENCE_S)
            off_ns = adapter.report("b256000")
            driving.until_mode("fault")
            fault_ms = driving.told_ms("fault_latched", off_ns)
            time.sleep(0.5)
            gone_ns = time.time_ns()
        finally:
            back_ns = restart(adapter)
        first_ms = first_frames_ms(driving, back_ns)
        assert "error passive, bus off" in ", ".join(told_states())
        assert not driving.commands(gone_ns - 300 * MS, gone_ns), "nothing left meanwhile"
        seen(
            f"passive, then bus off: fault; zero torque first when the bus worked again, after "
            f"{first_ms:.0f} ms"
        )
        return fault_ms

    found = measured(driving, 2 * TICK_MS, stop_ms)
    seen(f"fault after {told(found)}", reaction_ms=found[-1])


# Passive counts for five seconds: after it none waits for throttle on this gateway.
def test_f37_the_controllers_states_are_told_and_passive_stops_after_a_second(
    driving: Adapted, adapter: Adapter, seen: Seen
):
    def stop_ms() -> float:
        try:
            adapter.report("w096000")
            driving.until_link("error warning")
            passive_ns = adapter.report("p128000")
            driving.until_mode("fault")
            assert driving.link() == "error passive"
            found_ms = stopped_within_ms(driving, passive_ns)
            assert found_ms > 1000
            return found_ms
        finally:
            adapter.report("a000000")
            driving.until_link("up")

    found = measured(driving, 1000 + 2 * TICK_MS, stop_ms)
    seen(f"warning reported; zero torque {told(found)} after passive", reaction_ms=found[-1])


def test_a_long_queue_is_told_with_the_command_that_mends_it_and_an_unproven_echo(
    shared: Adapted, adapter: Adapter
):
    adapter.unplug()
    shared.until_link("lost")
    adapter.plug()
    adapter.up(queue_frames=10)
    wait_until(lambda: shared.events("tx_queue_long") != [], "the caution")
    caution = shared.events("tx_queue_long")[-1]
    assert caution["frames"] == 10
    assert caution["command"] == f"ip link set {adapter.name} txqueuelen 4"
    # slcan sends our frames back before they left.
    wait_until(lambda: shared.events("echo_unproven") != [], "the unproven echo")
    told_ns = time.time_ns()
    wait_until(lambda: shared.near.commands()[-1].stamp_ns > told_ns, "frames to check")
    shared.check()
