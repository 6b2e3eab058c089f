"""The machine without a bus, end to end: modes and requests (docs/safety.md, Modes)."""

from dataclasses import replace
from itertools import pairwise

import pytest

from tests.core.simulated_drive import (
    CODEC,
    COMMAND_IDS,
    MS,
    NOW_NS,
    PERIOD_NS,
    POWER_CUT,
    ZERO_TORQUE,
    Drive,
    active,
    data,
    in_mode,
    standby,
)
from vcu_gateway.core import calls, j1939
from vcu_gateway.core.causes import Severity
from vcu_gateway.core.codec import Reason
from vcu_gateway.core.demand import ControllerDemand, PowerMode, Refusal
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import Carrier, LinkState
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Quality
from vcu_gateway.core.stop import StopStage
from vcu_gateway.core.supervisor import FaultClass, Mode

DRIVER, SERVICE = FaultClass.DRIVER, FaultClass.SERVICE
REQUIRED = ["BMS_Status", "PCU1_Status2", "PCU2_Status2"]
EVERY_MODE = pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.name)
NOT_ENDING = pytest.mark.parametrize(
    "mode", [mode for mode in Mode if mode is not Mode.STOPPING], ids=lambda mode: mode.name
)
BUS_OFF, RESTARTED = 0x040, 0x100
BENCH = ControllerDemand(throttle_pct=30, power_mode=PowerMode.NORMAL)


def throttle_raw(drive: Drive) -> list[int]:
    return [command[1] for command in drive.commands]


def named(drive: Drive, name: str) -> list[dict[str, object]]:
    return [dict(event.fields) for event in drive.events if event.name == name]


def error_frame(drive: Drive, can_id: int, bits: int = 0) -> None:
    payload = bytes([0, bits, 0, 0, 0, 0, 0, 0])
    drive.gateway.receive(Frame(can_id, payload, drive.now_ns, error=True))


# What the shell reads.


def test_the_gateway_gives_its_mode_and_what_latched_it():
    drive = active()
    assert (drive.gateway.mode, drive.gateway.supervisor.latch) == (Mode.ACTIVE, None)
    drive.gateway.requests.emergency_stop()
    drive.tick()
    assert drive.gateway.mode is Mode.FAULT
    assert drive.gateway.supervisor.latch is not None
    assert drive.gateway.supervisor.latch.fault_class is SERVICE


def test_the_gateway_tells_what_it_sent_what_came_back_and_what_is_known_of_a_stop():
    drive = active()
    assert drive.gateway.stop(drive.now_ns) is None
    drive.gateway.requests.emergency_stop()
    drive.run(200)
    stop = drive.gateway.stop(drive.now_ns)
    assert stop is not None
    assert stop.latched_ns == drive.now_ns - 150 * MS
    assert stop.stage is StopStage.ON_BUS
    assert {one.frame.data for one in drive.gateway.transmitter.taken.values()} == {POWER_CUT}
    echoes = drive.gateway.receiver.echoes
    assert {name: echo.data for name, echo in echoes.items()} == dict.fromkeys(
        COMMAND_IDS, POWER_CUT
    )


def test_counters_are_those_of_their_instant():
    drive = active()
    before = drive.gateway.counters
    drive.receive_foreign("PCU2")
    drive.receive("BMS_Status", drive.now_ns - 10_000 * MS)
    drive.gateway.receive(Frame(0x123, bytes(8), drive.now_ns, extended=False))
    after = drive.gateway.counters
    assert before.foreign_commands == {"PCU1": 0, "PCU2": 0}
    assert after.foreign_commands == {"PCU1": 0, "PCU2": 1}
    assert after.out_of_order == before.out_of_order + 1
    assert sum(after.rejected.values()) == sum(before.rejected.values()) + 1
    assert after.confirmed == before.confirmed
    assert after.confirmed["PCU1"] > 0
    assert (after.unjudged, after.blocked_by_gate) == (0, {})


def test_the_frames_that_command_a_controller_are_known_by_their_group():
    groups = Drive().gateway.receiver.command_groups
    assert {name for names in groups.values() for name in names} == {"PCU1", "PCU2"}
    assert groups[j1939.group_key(COMMAND_IDS["PCU1"])] == ("PCU1",)


# What is received.


def test_a_good_frame_reaches_the_store():
    drive = Drive()
    drive.receive("BMS_Status", NOW_NS)
    snapshot = drive.gateway.snapshot(NOW_NS + MS)
    reading = snapshot.reading("BMS_Status", "SOC")
    assert (reading.value, reading.quality) == (80, Quality.GOOD)
    assert snapshot.age_ns("BMS_Status") == MS
    assert sum(drive.gateway.receiver.rejected.values()) == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"error": True}, Reason.ERROR),
        ({"remote": True, "data": b""}, Reason.REMOTE),
        ({"extended": False, "can_id": 0x0F4}, Reason.STANDARD),
        ({"can_id": 0x18FECA15}, Reason.UNKNOWN),
        ({"can_id": 0x1808D0F5}, Reason.FOREIGN_SOURCE),
        ({"data": bytes(7)}, Reason.SHORT),
        ({"data": b""}, Reason.SHORT),
        ({"data": bytes(12)}, Reason.LONG),
    ],
)
def test_a_rejected_frame_is_counted_by_its_reason_and_changes_nothing(changes, reason):
    receiver = Drive().gateway.receiver
    receiver.receive(replace(Frame(0x1808D0F4, data("BMS_Status"), NOW_NS), **changes))
    assert {r: n for r, n in receiver.rejected.items() if n} == {reason: 1}
    assert receiver.store.snapshot(NOW_NS).latest("BMS_Status") is None
    assert receiver.foreign_count == 0


def test_our_own_echo_confirms_the_sending_and_is_no_state():
    receiver = Drive().gateway.receiver
    for name in ("PCU1", "PCU2", "PCU2"):
        receiver.receive(Frame(COMMAND_IDS[name], ZERO_TORQUE, 0, own_echo=True))
    assert receiver.confirmed == {"PCU1": 1, "PCU2": 2}
    assert receiver.foreign_count == 0


@pytest.mark.parametrize(
    "changes",
    [{}, {"can_id": 0x1808A7D0}, {"data": b""}, {"data": bytes(12)}, {"remote": True, "data": b""}],
)
def test_a_command_of_another_sender_is_one_whatever_its_priority_and_content(changes):
    drive = standby()
    frame = replace(Frame(COMMAND_IDS["PCU1"], ZERO_TORQUE, drive.now_ns), **changes)
    drive.gateway.receive(frame)
    drive.tick()
    assert drive.gateway.receiver.foreign_commands == {"PCU1": 1, "PCU2": 0}
    assert drive.mode is Mode.FAULT


