"""From commands to frames: exact bytes, what the gate says of them, and the history of sent."""

import dataclasses

import pytest

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, PowerMode
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.transmit import OutFrame, SentHistory, SentValues, Transmitter

MS = 1_000_000
PCU1_ID, PCU2_ID = 0x0008A7D0, 0x0008A8D0
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")
STANDING = (0.0, 0.0)
ALL = dict.fromkeys(CONTROLLERS, ControllerDemand(throttle_pct=100, brake_pct=100))


@pytest.fixture
def output(codec):
    return Transmitter(codec, Settings())


def decided(first=None, second=None, **both):
    return {"PCU1": first or Command(**both), "PCU2": second or Command(**both)}


@pytest.mark.parametrize(
    ("command", "data"),
    [
        (Command(), "0c000000e02e0000"),
        (Command(power_cut=True), "8c000000e02e0000"),
        (Command(motor_reverse=True), "1c000000e02e0000"),
        (Command(regen_brake=True), "2c000000e02e0000"),
        (Command(power_mode=PowerMode.ECO), "00000000e02e0000"),
        (Command(power_mode=PowerMode.NORMAL), "04000000e02e0000"),
        (Command(power_mode=PowerMode.TURBO), "08000000e02e0000"),
        (Command(throttle_pct=0.39), "0c010000e02e0000"),
        (Command(throttle_pct=100), "0cff0000e02e0000"),
        (Command(brake_pct=39), "0c006400e02e0000"),
        (Command(speed_limit_rpm=0x1234), "0c00000034120000"),
        (Command(power_limit_w=0x1234), "0c000000e02e3412"),
    ],
)
def test_a_command_has_exactly_these_bytes(output, command, data):
    assert output.encoded(decided(command, command)) == (
        OutFrame("PCU1", PCU1_ID, bytes.fromhex(data)),
        OutFrame("PCU2", PCU2_ID, bytes.fromhex(data)),
    )


def test_each_controller_gets_its_own_command(output):
    frames = output.encoded(decided(Command(), Command(power_cut=True)))
    assert [frame.data[0] for frame in frames] == [0x0C, 0x8C]


def test_like_commands_are_encoded_by_each_controllers_own_layout(codec):
    def halved(message):
        if message.name != "VCU_PCU2_Command":
            return message
        signals = tuple(
            dataclasses.replace(one, factor=one.factor * 2) if one.name == "Throttle" else one
            for one in message.signals
        )
        return dataclasses.replace(message, signals=signals)

    messages = tuple(map(halved, codec.protocol.messages))
    output = Transmitter(Codec(dataclasses.replace(codec.protocol, messages=messages)), Settings())
    frames = output.encoded(decided(throttle_pct=39))
    assert [frame.data[1] for frame in frames] == [100, 50]


@pytest.mark.parametrize("priority", range(8))
def test_the_transmit_priority_is_configuration_and_the_gate_knows_it(codec, priority):
    output = Transmitter(codec, Settings(transmit_priority=priority))
    frames = output.encoded(decided())
    assert [frame.can_id for frame in frames] == [
        PCU1_ID | priority << 26,
        PCU2_ID | priority << 26,
    ]
    assert output.fault_of(frames, False, ALL, STANDING, 0) is None


def test_both_frames_are_shown_to_the_gate_each_in_its_slot(output):
    good, bad = (
        Command(power_mode=PowerMode.ECO),
        Command(power_mode=PowerMode.ECO, throttle_pct=100),
    )
    for frames, rule in (
        (output.encoded(decided(good, good)), None),
        (output.encoded(decided(bad, good)), "throttle_slew"),
        (output.encoded(decided(good, bad)), "throttle_slew"),
        (tuple(reversed(output.encoded(decided(good, good)))), "identifier"),
    ):
        assert output.fault_of(frames, True, ALL, STANDING, 0) == rule
    assert output.gate.blocked == {"throttle_slew": 2, "identifier": 2}


