"""The link goes, comes back, is somebody else's: on a real vcan0."""

import time
from collections.abc import Callable

import pytest

from tests.faults.conftest import Seen
from tests.faults.driving import (
    MS,
    PATIENCE_S,
    ZERO_TORQUE,
    BusStand,
    Driving,
    first_frames_ms,
    measured,
    record,
    set_up,
    stopped_within_ms,
    told,
    undisturbed,
)
from tests.faults.flood import EFF, ERR, send
from tests.vcan.conftest import COMMANDS, Process, Recorded, ip, program, wait_until

RETURN_MS = 1000
TICK_MS = 50 + 5
FOREIGN_THROTTLE_RAW = 231
CONTROLLER, BUS_OFF, RESTARTED = ERR | 0x004, ERR | 0x040, ERR | 0x100
WARNING, PASSIVE, ACTIVE = 0x08, 0x20, 0x40
pytestmark = pytest.mark.timeout(300)  # for a machine that stalls again and again


def error(can_id: int, controller_bits: int = 0) -> tuple[int, bytes]:
    return can_id, bytes([0, controller_bits, 0, 0, 0, 0, 0, 0])


def test_f45_a_link_that_goes_down_and_up_is_used_again_within_a_second_unarmed(
    driving: Driving, seen: Seen
):
    before_ns = time.time_ns()
    down_ns = set_up("vcan0", up=False)
    driving.until_link("lost")
    driving.until_mode("fault")
    time.sleep(1)
    still_down_ns = time.time_ns()
    up_ns = set_up("vcan0")
    receiving_ms = (driving.until_receiving() - up_ns) / MS
    first_ms = first_frames_ms(driving, still_down_ns)
    assert not driving.commands(down_ns, still_down_ns), "nothing leaves meanwhile"
    assert driving.mode() == "fault", "latched: a reset and a new arming are needed"
    assert driving.told_ms("link_lost", before_ns) < RETURN_MS
    assert "is down" in str(driving.events("link_lost")[-1]["reason"])
    seen(
        f"zero torque from the first frame {first_ms:.0f} ms after the link was up, received "
        f"again within {receiving_ms:.0f} ms, fault until reset",
        reaction_ms=max(first_ms, receiving_ms),
    )
    assert max(first_ms, receiving_ms) <= RETURN_MS


def test_f45_a_link_that_was_down_for_a_moment_only_is_latched_all_the_same(
    driving: Driving, seen: Seen
):
    losses = len(driving.events("link_lost"))
    down_ns = set_up("vcan0", up=False)
    up_ns = set_up("vcan0")
    driving.until_mode("fault")
    first_ms = first_frames_ms(driving, up_ns)
    wait_until(lambda: len(driving.events("link_lost")) > losses, "the word")
    assert len(driving.events("link_lost")) == losses + 1
    seen(
        f"down for {(up_ns - down_ns) / MS:.1f} ms: latched, zero torque {first_ms:.0f} ms later",
        reaction_ms=first_ms,
    )
    assert first_ms <= RETURN_MS


def test_f46_an_interface_made_again_is_opened_within_a_second_unarmed(
    driving: Driving, seen: Seen
):
    ip("link", "del", "vcan0")
    down_ns = time.time_ns()
    driving.until_link("lost")
    driving.until_mode("fault")
    assert driving.vehicle is not None
    driving.vehicle.popen.wait(PATIENCE_S)
    time.sleep(1)
    add("vcan0")
    up_ns = time.time_ns()
    set_up("vcan0")
    driving.start_vehicle()
    first_ms = first_frames_ms(driving, up_ns)
    driving.until_receiving()
    assert not driving.commands(down_ns, up_ns)
    assert driving.mode() == "fault"
    driving.until_driving()
    seen(
        f"a new socket: zero torque from the first frame {first_ms:.0f} ms after the link was "
        "made, fault until reset, then it drives",
        reaction_ms=first_ms,
    )
    assert first_ms <= RETURN_MS