@pytest.mark.parametrize(
    ("can_id", "commanded"),
    [
        *((0x0008A700 | source, ("PCU1",)) for source in (0x00, 0x55, 0xA8, 0xFE, 0xFF)),
        *((0x0008A800 | source, ("PCU2",)) for source in (0x00, 0x55, 0xA7, 0xFE, 0xFF)),
        *((0x0008FF00 | source, ("PCU1", "PCU2")) for source in (0x00, 0x55, 0xD0, 0xFF)),
        (0x1C08FF55, ("PCU1", "PCU2")),
        (0x1C08A855, ("PCU2",)),
    ],
)
@pytest.mark.parametrize("changes", [{}, {"data": b""}, {"data": bytes(12)}, {"remote": True}])
def test_whoever_commands_a_controller_or_all_is_another_sender(can_id, commanded, changes):
    drive = standby()
    drive.gateway.receive(replace(Frame(can_id, ZERO_TORQUE, drive.now_ns), **changes))
    drive.tick()
    told = {name for name, count in drive.gateway.receiver.foreign_commands.items() if count == 1}
    assert told == set(commanded)
    assert drive.gateway.receiver.foreign_id == can_id
    assert drive.mode is Mode.FAULT


@pytest.mark.parametrize(
    "frame",
    [
        *(Frame(0x00080055 | to << 8, ZERO_TORQUE, 0) for to in (0xA6, 0xA9, 0xFE, 0x00, 0xD0)),
        *(Frame(0x0000A755 | pf << 16, ZERO_TORQUE, 0) for pf in (0x07, 0x09, 0x18, 0xFF)),
        *(Frame(page << 24 | 0x0008A755, ZERO_TORQUE, 0) for page in (1, 2, 3)),
        Frame(0x0008A755, ZERO_TORQUE, 0, own_echo=True),
        Frame(0x0008FF55, ZERO_TORQUE, 0, error=True),
        Frame(0x0008A7D0 & 0x7FF, ZERO_TORQUE, 0, extended=False),
        Frame(0x0008A7D0, ZERO_TORQUE, 0, extended=False),
    ],
)
def test_what_commands_no_controller_of_ours_is_no_other_sender(frame):
    drive = standby()
    drive.gateway.receive(frame)
    drive.tick()
    assert drive.gateway.receiver.foreign_count == 0
    assert drive.mode is Mode.STANDBY


def test_a_controllers_status_is_no_command_though_its_pf_is_the_commands():
    drive = standby()
    status = CODEC.by_name["PCU1_Status1"].spec.can_id
    assert status >> 16 & 0xFF == COMMAND_IDS["PCU1"] >> 16 & 0xFF
    for changes in ({}, {"can_id": status & ~0xFF | 0x55}, {"data": b""}, {"remote": True}):
        frame = Frame(status, data("PCU1_Status1"), drive.now_ns)
        drive.gateway.receive(replace(frame, **changes))
    drive.tick()
    assert drive.mode is Mode.STANDBY


# STARTING.


def test_nothing_is_sent_for_the_listening_time_and_then_zero_torque():
    drive = Drive()
    for _ in range(19):
        assert drive.tick().frames == ()
        assert drive.mode is Mode.STARTING
        assert "listening for another sender of our frames" in drive.sentence
    frames = drive.tick().frames
    assert drive.now_ns == NOW_NS + 1000 * MS
    assert [(frame.controller, frame.can_id, frame.data) for frame in frames] == [
        ("PCU1", 0x0008A7D0, ZERO_TORQUE),
        ("PCU2", 0x0008A8D0, ZERO_TORQUE),
    ]


def test_a_cut_that_the_last_process_had_latched_is_in_the_first_frame_and_needs_service():
    drive = Drive()
    drive.gateway.begin_from("emergency stop", {})
    assert drive.mode is Mode.FAULT
    sent = [drive.tick().frames for _ in range(42)]
    assert {frame.data for frames in sent for frame in frames} == {POWER_CUT}
    assert [len(frames) for frames in sent[18:21]] == [0, 2, 2]
    assert not drive.gateway.requests.reset(FaultClass.DRIVER, drive.now_ns).granted
    assert drive.gateway.requests.reset(FaultClass.SERVICE, drive.now_ns).granted
    assert [frame.data for frame in drive.tick().frames] == [ZERO_TORQUE, ZERO_TORQUE]


def test_it_begins_in_the_directions_of_the_last_process_unless_others_are_echoed():
    for silent, codes in (
        ({"PCU1_Status1", "PCU2_Status1"}, [1, 0]),
        ({"PCU1_Status1"}, [1, 1]),
        (set(), [1, 1]),
    ):
        drive = Drive()
        drive.gateway.begin_from(None, {"PCU1": True, "PCU2": False})
        drive.silent = silent
        drive.codes = {f"{name}_Status1.MotorReverse": 1 for name in ("PCU1", "PCU2")}
        drive.run(950)
        assert drive.mode is Mode.STARTING
        assert [frame.data[0] >> 4 & 1 for frame in drive.tick().frames] == codes, silent


def test_it_stays_silent_while_it_sees_another_sender():
    drive = Drive()
    for _ in range(10):
        drive.receive_foreign("PCU2")
        drive.run(500)
        assert drive.commands == []
    assert drive.mode is Mode.FAULT, "another sender latches from every mode"
    last_seen_ns = drive.now_ns - 450 * MS
    while not drive.tick().frames:
        assert drive.now_ns < last_seen_ns + 1000 * MS
    assert drive.now_ns == last_seen_ns + 1000 * MS
    assert drive.commands == [ZERO_TORQUE] * 2


def test_without_a_bus_nobody_can_be_heard_so_the_listening_begins_again():
    drive = Drive()
    drive.run(600)
    drive.gateway.apply(calls.LoseLink(drive.now_ns))
    drive.run(2000)
    assert drive.commands == []
    drive.open_link()
    opened_ns = drive.now_ns
    while not drive.tick().frames:
        pass
    assert drive.now_ns == opened_ns + 1000 * MS


def test_a_lost_link_later_needs_no_new_listening():
    drive = standby()
    drive.gateway.apply(calls.LoseLink(drive.now_ns))
    assert len(drive.tick().frames) == 2
    drive.open_link()
    assert len(drive.tick().frames) == 2


def test_a_carrier_that_goes_latches_a_fault_which_outlasts_its_return():
    drive = active()
    drive.gateway.apply(calls.ChangeCarrier(Carrier(False, drive.now_ns)))
    assert drive.tick().mode is Mode.FAULT
    assert drive.gateway.supervisor.latch.reason == "link bus off: stop"
    drive.gateway.apply(calls.ChangeCarrier(Carrier(True, drive.now_ns)))
    assert drive.gateway.link.state is LinkState.UP
    assert drive.tick().mode is Mode.FAULT