def test_the_gate_is_told_whether_torque_is_allowed_and_how_fast_the_motors_turn(output):
    frames = output.encoded(decided(power_mode=PowerMode.ECO))
    assert output.fault_of(frames, False, ALL, STANDING, 0) == "unarmed"
    for frame in frames:
        output.note_sent(frame, 0)
    turned = output.encoded(decided(motor_reverse=True))
    assert output.fault_of(turned, True, ALL, (0.0, 50.0), 0) == "direction"
    assert output.fault_of(turned, True, ALL, STANDING, 0) is None


def test_a_frame_that_was_sent_is_what_the_next_one_is_held_against(output):
    low, high = (
        output.encoded(decided(power_mode=PowerMode.ECO, throttle_pct=pct)) for pct in (4.0, 8.0)
    )
    for frame in low[:1]:
        output.note_sent(frame, 1_000 * MS)
    assert output.fault_of(high[:1], True, ALL, STANDING, 1_050 * MS) is None
    assert output.fault_of(high, True, ALL, STANDING, 1_050 * MS) == "throttle_slew"


def test_what_was_sent_is_booked_as_the_wire_carried_it(output):
    first, second = output.encoded(decided(throttle_pct=100))
    output.note_sent(first, 7)
    history = output.history.frames
    assert [(sent.at_ns, sent.throttle_pct) for sent in history["PCU1"]] == [
        (7, pytest.approx(99.45))
    ]
    assert not history["PCU2"]
    output.note_sent(second, 8)
    assert output.history.frames["PCU2"][0].at_ns == 8


@pytest.mark.parametrize(
    ("change", "command", "rule"),
    [
        ({"speed_limit_max_rpm": 11_899}, {"speed_limit_rpm": 11_950}, "speed_limit"),
        ({"speed_slew_rpm_per_s": 2000}, {"speed_limit_rpm": 11_800}, "speed_slew"),
        ({"power_limit_max_w": 5999}, {"power_limit_w": 6000}, "power_limit"),
        ({"throttle_slew_pct_per_s": 10}, {"throttle_pct": 4.0}, "throttle_slew"),
        ({"direction_change_rpm": 30.0}, {"motor_reverse": True}, "direction"),
        ({"regen_min_rpm": 31.0}, {"regen_brake": True}, "regeneration"),
    ],
)
def test_new_limits_count_from_the_next_frame_on(codec, change, command, rule):
    settings = Settings(regen_min_rpm=30.0)
    output = Transmitter(codec, settings)
    for frame in output.encoded(decided()):
        output.note_sent(frame, 0)
    frames = output.encoded(decided(power_mode=PowerMode.ECO, **command))
    speeds = (30.0, 30.0)
    assert output.fault_of(frames, True, ALL, speeds, 50 * MS) is None
    output.gate.limits = dataclasses.replace(settings, **change)
    assert output.fault_of(frames, True, ALL, speeds, 50 * MS) == rule


def test_the_period_of_the_gate_is_the_configured_one(codec):
    output = Transmitter(codec, Settings(period_ns=20 * MS))
    for frame in output.encoded(decided()):
        output.note_sent(frame, 0)
    frames = output.encoded(decided(power_mode=PowerMode.ECO, throttle_pct=4.0))
    assert output.fault_of(frames, True, ALL, STANDING, 50 * MS) == "throttle_slew"


def test_the_gate_knows_how_a_power_limit_comes_down_and_whether_directions_may_differ(codec):
    settings = Settings(power_slew_w_per_s=1000.0, independent_directions=True)
    output = Transmitter(codec, settings)
    assert output.gate.limits.power_slew_w_per_s == 1000.0
    assert output.gate.limits.independent_directions is True


def test_without_any_demand_the_frames_are_zero_torque_and_pass_unarmed(output):
    frames = output.encoded(decided())
    assert {frame.data for frame in frames} == {ZERO_TORQUE}
    assert output.fault_of(frames, False, ALL, STANDING, 0) is None