def test_f48_a_renamed_interface_is_told_with_its_new_name_and_found_again(
    driving: Driving, seen: Seen
):
    def reason() -> str:
        return str(driving.client.health()["link"]["lost"])

    set_up("vcan0", up=False)
    ip("link", "set", "vcan0", "name", "vcan7")
    try:
        set_up("vcan7")
        wait_until(lambda: "vcan7" in reason(), "the word")
        time.sleep(0.5)
        renamed_ns, word = time.time_ns(), reason()
        time.sleep(0.5)
        assert not driving.commands(renamed_ns), "nothing is sent on an interface not configured"
    finally:
        set_up("vcan7", up=False)
        ip("link", "set", "vcan7", "name", "vcan0")
        back_ns = time.time_ns()
        set_up("vcan0")
    first_ms = first_frames_ms(driving, back_ns)
    seen(
        f"'{word}', silent; under its old name again: zero torque after {first_ms:.0f} ms",
        reaction_ms=first_ms,
    )
    assert first_ms <= RETURN_MS


def test_f39_a_bus_that_goes_off_and_restarts_ten_times_a_second_stays_latched(
    driving: Driving, seen: Seen
):
    lines = 0

    def stop_ms() -> float:
        nonlocal lines
        before, begun_ns = driving.lines(), time.time_ns()
        for _ in range(40):
            send(error(BUS_OFF))
            time.sleep(0.01)
            send(error(RESTARTED))
            time.sleep(0.09)
        assert driving.mode() == "fault"
        found_ms = stopped_within_ms(driving, begun_ns)
        lines = driving.lines() - before
        return found_ms

    found = measured(driving, 2 * TICK_MS, stop_ms)
    seen(
        f"40 bus-offs of 10 ms: zero torque after {told(found)} and ever after, latched, "
        f"{lines} lines of log",
        reaction_ms=found[-1],
    )
    assert lines <= 40


# At the start.


def test_f43_a_missing_interface_is_told_and_opened_when_it_appears(alone: BusStand, seen: Seen):
    reason = "cannot open socketcan vcan8: no such interface; for a bench: ip link add dev vcan8"

    def mend() -> None:
        add("vcan8")
        set_up("vcan8")

    first_ms = started_without(alone, reason, mend)
    seen(
        f"runs, says `ip link add`; zero torque {first_ms:.0f} ms after the interface was there, "
        "1000 of them listening",
        reaction_ms=first_ms - 1000,
    )


def test_f44_an_interface_that_is_down_is_as_good_as_missing(alone: BusStand, seen: Seen):
    add("vcan8")
    reason = "vcan8 is down; ip link set vcan8 up"
    first_ms = started_without(alone, reason, lambda: set_up("vcan8"))
    seen(
        f"runs, says `ip link set up`; zero torque {first_ms:.0f} ms after it was up, "
        "1000 of them listening",
        reaction_ms=first_ms - 1000,
    )


def add(name: str) -> None:
    ip("link", "add", "dev", name, "type", "vcan")


def started_without(stand: BusStand, reason: str, mend: Callable[[], object]) -> float:
    """Start, look at what is told, mend it; ms from then until the first command frame."""
    stand.channel = "vcan8"
    recording = record(stand)
    gateway = stand.gateway()
    try:
        wait_until(lambda: gateway.has_logged("link_unavailable"), "the word")
        time.sleep(1)
        events = [one for one in gateway.log() if str(one["event"]).startswith("link")]
        assert [str(one["reason"])[: len(reason)] for one in events] == [reason], "told once"
        begun_ns = time.time_ns()
        mend()
        mended_ns = time.time_ns()
        wait_until(lambda: len(recording.commands()) >= 8, "command frames")
        assert {frame.data for frame in recording.commands()} == {ZERO_TORQUE}
        first_ns = recording.commands()[0].stamp_ns
        found_ms = (first_ns - mended_ns) / MS
        assert first_ns - begun_ns >= 1000 * MS, "it listens first, from the opening on"
        assert found_ms <= 1000 + RETURN_MS
        assert gateway.stop() == 0
    finally:
        ip("link", "del", "vcan8")
    return found_ms