def test_a_bus_off_that_came_and_went_between_two_ticks_latches_a_fault():
    drive = active()
    error_frame(drive, BUS_OFF)
    error_frame(drive, RESTARTED)
    assert drive.gateway.link.state is LinkState.UP
    assert drive.tick().mode is Mode.FAULT
    assert drive.gateway.supervisor.latch.reason == "link bus off: stop"


def test_nothing_is_granted_while_listening():
    drive = Drive(listen_before_talk_ms=5000)
    drive.receive_foreign()
    for _ in range(60):
        drive.tick()
        for name in ("PCU1_Status2", "PCU2_Status2"):  # controllers that talk unasked
            drive.receive(name)
        assert drive.reset().sentence == drive.arm().sentence
        assert drive.arm().sentence == "listening for another sender of our frames"
    assert drive.mode is Mode.FAULT


def test_standby_needs_three_good_frames_of_each_required_message():
    drive = Drive()
    while drive.tick().mode is Mode.STARTING:
        counts = [drive.result.snapshot.latest(name) for name in REQUIRED]
        assert not drive.commands or any(
            one is None or one.frame_count - one.marked_count < 3 for one in counts
        )
    counts = [drive.result.snapshot.latest(name) for name in REQUIRED]
    assert all(one.frame_count - one.marked_count >= 3 for one in counts)
    assert drive.mode is Mode.STANDBY
    assert drive.now_ns <= NOW_NS + 1500 * MS


@pytest.mark.parametrize("name", REQUIRED)
def test_without_a_required_message_it_stays_in_starting_with_zero_torque(name):
    drive = Drive()
    drive.silent.add(name)
    drive.run(5000)
    assert drive.mode is Mode.STARTING
    assert drive.commands == [ZERO_TORQUE] * 2
    assert f"waiting for {name}" in drive.sentence


def test_frames_out_of_range_do_not_qualify():
    drive = Drive()
    drive.codes["BMS_Status.SOC"] = 101
    drive.run(5000)
    assert drive.mode is Mode.STARTING
    assert "waiting for BMS_Status: 0 of 3 good frames" in drive.sentence


def test_which_messages_are_required_is_configuration():
    drive = Drive(required_messages=("BMS_Temperatures",))
    drive.silent.add("BMS_Temperatures")
    drive.run(5000)
    assert drive.mode is Mode.STARTING
    drive.silent.clear()
    drive.until(Mode.STANDBY)


def test_zero_torque_carries_the_configured_speed_limit():
    drive = Drive(speed_limit_max_rpm=3000)
    drive.run(1000)
    assert drive.commands == [bytes.fromhex("0c000000b80b0000")] * 2


def test_the_transmit_priority_is_configuration():
    drive = Drive(transmit_priority=6)
    assert [frame.can_id for frame in drive.run(1000).frames] == [0x1808A7D0, 0x1808A8D0]


# STANDBY and arming.


def test_a_restart_begins_unarmed_and_arms_only_on_request():
    drive = standby()
    drive.run(10_000)
    assert drive.mode is Mode.STANDBY
    assert drive.commands == [ZERO_TORQUE] * 2
    assert drive.arm().granted
    assert drive.tick().mode is Mode.ACTIVE


@pytest.mark.parametrize("name", REQUIRED)
def test_losing_a_required_message_in_standby_leads_back_to_starting_without_listening(name):
    drive = standby()
    drive.silent.add(name)
    drive.until(Mode.STARTING)
    assert drive.commands == [ZERO_TORQUE] * 2
    drive.silent.clear()
    lost_count = drive.result.snapshot.latest(name).frame_count
    drive.until(Mode.STANDBY)
    assert drive.result.snapshot.latest(name).frame_count - lost_count >= 3
    assert all(len(drive.tick().frames) == 2 for _ in range(5))


def throttle_asked(drive: Drive) -> None:
    drive.offer(ControllerDemand(throttle_pct=0.5))


def nobody_asks(drive: Drive) -> None:
    drive.demanded = None
    drive.run(500)


def reverse_while_rolling(drive: Drive) -> None:
    drive.codes |= {"PCU1_Status2.MotorSpeed": 300, "PCU2_Status2.MotorSpeed": 300}
    drive.demanded = ControllerDemand(motor_reverse=True)
    drive.run(200)


def undervoltage(drive: Drive) -> None:
    drive.codes["BMS_Status.CellUndervoltage"] = 2
    drive.run(500)


def undervoltage_a_moment_ago(drive: Drive) -> None:
    undervoltage(drive)
    drive.codes.clear()
    drive.run(1200)


def already_armed(drive: Drive) -> None:
    drive.arm()


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (nobody_asks, "there is no fresh demand"),
        (throttle_asked, "the demanded throttle is not 0"),
        (reverse_while_rolling, "a change of direction is pending"),
        (undervoltage, "BMS_Status.CellUndervoltage 2 (level2): stop stands or stood a moment ago"),
        (undervoltage_a_moment_ago,
         "BMS_Status.CellUndervoltage 2 (level2): stop stands or stood a moment ago"),
        (already_armed, "arming needs standby, the mode is active"),
    ],
)  # fmt: skip
def test_arming_is_refused_with_a_sentence_that_says_why(spoil, sentence):
    drive = standby()
    spoil(drive)
    before = drive.mode
    answer = drive.arm()
    assert (answer.granted, answer.refusal) == (False, Refusal.NOT_ALLOWED_NOW)
    assert answer.sentence == sentence
    assert drive.mode is before
    drive.tick()
    assert named(drive, "request_refused") == [{"request": "arm", "sentence": sentence}]


def test_a_refused_request_to_arm_is_not_remembered():
    drive = standby()
    undervoltage(drive)
    assert not drive.arm().granted
    drive.codes.clear()
    drive.run(5000)
    assert drive.mode is Mode.STANDBY
    assert drive.arm().granted


def test_a_stop_outside_active_does_not_latch_and_blocks_arming_for_the_hold():
    drive = standby()
    undervoltage(drive)
    assert drive.gateway.supervisor.latch is None
    drive.codes.clear()
    drive.receive("BMS_Status")
    absent_since_ns = drive.now_ns + PERIOD_NS
    while not drive.arm().granted:
        assert drive.now_ns < absent_since_ns + 1000 * MS
        drive.tick()
    assert drive.now_ns == absent_since_ns + 1000 * MS


def test_a_direction_is_taken_over_while_standing_so_that_arming_is_granted():
    drive = standby()
    drive.demanded = ControllerDemand(motor_reverse=True)
    drive.tick()
    assert drive.commands == [bytes.fromhex("1c000000e02e0000")] * 2
    assert drive.arm().granted


# ACTIVE.