BOTH = ("PCU1", "PCU2")


class Ticks:
    """One tick after the other; each says which echoes had come back before it."""

    def __init__(self) -> None:
        self.history = SentHistory(BOTH)
        self.confirmed = dict.fromkeys(BOTH, 0)

    def tick(self, *echoes: str, emits: bool = True) -> int:
        for name in echoes:
            self.confirmed[name] += 1
        missed = self.history.note_confirmed(self.confirmed)
        self.history.emitted = emits
        return missed


def test_the_first_tick_misses_nothing():
    assert Ticks().tick() == 0


def test_every_tick_without_an_echo_is_counted_until_one_comes():
    ticks = Ticks()
    assert [ticks.tick() for _ in range(5)] == [0, 1, 2, 3, 4]
    assert ticks.tick(*BOTH) == 0
    assert ticks.tick() == 1


@pytest.mark.parametrize("name", BOTH)
def test_the_echo_of_one_controllers_frame_does_not_confirm_the_others(name):
    ticks = Ticks()
    assert [ticks.tick(name) for _ in range(4)] == [0, 1, 2, 3]


def test_several_echoes_at_once_are_as_good_as_one():
    ticks = Ticks()
    ticks.tick()
    assert ticks.tick("PCU1", "PCU1", "PCU2", "PCU2") == 0


def test_a_tick_after_one_that_sent_nothing_misses_nothing():
    ticks = Ticks()
    assert [ticks.tick(emits=False) for _ in range(5)] == [0] * 5


def test_silence_of_our_own_does_not_excuse_what_was_missed_before():
    ticks = Ticks()
    assert [ticks.tick(), ticks.tick(), ticks.tick(emits=False)] == [0, 1, 2]
    assert [ticks.tick(emits=False), ticks.tick()] == [2, 2]
    assert ticks.tick(*BOTH) == 0


def test_the_history_holds_each_controllers_throttles_oldest_first():
    sending = SentHistory(BOTH)
    sending.note_sent("PCU1", SentValues(1, 10.0))
    sending.note_sent("PCU2", SentValues(2, 20.0, reverse=True))
    sending.note_sent("PCU1", SentValues(3, 30.0))
    assert {name: list(sent) for name, sent in sending.frames.items()} == {
        "PCU1": [SentValues(1, 10.0), SentValues(3, 30.0)],
        "PCU2": [SentValues(2, 20.0, reverse=True)],
    }


def test_the_history_reaches_over_the_echo_window_and_is_bounded():
    """1.1 s before a Status1 of up to 1.6 s: 54 frames of 50 ms."""
    sending = SentHistory(BOTH)
    for number in range(1000):
        sending.note_sent("PCU1", SentValues(number * 50_000_000, 1.0))
    kept = sending.frames["PCU1"]
    assert kept[-1].at_ns - kept[0].at_ns >= 2_700_000_000
    assert len(kept) <= 100


def test_released_is_a_last_throttle_below_5_pct_for_each_controller():
    sending = SentHistory(BOTH)
    sending.note_sent("PCU1", SentValues(1, 0.0))
    assert not sending.released, "nothing is known of PCU2"
    for first_raw, second_raw in ((12, 12), (13, 12), (12, 13), (0, 0)):
        sending.note_sent("PCU1", SentValues(2, first_raw * 0.39))
        sending.note_sent("PCU2", SentValues(2, second_raw * 0.39))
        assert sending.released is (first_raw <= 12 and second_raw <= 12)


def test_the_place_of_power_cut_is_the_one_bit_that_a_cut_changes(output):
    safe, cut = output.encoded(decided()), output.encoded(decided(power_cut=True))
    for before, after in zip(safe, cut, strict=True):
        byte, mask = output.power_cut_bits()[after.controller]
        changed = int.from_bytes(before.data) ^ int.from_bytes(after.data)
        assert changed == mask << 8 * (7 - byte)