def test_f48_an_interface_that_is_no_can_is_told_in_a_clear_sentence(alone: BusStand, seen: Seen):
    alone.channel = "lo"
    gateway = alone.gateway()
    wait_until(lambda: gateway.has_logged("link_unavailable"), "the word")
    reason = str(gateway.logged("link_unavailable")["reason"])
    assert reason.startswith("cannot open socketcan lo: it is no CAN interface; ")
    assert gateway.stop() == 0
    seen(f"'{reason.partition(';')[0]}'")


@pytest.mark.ci
def test_f48_error_frames_without_data_as_of_a_wrong_bit_rate_arm_nothing(
    alone: BusStand, seen: Seen
):
    recording = record(alone)
    gateway = alone.gateway("bench: {auto_arm: true, demand: {bench_use_only: true}}\n")
    recording.wait_for(lambda frames: len(recording.commands()) >= 2, "command frames")
    for _ in range(20):
        send(error(ERR | 0x088), error(CONTROLLER, PASSIVE))
        time.sleep(0.1)
    assert gateway.stop() == 0
    assert gateway.logged("link_state")["state"] == "error passive"
    after = [entry["after"] for entry in gateway.log() if entry["event"] == "mode_changed"]
    assert set(after) <= {"stopping"}, "never out of starting"
    assert {frame.data for frame in recording.commands()} == {ZERO_TORQUE}
    seen("'error passive' reported, starting for ever, zero torque only")


@pytest.mark.ci
def test_f73_a_gateway_that_hears_another_one_while_listening_stays_silent(
    alone: BusStand, seen: Seen
):
    recording = record(alone)
    gateway = alone.gateway()
    wait_until(lambda: gateway.has_logged("link_open"), "the gateway")
    for _ in range(60):
        send((EFF | COMMANDS[1], ZERO_TORQUE))
        time.sleep(0.05)
    spoken_ns = time.time_ns()
    recording.wait_for(lambda frames: len(recording.commands()) >= 62, "its own frames")
    commands = recording.commands()
    assert commands[59].stamp_ns < spoken_ns, "only the other one's frames"
    assert commands[60].stamp_ns > spoken_ns, "only the other one's frames"
    silent_ms = (commands[60].stamp_ns - commands[59].stamp_ns) / MS
    assert gateway.stop() == 0
    seen(f"silent for the 3 s that the other was heard, and {silent_ms:.0f} ms more")
    assert silent_ms >= 1000


# Somebody else.


def second_gateway(driving: Driving) -> Process:
    """One more on the same interface, with another API."""
    path = driving.stand.folder / "second.yaml"
    path.write_text(
        f"bus: {{channel: vcan0}}\napi: {{socket_path: {driving.stand.folder}/second.sock}}\n"
    )
    return driving.stand.start("second", *program("run", "-c", str(path)))


def test_f73_a_second_gateway_on_the_interface_is_refused_and_the_first_drives_on(
    driving: Driving, seen: Seen
):
    def refused() -> str:
        begun_ns = time.time_ns()
        second = second_gateway(driving)
        assert second.popen.wait(PATIENCE_S) == 69
        error_line = next(line for line in second.err.read_text().splitlines() if "error:" in line)
        assert "commands on vcan0 already" in error_line
        ended_ns = time.time_ns()
        wait_until(lambda: len(driving.commands(ended_ns)) >= 8, "command frames", PATIENCE_S)
        assert driving.mode() == "active"
        assert {f.data[1] for f in driving.commands(begun_ns)} == {51}
        return error_line

    error_line = undisturbed(driving, refused)
    seen(f"exit code 69, '{error_line.partition(';')[0]}'; the first one drives on")


def others(frame: Recorded) -> bool:
    return frame.data[1] == FOREIGN_THROTTLE_RAW