def test_the_throttle_rises_along_its_slew_and_falls_at_once():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=20)
    rising = [throttle_raw(drive) for _ in range(6) if drive.tick()]
    assert rising == [[round(pct / 0.39)] * 2 for pct in (5, 10, 15, 20, 20, 20)]
    drive.demanded = ControllerDemand()
    drive.tick()
    assert throttle_raw(drive) == [0, 0]


def test_an_expired_demand_gives_throttle_0_and_standby_in_the_next_tick():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=20)
    drive.run(1000)
    drive.demanded = None
    drive.run(200)
    assert (drive.mode, throttle_raw(drive)) == (Mode.ACTIVE, [51, 51]), "200 ms old is fresh"
    drive.tick()
    assert drive.mode is Mode.STANDBY
    assert drive.commands == [ZERO_TORQUE] * 2
    assert {"before": "active", "after": "standby", "reason": "the demand expired"} in named(
        drive, "mode_changed"
    )
    drive.demanded = ControllerDemand(throttle_pct=20)
    drive.run(1000)
    assert drive.mode is Mode.STANDBY, "a new arm is needed"


def test_a_demand_that_expired_between_two_ticks_is_not_continued_by_a_new_one():
    drive = active()
    drive.ttl_ms = 40
    drive.tick()
    drive.tick()
    assert drive.mode is Mode.STANDBY


def test_disarming_leads_to_standby_and_zero_torque():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=20)
    drive.run(1000)
    assert drive.gateway.requests.disarm(drive.now_ns).granted
    drive.tick()
    assert (drive.mode, drive.commands) == (Mode.STANDBY, [ZERO_TORQUE] * 2)


@pytest.mark.parametrize(
    ("codes", "within_ms"),
    [
        ({"BMS_Status.CellUndervoltage": 2}, 500),
        ({"PCU1_Status1.TemperatureProtectLevel": 2}, 500),
        ({"PCU2_Status1.TemperatureProtectLevel": 3}, 500),
        ({"PCU1_Status1.Throttle": 64}, 500),
        ({"BMS_Status.LifeSignal": 0}, 1500),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else None,
)
def test_a_stop_of_a_node_ends_the_drive_in_the_tick_that_sees_it(codes, within_ms):
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=20)
    drive.run(1000)
    drive.codes |= codes
    while drive.tick().mode is Mode.ACTIVE:
        assert throttle_raw(drive) == [51, 51]
        within_ms -= 50
        assert within_ms > 0
    assert (drive.mode, drive.commands) == (Mode.FAULT, [ZERO_TORQUE] * 2)
    assert drive.gateway.supervisor.latch.fault_class is DRIVER


@pytest.mark.parametrize(
    ("name", "deadline_ms"), [("BMS_Status", 1600), ("PCU1_Status2", 200), ("PCU2_Status2", 200)]
)
def test_silence_stops_the_motors_within_one_tick_of_its_deadline(name, deadline_ms):
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=20)
    drive.run(1000)
    drive.silent.add(name)
    arrival_ns = drive.result.snapshot.latest(name).arrival_ns
    drive.until(Mode.FAULT)
    assert deadline_ms * MS < drive.now_ns - arrival_ns <= deadline_ms * MS + PERIOD_NS
    assert drive.commands == [ZERO_TORQUE] * 2


def test_a_late_battery_limits_before_a_silent_one_stops():
    drive = active()
    drive.demanded = ControllerDemand(power_mode=PowerMode.TURBO)
    drive.run(500)
    drive.silent.add("BMS_Status")
    drive.run(1300)
    assert drive.mode is Mode.ACTIVE
    assert "limited by BMS_Status 1" in drive.sentence
    assert [command[0] >> 2 & 3 for command in drive.commands] == [PowerMode.ECO] * 2


def speed_rpm(drive: Drive) -> list[int]:
    return [int.from_bytes(command[4:6], "little") for command in drive.commands]


def power_w(drive: Drive) -> list[int]:
    return [int.from_bytes(command[6:8], "little") for command in drive.commands]


def test_limits_come_and_go_along_their_slews_never_in_a_jump():
    drive = active()
    drive.turn(3000)
    drive.demanded = ControllerDemand(brake_pct=80, regen_brake=True)
    drive.run(1000)
    assert (power_w(drive), drive.commands[0][2]) == ([60000] * 2, round(80 / 0.39))
    drive.codes["BMS_Status.DischargeOvercurrent"] = 1
    seen = []
    for _ in range(120):
        drive.tick()
        if drive.now_ns == NOW_NS + 6000 * MS:
            del drive.codes["BMS_Status.DischargeOvercurrent"]
        assert power_w(drive)[0] == power_w(drive)[1]
        seen.append((power_w(drive)[0], drive.commands[0][2]))
    powers, brakes = zip(*seen, strict=True)
    assert (min(powers), max(powers), powers[-1]) == (10000, 60000, 60000)
    assert (min(brakes), max(brakes), brakes[-1]) == (round(20 / 0.39), 205, 205)
    assert max(abs(a - b) for a, b in pairwise(powers)) == 3000
    assert max(abs(a - b) for a, b in pairwise(brakes)) <= 13


# FAULT and reset.


@NOT_ENDING
@pytest.mark.parametrize("how", ["overtemperature", "emergency stop"])
def test_a_cut_latches_from_every_mode_and_cuts_the_power(mode, how):
    drive = in_mode(mode)
    if how == "emergency stop":
        assert drive.gateway.requests.emergency_stop().granted
    else:
        drive.codes["BMS_Status.Overtemperature"] = 2
        drive.receive("BMS_Status")
    drive.tick()
    assert (drive.mode, drive.commands) == (Mode.FAULT, [POWER_CUT] * 2)
    assert drive.gateway.supervisor.latch.fault_class is SERVICE
    drive.codes.clear()
    drive.run(3000)
    assert drive.commands == [POWER_CUT] * 2, "until the reset"
    answer = drive.reset(DRIVER)
    assert not answer.granted
    assert answer.sentence.endswith("cut needs a reset at service level")
    assert drive.reset(SERVICE).granted
    assert drive.mode is Mode.STARTING
    drive.tick()
    # In STARTING something was missing, and it is missing still.
    after = Mode.STARTING if mode is Mode.STARTING else Mode.STANDBY
    assert (drive.mode, drive.commands) == (after, [ZERO_TORQUE] * 2)


def test_a_cut_while_ending_cuts_the_power():
    drive = in_mode(Mode.STOPPING)
    drive.gateway.requests.emergency_stop()
    drive.tick()
    assert (drive.mode, drive.commands) == (Mode.STOPPING, [POWER_CUT] * 2)


@pytest.mark.parametrize("order", ["the stop first", "the end first", "a tick between"])
@pytest.mark.parametrize("how", ["emergency stop", "InternalFault"])
@pytest.mark.parametrize("mode", [Mode.STARTING, Mode.STANDBY, Mode.ACTIVE, Mode.FAULT])
def test_a_cut_that_comes_with_the_end_is_latched_for_the_next_start(mode, how, order):
    drive = in_mode(mode)
    requests = drive.gateway.requests

    def cut() -> None:
        if how == "emergency stop":
            requests.emergency_stop()
        else:
            drive.codes["BMS_Status.InternalFault"] = 1
            drive.receive("BMS_Status")

    for ask in (
        (cut, requests.terminate) if order == "the stop first" else (requests.terminate, cut)
    ):
        ask()
        if order == "a tick between":
            drive.tick()
    drive.codes.clear()
    drive.tick()
    assert (drive.mode, drive.commands) == (Mode.STOPPING, [POWER_CUT] * 2)
    assert drive.gateway.supervisor.latch.fault_class is SERVICE


@pytest.mark.parametrize("stop", ["a stop", "another sender"])
def test_what_only_stops_is_not_latched_while_ending(stop):
    drive = in_mode(Mode.STOPPING)
    drive.codes["BMS_Status.CellUndervoltage"] = 2
    if stop == "another sender":
        drive.receive_foreign()
    drive.tick()
    assert drive.gateway.supervisor.latch is None


@NOT_ENDING
def test_another_sender_latches_from_every_mode_with_zero_torque(mode):
    drive = in_mode(mode)
    drive.receive_foreign("PCU2")
    drive.tick()
    assert (drive.mode, drive.commands) == (Mode.FAULT, [ZERO_TORQUE] * 2)
    assert drive.gateway.supervisor.latch.fault_class is DRIVER
    assert drive.gateway.supervisor.latch.reason.startswith("command 0008A")


def fault() -> Drive:
    """In FAULT by undervoltage, which is gone, but not for long."""
    drive = active()
    drive.codes["BMS_Status.CellUndervoltage"] = 2
    drive.until(Mode.FAULT)
    drive.codes.clear()
    return drive


STANDS = "BMS_Status.CellUndervoltage 2 (level2): stop stands or stood a moment ago"


def test_a_reset_waits_until_the_cause_was_absent_for_the_hold():
    drive = fault()
    assert drive.reset(DRIVER).sentence == STANDS
    drive.receive("BMS_Status")
    absent_since_ns = drive.now_ns + PERIOD_NS
    while not (answer := drive.reset(DRIVER)).granted:
        assert answer.sentence == STANDS
        assert drive.now_ns < absent_since_ns + 1000 * MS
        drive.tick()
    assert drive.now_ns == absent_since_ns + 1000 * MS
    drive.run(5000)
    assert drive.mode is Mode.STANDBY, "never ACTIVE"
    assert drive.commands == [ZERO_TORQUE] * 2


def test_a_reset_is_refused_while_throttle_is_asked():
    drive = fault()
    drive.demanded = ControllerDemand(throttle_pct=1)
    drive.run(2000)
    assert drive.reset(DRIVER).sentence == "the demanded throttle is not 0"
    drive.demanded = ControllerDemand()
    drive.tick()
    assert drive.reset(DRIVER).granted


def test_a_reset_needs_no_demand_at_all():
    drive = fault()
    drive.demanded = None
    drive.run(2000)
    assert drive.reset(DRIVER).granted


def test_outside_fault_there_is_nothing_to_reset():
    assert standby().reset().sentence == "nothing is latched"


def test_a_fault_gives_safe_frames_until_the_reset_whatever_is_asked():
    drive = fault()
    drive.demanded = ControllerDemand(throttle_pct=50, power_mode=PowerMode.TURBO, regen_brake=True)
    for _ in range(100):
        drive.arm()
        assert [frame.data for frame in drive.tick().frames] == [ZERO_TORQUE] * 2


def test_between_an_emergency_stop_and_its_tick_nothing_is_granted():
    drive = in_mode(Mode.STANDBY)
    drive.gateway.requests.emergency_stop()
    assert drive.arm().sentence == "an emergency stop was requested"
    drive.tick()
    while drive.gateway.requests.against_resetting(SERVICE, drive.now_ns):
        drive.tick()
    drive.gateway.requests.emergency_stop()
    assert drive.reset(SERVICE).sentence == "an emergency stop was requested"
    drive.tick()
    assert (drive.mode, drive.commands) == (Mode.FAULT, [POWER_CUT] * 2)


def test_an_emergency_stop_counts_as_seen_in_one_tick_and_is_held_like_any_cause():
    drive = active()
    drive.gateway.requests.emergency_stop()
    drive.tick()
    pressed_ns = drive.now_ns
    while not drive.reset(SERVICE).granted:
        drive.tick()
    assert drive.now_ns == pressed_ns + PERIOD_NS + 1000 * MS


def test_overcharge_forbids_regeneration_until_restart():
    drive = active()
    drive.demanded = ControllerDemand(brake_pct=50, regen_brake=True)
    for code in (3, 2, 1, 0):
        drive.codes["BMS_Status.CellOvervoltage"] = code
        drive.run(5000)
        assert drive.mode is Mode.ACTIVE
        assert all(command[0] & 0x20 == 0 and command[2] == 0 for command in drive.commands)


# The bus.


def test_the_lost_link_stops_in_the_next_tick():
    drive = active()
    drive.gateway.apply(calls.LoseLink(drive.now_ns))
    drive.gateway.apply(calls.LoseLink(drive.now_ns + 1))
    assert drive.gateway.link.since_ns == drive.now_ns, "since the first word of it"
    drive.tick()
    assert drive.mode is Mode.FAULT
    assert drive.gateway.supervisor.latch.reason == "link lost: stop"
    drive.run(2000)
    assert drive.reset(DRIVER).sentence == "link lost: stop stands or stood a moment ago"
    drive.open_link()
    drive.run(1050)
    assert drive.reset(DRIVER).granted


def test_bus_off_stops_in_the_next_tick():
    drive = active()
    error_frame(drive, 0x040)
    assert drive.tick().mode is Mode.FAULT


def test_error_passive_stops_after_more_than_a_second():
    drive = active()
    error_frame(drive, 0x004, 0x20)
    drive.run(1000)
    assert drive.mode is Mode.ACTIVE
    assert drive.tick().mode is Mode.FAULT


def test_frames_that_are_not_confirmed_for_three_ticks_stop():
    drive = active()
    drive.echo = False
    drive.run(150)  # the last echo was there before the first of these ticks
    assert drive.mode is Mode.ACTIVE
    assert drive.tick().mode is Mode.FAULT
    assert drive.gateway.supervisor.latch.reason == "own frames for 3 ticks: stop"