@pytest.mark.parametrize(
    "controller",
    [pytest.param(0, id="PCU1"), pytest.param(1, id="PCU2", marks=pytest.mark.ci)],
)
def test_f74_a_command_frame_of_another_node_stops_both_and_latches(
    driving: Driving, seen: Seen, controller: int
):
    driving.foreign = others
    theirs = bytes([0x04, FOREIGN_THROTTLE_RAW, 0, 0, 0xE0, 0x2E, 0x60, 0xEA])
    frame = (EFF | COMMANDS[controller], theirs)
    found = measured(driving, TICK_MS, lambda: foreign_sender_stops_ms(driving, frame))
    seen(f"PCU{controller + 1}: zero torque after {told(found)}, latched", reaction_ms=found[-1])


def test_f76_even_zero_torque_of_another_node_stops_both_and_latches(driving: Driving, seen: Seen):
    frame = (EFF | COMMANDS[0], ZERO_TORQUE)
    found = measured(driving, TICK_MS, lambda: foreign_sender_stops_ms(driving, frame))
    seen(f"zero torque for both after {told(found)}, latched", reaction_ms=found[-1])


def test_f75_the_own_echo_changes_nothing_and_a_copy_by_another_socket_is_another_sender(
    driving: Driving, seen: Seen
):
    before = driving.client.health()["frames"]

    def echoes() -> int:
        return driving.client.health()["frames"]["confirmed"]["PCU1"] - before["confirmed"]["PCU1"]

    wait_until(lambda: echoes() >= 20, "own echoes", PATIENCE_S)
    after = driving.client.health()["frames"]
    assert after["foreign_commands"] == before["foreign_commands"]

    def copy_stops_ms() -> float:
        copy = driving.commands(0)[-1]
        return foreign_sender_stops_ms(driving, (EFF | copy.can_id, copy.data))

    found = measured(driving, TICK_MS, copy_stops_ms)
    seen(
        f"{after['confirmed']['PCU1'] - before['confirmed']['PCU1']} own echoes confirmed and no "
        f"more; a copy: zero torque after {told(found)}",
        reaction_ms=found[-1],
    )


# Passive counts for five seconds: after it none waits for throttle on this gateway.
def test_f37_passive_for_more_than_a_second_stops_and_warning_is_told(driving: Driving, seen: Seen):
    def stop_ms() -> float:
        send(error(CONTROLLER, WARNING))
        driving.until_link("error warning")
        time.sleep(1.2)
        assert driving.mode() == "active", "a warning stops nothing"
        passive_ns = time.time_ns()
        send(error(CONTROLLER, PASSIVE))
        driving.until_mode("fault")
        found_ms = stopped_within_ms(driving, passive_ns)
        assert found_ms > 1000
        send(error(CONTROLLER, ACTIVE))
        driving.until_link("up")
        return found_ms

    found = measured(driving, 1000 + 2 * TICK_MS, stop_ms)
    wait_until(
        lambda: (
            [entry["state"] for entry in driving.events("link_state")][-3:]
            == ["error warning", "error passive", "up"]
        ),
        "the three states in the log",
    )
    seen(f"warning reported; zero torque {told(found)} after passive", reaction_ms=found[-1])


def foreign_sender_stops_ms(driving: Driving, frame: tuple[int, bytes]) -> float:
    """Send this once; ms until both controllers are told ZERO_TORQUE, and nothing else after.

    The frame's own stamp is where the time begins.
    """
    foreign_before = sum(driving.client.health()["frames"]["foreign_commands"].values())
    before_ns = time.time_ns()
    send(frame)
    sent_ns = time.time_ns()
    driving.until_mode("fault")
    time.sleep(1)
    foreign = driving.client.health()["frames"]["foreign_commands"]
    assert sum(foreign.values()) == foreign_before + 1
    assert driving.mode() == "fault", "latched"
    can_id, data = frame
    sent = next(
        f
        for f in driving.commands(before_ns, sent_ns)
        if (f.can_id | EFF, f.data) == (can_id, data)
    )
    known = driving.foreign
    driving.foreign = lambda one: known(one) or one.stamp_ns == sent.stamp_ns
    return stopped_within_ms(driving, sent.stamp_ns)