def test_a_frame_that_the_bus_did_not_take_earns_no_throttle():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=50)
    drive.tick()
    assert throttle_raw(drive) == [13, 13]
    drive.accepted = False
    drive.tick()
    assert throttle_raw(drive) == [26, 26]
    drive.accepted = True
    drive.tick()
    assert throttle_raw(drive) == [26, 26], "5 % above what was sent last"
    assert drive.mode is Mode.ACTIVE
    assert drive.gateway.transmitter.gate.blocked == {}


@pytest.mark.parametrize(("late_ns", "mode"), [(0, Mode.ACTIVE), (1, Mode.FAULT)])
def test_a_tick_late_by_more_than_four_periods_stops(late_ns, mode):
    drive = active()
    drive.ttl_ms = 1000
    drive.tick()
    drive.silent |= {"PCU1_Status2", "PCU2_Status2"}
    gap_ns = 5 * PERIOD_NS + late_ns
    for name in sorted(drive.silent):
        drive.receive(name, drive.now_ns + gap_ns - MS)
    drive.tick(gap_ns)
    assert drive.mode is mode
    assert len(drive.commands) == 2, "a late tick still sends, and sends once"


# The gate.


def test_a_frame_that_the_gate_blocks_stops_both_controllers():
    drive = active()
    gate = drive.gateway.transmitter.gate
    gate.limits = replace(
        drive.gateway.settings, power_limit_max_w=100
    )  # as if the rest were wrong
    drive.tick()
    assert (drive.mode, drive.commands) == (Mode.FAULT, [ZERO_TORQUE] * 2)
    assert drive.gateway.supervisor.latch.reason == "the gate blocked a frame: power_limit"
    assert drive.gateway.supervisor.latch.fault_class is DRIVER
    drive.tick()
    assert "blocked by gate power_limit: stop" in drive.sentence
    drive.run(2000)
    assert drive.reset(DRIVER).granted


def test_the_gate_does_not_take_a_power_cut_away():
    drive = in_mode(Mode.STANDBY)
    gate = drive.gateway.transmitter.gate
    gate.limits = replace(drive.gateway.settings, speed_limit_max_rpm=100)
    drive.gateway.requests.emergency_stop()
    for _ in range(3):
        drive.tick()
        assert drive.commands == [POWER_CUT] * 2


# STOPPING.


@EVERY_MODE
def test_ending_gives_three_zero_torque_frames_to_each_controller_from_every_mode(mode):
    drive = in_mode(mode)
    drive.gateway.requests.terminate()
    for _ in range(2 if mode is Mode.STOPPING else 3):
        assert not drive.gateway.finished
        drive.tick()
        assert (drive.mode, drive.commands) == (Mode.STOPPING, [ZERO_TORQUE] * 2)
    assert drive.gateway.finished


def test_a_safe_frame_that_was_not_sent_does_not_count_at_the_end():
    drive = active()
    drive.gateway.requests.terminate()
    drive.tick()
    drive.accepted = False
    drive.tick()
    drive.accepted = True
    drive.tick()
    assert not drive.gateway.finished
    drive.tick()
    assert drive.gateway.finished


def test_a_bus_that_takes_nothing_does_not_hold_the_end_up_for_ever():
    drive = active()
    drive.gateway.requests.terminate()
    drive.accepted = False
    for _ in range(9):
        drive.tick()
        assert not drive.gateway.finished
        assert not drive.gateway.gave_up
    drive.tick()
    assert drive.gateway.finished
    assert drive.gateway.gave_up


def test_ending_while_listening_sends_nothing():
    drive = Drive()
    drive.run(200)
    drive.gateway.requests.terminate()
    result = drive.tick()
    assert (result.mode, result.frames, drive.gateway.finished) == (Mode.STOPPING, (), True)


def test_ending_out_of_a_cut_keeps_the_power_cut():
    drive = active()
    drive.gateway.requests.emergency_stop()
    drive.run(3000)
    drive.gateway.requests.terminate()
    drive.run(150)
    assert (drive.mode, drive.commands) == (Mode.STOPPING, [POWER_CUT] * 2)
    assert drive.gateway.finished


def test_nothing_is_granted_while_ending():
    drive = in_mode(Mode.STOPPING)
    assert not drive.arm().granted
    assert not drive.reset().granted
    drive.tick()
    assert drive.mode is Mode.STOPPING


# The bench demand.


def bench(**settings) -> Drive:
    drive = Drive(bench_demand=BENCH, **settings)
    drive.demanded = None
    drive.until(Mode.STANDBY)
    return drive


def test_a_bench_demand_never_expires_and_arms_only_on_request():
    drive = bench()
    drive.run(10_000)
    assert (drive.mode, drive.commands) == (Mode.STANDBY, [ZERO_TORQUE] * 2)
    assert drive.arm().granted
    assert [throttle_raw(drive) for _ in range(3) if drive.tick()] == [[13, 13], [26, 26], [38, 38]]
    drive.run(10_000)
    assert (drive.mode, throttle_raw(drive)) == (Mode.ACTIVE, [77, 77])


def test_auto_arm_arms_once_and_by_itself():
    drive = bench(auto_arm=True)
    drive.until(Mode.ACTIVE)
    armed = {
        "before": "standby",
        "after": "active",
        "reason": "armed by auto_arm on a test bench",
    }
    assert named(drive, "mode_changed")[-1] == armed
    drive.gateway.requests.disarm(drive.now_ns)
    drive.run(10_000)
    assert drive.mode is Mode.STANDBY


def test_auto_arm_waits_until_nothing_speaks_against_it():
    drive = Drive(bench_demand=BENCH, auto_arm=True)
    drive.demanded = None
    drive.codes["BMS_Status.CellUndervoltage"] = 2
    drive.until(Mode.STANDBY)
    drive.run(3000)
    assert drive.mode is Mode.STANDBY
    drive.codes.clear()
    drive.until(Mode.ACTIVE)


def test_auto_arm_never_arms_the_demand_of_somebody_who_took_over():
    drive = Drive(bench_demand=BENCH, auto_arm=True, priorities={"driver": 5})
    drive.run(200)
    drive.demanded = None
    drive.run(5000)
    assert drive.mode is Mode.STANDBY


def test_auto_arm_without_a_bench_demand_does_nothing():
    drive = standby(auto_arm=True)
    drive.run(5000)
    assert drive.mode is Mode.STANDBY


@pytest.mark.parametrize("end", ["fault", "disarm"])
def test_neither_a_reset_nor_a_request_to_disarm_is_answered_with_auto_arm(end):
    drive = Drive(bench_demand=BENCH, auto_arm=True)
    drive.demanded = None
    if end == "fault":
        drive.gateway.requests.emergency_stop()
        drive.run(3000)
        assert drive.mode is Mode.FAULT
        assert drive.reset(SERVICE).granted
    else:
        drive.gateway.requests.disarm(drive.now_ns)
    drive.run(5000)
    assert drive.mode is Mode.STANDBY


# Reloading the configuration.


@pytest.mark.parametrize(
    "change",
    [
        {"late_after_ms": {"BMS_Status": 900}},
        {"stale_after_ms": {"BMS_Status": 1200}},
        {"transmit_priority": 3},
        {"period_ns": 20 * MS},
        {"listen_before_talk_ms": 2000},
        {"bench_demand": BENCH},
        {"auto_arm": True},
    ],
    ids=lambda change: next(iter(change)),
)
def test_what_is_read_at_the_start_needs_a_restart(change):
    drive = standby()
    before = drive.gateway.settings
    answer = drive.gateway.reload(replace(before, regen_limit_pct=10, **change))
    assert answer.sentence == f"these need a restart: {next(iter(change))}"
    assert drive.gateway.settings is before, "whole or not at all"


@pytest.mark.parametrize(
    ("change", "stricter"),
    [
        ({"power_limit_max_w": 50_000}, True),
        ({"speed_limit_max_rpm": 6000}, True),
        ({"derated_power_w": 5000}, True),
        ({"derated_power_w": 10_001}, False),
        ({"regen_limit_pct": 21}, False),
        ({"regen_limit_pct": 19}, True),
        ({"throttle_slew_pct_per_s": 101}, False),
        ({"direction_change_rpm": 51}, False),
        ({"clear_hold_ms": 2000}, True),
        ({"clear_hold_ms": 999}, False),
        ({"required_messages": ("BMS_Status",)}, False),
        ({"qualify_frames": 4}, False),
        ({"priorities": {"driver": 1}}, False),
    ],
    ids=str,
)
def test_while_active_limits_may_only_become_stricter(change, stricter):
    settings = replace(Settings(), **change)
    assert standby().gateway.reload(settings).granted
    drive = active()
    answer = drive.gateway.reload(settings)
    assert answer.granted is stricter
    assert drive.gateway.settings == (settings if stricter else Settings())
    if not stricter:
        name = next(iter(change))
        assert answer.sentence == f"while active, limits may only become stricter: {name}"


def test_a_stricter_maximum_is_reached_along_its_slew_in_the_drive():
    drive = active()
    stricter = replace(drive.gateway.settings, power_limit_max_w=1000, speed_limit_max_rpm=3000)
    assert drive.gateway.reload(stricter).granted
    seen = []
    for _ in range(60):
        drive.tick()
        seen.append((power_w(drive), speed_rpm(drive)))
    assert seen[0] == ([57_000] * 2, [11_800] * 2)
    assert seen[18] == ([3_000] * 2, [8_200] * 2)
    assert seen[19] == ([1_000] * 2, [8_000] * 2)
    assert seen[44] == ([1_000] * 2, [3_000] * 2)
    assert seen[-1] == seen[44]
    assert drive.mode is Mode.ACTIVE


@pytest.mark.parametrize("mode", Mode)
def test_every_safe_frame_follows_the_speed_limits_ramp(mode):
    drive = in_mode(mode)
    stricter = replace(drive.gateway.settings, speed_limit_max_rpm=11_000)
    assert drive.gateway.reload(stricter).granted
    seen = []
    for _ in range(6):
        drive.tick()
        seen.append(speed_rpm(drive)[0])
    assert seen == [11_800, 11_600, 11_400, 11_200, 11_000, 11_000]
    assert drive.mode is mode


# What a tick tells.


@EVERY_MODE
def test_every_tick_after_the_listening_gives_both_frames_from_one_snapshot(mode):
    drive = in_mode(mode)
    for _ in range(20):
        result = drive.tick()
        assert [frame.can_id for frame in result.frames] == list(COMMAND_IDS.values())
        assert result.snapshot.now_ns == drive.now_ns
        decoded = [
            CODEC.by_name[f"VCU_{frame.controller}_Command"].decode(frame.data)
            for frame in result.frames
        ]
        assert [one.values[4] for one in decoded] == [
            pytest.approx(command.throttle_pct, abs=0.2) for command in result.commands.values()
        ]


def test_events_tell_each_change_once():
    drive = active()
    drive.codes["BMS_Status.CellUndervoltage"] = 2
    drive.run(1000)
    drive.codes.clear()
    drive.run(3000)
    drive.reset(DRIVER)
    drive.run(1000)
    reason = "BMS_Status.CellUndervoltage 2 (level2): stop"
    modes = [(fields["before"], fields["after"]) for fields in named(drive, "mode_changed")]
    assert modes == [
        ("starting", "standby"),
        ("standby", "active"),
        ("active", "fault"),
        ("fault", "starting"),
        ("starting", "standby"),
    ]
    assert named(drive, "fault_latched") == [{"fault_class": "driver", "reason": reason}]
    assert named(drive, "demand_owner") == [{"source": "driver"}]
    of_cells = [
        (event.name, event.severity)
        for event in drive.events
        if event.fields.get("subject") == "BMS_Status.CellUndervoltage"
    ]
    assert of_cells == [("cause_began", Severity.WARNING), ("cause_ended", Severity.INFO)]


def test_a_healthy_drive_is_silent():
    drive = active()
    drive.events.clear()
    drive.run(10_000)
    assert drive.events == []


def test_a_refused_demand_changes_nothing():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=20)
    drive.run(500)
    assert not drive.offer(ControllerDemand(throttle_pct=float("nan"))).granted
    assert not drive.offer(ControllerDemand(throttle_pct=90), sequence=1).granted
    assert not drive.offer(ControllerDemand(throttle_pct=90), source="another").granted
    drive.tick()
    assert throttle_raw(drive) == [51, 51]


def test_a_healthy_vehicle_is_not_armed_before_our_first_frames_have_left():
    demand = ControllerDemand(throttle_pct=20)
    drive = Drive(bench_demand=demand, auto_arm=True)
    drive.demanded = None
    while not drive.commands:
        drive.tick()
    assert (drive.mode, drive.commands) == (Mode.STARTING, [ZERO_TORQUE] * 2)
    drive.run(3000)
    assert drive.mode is Mode.ACTIVE
    assert drive.gateway.transmitter.gate.blocked == {}


# The demand ends.


def test_ending_the_demand_ends_the_drive_at_once():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=30)
    drive.run(500)
    assert drive.commands[0] != ZERO_TORQUE
    assert drive.gateway.requests.end_demand("driver", drive.now_ns).granted
    assert drive.mode is Mode.STANDBY
    drive.demanded = None
    drive.tick()
    assert drive.commands == [ZERO_TORQUE, ZERO_TORQUE]
    assert not drive.arm().granted


def test_another_source_cannot_end_the_demand():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=30)
    drive.run(500)
    assert drive.commands[0] != ZERO_TORQUE
    assert not drive.gateway.requests.end_demand("remote", drive.now_ns).granted
    assert drive.mode is Mode.ACTIVE


# Ended and started again.


@pytest.mark.parametrize(("restarts", "granted"), [(0, True), (1, True), (2, True), (3, False)])
def test_three_unexpected_restarts_in_one_drive_end_arming(restarts, granted):
    drive = standby()
    drive.gateway.apply(calls.CountRestarts(restarts))
    answer = drive.arm()
    assert answer.granted is granted
    assert granted or answer.sentence == (
        "the gateway was restarted 3 times in this drive; find out why, then restart the service"
    )


def test_a_gateway_that_was_told_of_no_restart_counts_none():
    assert Drive().gateway.requests.restarts == 0


def test_why_says_that_restarts_ended_arming():
    drive = standby()
    drive.gateway.apply(calls.CountRestarts(4))
    assert "before arming: the gateway was restarted 4 times in this drive" in drive.sentence


def test_a_bench_does_not_arm_itself_after_three_restarts():
    drive = Drive(bench_demand=BENCH, auto_arm=True)
    drive.gateway.apply(calls.CountRestarts(3))
    drive.run(5000)
    assert drive.mode is Mode.STANDBY


def restart_state_causes(drive: Drive) -> list[str]:
    held = drive.gateway.causes.held
    return [str(one.finding) for one in held if one.finding.cause == "restart_state"]


def test_nobody_can_arm_while_the_restart_state_cannot_be_kept():
    drive = standby()
    drive.gateway.apply(calls.NoteRestartState("No space"))
    drive.run(500)
    assert drive.arm().sentence == "the restart state cannot be kept: No space"
    assert "before arming: the restart state cannot be kept: No space" in drive.sentence
    assert restart_state_causes(drive) == [], "it is an alarm in ACTIVE alone"
    drive.gateway.apply(calls.NoteRestartState(None))
    assert drive.arm().granted


def test_a_restart_state_that_was_not_kept_in_active_is_an_alarm_from_the_next_tick_on():
    drive = active()
    drive.gateway.apply(calls.NoteRestartState("No space"))
    drive.tick()
    assert restart_state_causes(drive) == ["restart state not kept (No space): alarm"]
    drive.run(1500)
    assert drive.mode is Mode.ACTIVE
    drive.gateway.apply(calls.NoteRestartState(None))
    drive.run(1100)
    assert restart_state_causes(drive) == []


def test_a_bench_arms_itself_only_once_the_restart_state_can_be_kept():
    drive = Drive(bench_demand=BENCH, auto_arm=True)
    drive.gateway.apply(calls.NoteRestartState("No space"))
    drive.run(5000)
    assert drive.mode is Mode.STANDBY
    drive.gateway.apply(calls.NoteRestartState(None))
    drive.run(100)
    assert drive.mode is Mode.ACTIVE


def test_controllers_that_echo_two_directions_keep_them_and_nobody_can_arm():
    drive = Drive()
    drive.codes = {"PCU1_Status1.MotorReverse": 1}
    drive.turn(1000)
    drive.until(Mode.STANDBY).run(1500)
    assert [command[0] >> 4 & 1 for command in drive.commands] == [1, 0]
    for motor_reverse in (False, True):
        drive.demanded = ControllerDemand(motor_reverse=motor_reverse)
        drive.run(500)
        assert drive.arm().sentence == "a change of direction is pending"
        assert [command[0] >> 4 & 1 for command in drive.commands] == [1, 0]
    drive.turn(0)
    drive.run(500)
    assert [command[0] >> 4 & 1 for command in drive.commands] == [1, 1]
    assert drive.arm().granted


def test_two_echoed_directions_may_stay_where_directions_are_independent():
    drive = Drive(independent_directions=True)
    drive.codes = {"PCU1_Status1.MotorReverse": 1}
    drive.turn(1000)
    drive.demanded = None
    drive.until(Mode.STANDBY).run(1500)
    each = {"PCU1": ControllerDemand(motor_reverse=True), "PCU2": ControllerDemand()}
    for _ in range(5):
        drive.offer(ControllerDemand(), controllers=each)
        drive.tick()
    assert drive.arm().granted
    drive.tick()
    assert [command[0] >> 4 & 1 for command in drive.commands] == [1, 0]


@pytest.mark.parametrize("mode", [Mode.STARTING, Mode.STANDBY, Mode.ACTIVE])
def test_the_safe_frames_of_any_mode_are_zero_torque(mode):
    drive = in_mode(mode)
    drive.demanded = ControllerDemand(throttle_pct=50)
    drive.run(300)
    frames = drive.gateway.safe_frames()
    assert {frame.controller: frame.data for frame in frames} == dict.fromkeys(
        ("PCU1", "PCU2"), ZERO_TORQUE
    )
    assert [frame.can_id for frame in frames] == [COMMAND_IDS["PCU1"], COMMAND_IDS["PCU2"]]


def test_the_safe_frames_keep_a_power_cut_and_the_direction():
    drive = standby()
    drive.demanded = ControllerDemand(motor_reverse=True)
    drive.tick()
    drive.gateway.requests.emergency_stop()
    drive.tick()
    assert [frame.data.hex() for frame in drive.gateway.safe_frames()] == ["9c000000e02e0000"] * 2


def test_asking_for_the_safe_frames_changes_nothing():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=10)
    drive.run(500)
    before = drive.commands
    drive.gateway.safe_frames()
    drive.tick()
    assert drive.commands == before


def test_the_first_frames_keep_the_direction_that_each_controller_echoes():
    drive = Drive()
    drive.codes = {"PCU1_Status1.MotorReverse": 1}
    drive.demanded = None
    drive.until(Mode.STANDBY)
    assert [command[0] & 0x10 for command in drive.commands] == [0x10, 0]


def test_an_echo_turns_no_controller_that_was_sent_a_direction_though_the_other_was_not():
    drive = Drive()
    drive.silent = {"PCU1_Status1", "PCU2_Status1"}
    drive.run(950)
    drive.now_ns += PERIOD_NS
    for frame in drive.gateway.tick(drive.now_ns).frames:
        drive.gateway.sent(frame, frame.controller == "PCU1", drive.now_ns)
    drive.silent = set()
    drive.codes = {f"PCU{n}_Status1.MotorReverse": 1 for n in (1, 2)}
    drive.turn(1000)
    for name in ("PCU1_Status1", "PCU2_Status1"):
        drive.receive(name)
    drive.run(500)
    assert [data[0] >> 4 & 1 for data in drive.commands] == [0, 1]
    assert drive.gateway.supervisor.latch is None


def test_an_echo_after_the_first_frames_changes_no_direction():
    drive = standby()
    drive.codes = {f"PCU{n}_Status1.MotorReverse": 1 for n in (1, 2)}
    drive.demanded = None
    drive.run(2000)
    assert drive.commands == [ZERO_TORQUE] * 2
