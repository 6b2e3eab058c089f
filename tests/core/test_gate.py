"""The gate, on bytes: nothing here is made by the modules that it checks."""

import ast
import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.core import gate as gate_module
from vcu_gateway.core.gate import Gate
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.tuning import SlipLimiter, Tuning

MS = 1_000_000
PCU1_ID, PCU2_ID = 0x0008A7D0, 0x0008A8D0
SPEED_MAX_RPM, POWER_MAX_W = 6000, 30_000
IDS = (PCU1_ID, PCU2_ID)
LIMITS = Settings(
    speed_limit_max_rpm=SPEED_MAX_RPM,
    power_limit_max_w=POWER_MAX_W,
    throttle_slew_pct_per_s=100.0,
    direction_change_rpm=50.0,
    period_ns=50 * MS,
    power_slew_w_per_s=60_000.0,
    speed_slew_rpm_per_s=4_000.0,
    regen_min_rpm=100.0,
    independent_directions=False,
)


class Asked(NamedTuple):
    throttle_pct: float
    brake_pct: float
    power_limit_w: float


ALL = Asked(100.0, 100.0, 65_535.0)
ROLLING = (1_000.0, 1_000.0)
STANDING = (0.0, 0.0)
ZERO_TORQUE = bytes.fromhex("0c00000070170000")
ZERO_TORQUE_REVERSE = bytes.fromhex("1c00000070170000")
POWER_CUT = bytes.fromhex("8c00000070170000")
POWER_CUT_REVERSE = bytes.fromhex("9c00000070170000")
SAFE_FRAMES = [ZERO_TORQUE, ZERO_TORQUE_REVERSE, POWER_CUT, POWER_CUT_REVERSE]


def frame(first=0x04, throttle=0, brake=0, *, b4=0, speed=SPEED_MAX_RPM, power=POWER_MAX_W):
    """Bytes of a command: `first` 0x04 is power mode 1, forward, no regeneration."""
    return bytes((first, throttle, brake, b4, speed & 255, speed >> 8, power & 255, power >> 8))


@pytest.fixture
def gate():
    """A gate that has seen one zero-torque frame leave for each controller, at 0."""
    gate = Gate(IDS, LIMITS)
    gate.sent(0, ZERO_TORQUE, 0)
    gate.sent(1, ZERO_TORQUE, 0)
    return gate


def check(
    gate, data, *, slot=0, can_id=None, armed=True, demanded=ALL, speeds=STANDING, now_ns=50 * MS
):
    can_id = (PCU1_ID, PCU2_ID)[slot] if can_id is None else can_id
    return gate.check(
        slot, can_id, data, armed=armed, demanded=demanded, speeds_rpm=speeds, now_ns=now_ns
    )


def assert_passes(gate, data, **facts):
    assert check(gate, data, **facts) is None
    assert gate.blocked == {}


def assert_blocked(gate, rule, data, **facts):
    assert check(gate, data, **facts) == rule
    assert gate.blocked == {rule: 1}


# Identifier and length.


@pytest.mark.parametrize("slot", [0, 1])
def test_the_identifier_of_its_slot_passes(gate, slot):
    assert_passes(gate, frame(), slot=slot)


@pytest.mark.parametrize(
    ("slot", "can_id"),
    [
        (0, PCU2_ID),
        (1, PCU1_ID),
        (0, PCU1_ID | 1 << 26),
        (0, PCU1_ID + 1),
        (0, PCU1_ID - 1),
        (0, 0),
        (1, 0x1808D0F4),
    ],
)
def test_any_other_identifier_is_blocked(gate, slot, can_id):
    assert_blocked(gate, "identifier", frame(), slot=slot, can_id=can_id)


def test_even_the_safe_frame_needs_the_identifier_of_its_slot(gate):
    assert_blocked(gate, "identifier", POWER_CUT, can_id=PCU2_ID)


@pytest.mark.parametrize("length", [0, 1, 7, 9, 64])
def test_any_length_but_eight_is_blocked(gate, length):
    assert_blocked(gate, "length", (ZERO_TORQUE * 8)[:length])


# Bits that are not used.


@pytest.mark.parametrize(
    ("bit", "data"),
    [
        ("b1.0", frame(0x05)),
        ("b1.1", frame(0x06)),
        ("b1.6", frame(0x44)),
        *((f"b4.{bit}", frame(b4=1 << bit)) for bit in range(8)),
        ("safe b1.0", bytes([ZERO_TORQUE[0] | 1]) + ZERO_TORQUE[1:]),
    ],
)
def test_a_bit_that_is_not_used_is_blocked(gate, bit, data):
    assert_blocked(gate, "unused_bits", data)


@pytest.mark.parametrize("first", [0x00, 0x04, 0x08, 0x0C, 0x20, 0x80])
def test_every_bit_that_is_used_passes(gate, first):
    assert_passes(gate, frame(first), speeds=ROLLING)


# Ranges and maxima.


@pytest.mark.parametrize("speed", [500, 501, SPEED_MAX_RPM - 1, SPEED_MAX_RPM])
@pytest.mark.parametrize("first", [0x04, 0x0C])
def test_a_speed_limit_of_500_up_to_the_maximum_passes(speed, first):
    assert check(Gate(IDS, LIMITS), frame(first, speed=speed, power=0)) is None


@pytest.mark.parametrize("speed", [0, 1, 499, SPEED_MAX_RPM + 1, 12_000, 0xFFFF])
@pytest.mark.parametrize("armed", [True, False])
def test_any_other_speed_limit_is_blocked(gate, speed, armed):
    assert_blocked(gate, "speed_limit", frame(speed=speed), armed=armed)


def test_a_safe_frame_with_a_speed_limit_above_the_maximum_is_replaced_by_the_right_one(gate):
    assert_blocked(gate, "speed_limit", bytes.fromhex("0c00000071170000"))


@pytest.mark.parametrize("power", [0, 1, POWER_MAX_W])
def test_a_power_limit_up_to_the_maximum_passes(gate, power):
    assert_passes(gate, frame(power=power))


@pytest.mark.parametrize("power", [POWER_MAX_W + 1, 60_000, 0xFFFF])
def test_a_power_limit_above_the_maximum_is_blocked(gate, power):
    assert_blocked(gate, "power_limit", frame(power=power))


# Limits on their way.


@pytest.mark.parametrize(
    ("speed", "rule"),
    [
        (SPEED_MAX_RPM, None),
        (SPEED_MAX_RPM - 200, None),  # 4,000 rpm/s in 50 ms
        (SPEED_MAX_RPM - 201, None),  # half a bit of rounding now, half a bit before
        (SPEED_MAX_RPM - 202, "speed_slew"),
        (500, "speed_slew"),
    ],
)
@pytest.mark.parametrize("first", [0x04, 0x0C])
@pytest.mark.parametrize("now_ns", [0, 50 * MS, 10_000 * MS])
def test_the_speed_limit_falls_by_one_periods_slew_at_most(gate, speed, rule, first, now_ns):
    data = frame(first, speed=speed, power=0)
    assert check(gate, data, armed=first == 0x04, now_ns=now_ns) == rule


def test_a_speed_limit_that_falls_too_fast_is_blocked(gate):
    gate.sent(0, frame(speed=12_000), 0)
    assert_blocked(gate, "speed_slew", frame(speed=6_000))


@pytest.mark.parametrize("speed", [500, 501, 5_999, SPEED_MAX_RPM])
def test_the_speed_limit_rises_at_once(speed):
    gate = Gate(IDS, LIMITS)
    gate.sent(0, frame(speed=500), 0)
    assert_passes(gate, frame(speed=speed))


@pytest.mark.parametrize(
    ("speed", "rule"),
    [
        (12_000, "speed_limit"),
        (11_902, "speed_limit"),
        (11_901, None),  # 100 rpm in half a period, one bit of rounding
        (11_800, None),
        (11_799, None),
        (11_798, "speed_slew"),
    ],
)
@pytest.mark.parametrize("first", [0x04, 0x0C])
def test_above_a_maximum_that_became_stricter_the_speed_limit_comes_down(speed, rule, first):
    gate = Gate(IDS, LIMITS)
    gate.sent(0, frame(first, speed=12_000, power=0), 0)
    assert check(gate, frame(first, speed=speed, power=0)) == rule


@pytest.mark.parametrize(
    ("power", "rule"),
    [
        (60_000, "power_limit"),
        (58_502, "power_limit"),
        (58_501, None),  # 1,500 W in half a period, one bit of rounding
        (57_000, None),
        (0, None),
    ],
)
def test_above_a_maximum_that_became_stricter_the_power_limit_comes_down(power, rule):
    gate = Gate(IDS, LIMITS)
    gate.sent(0, frame(power=60_000), 0)
    assert check(gate, frame(power=power)) == rule


@pytest.mark.parametrize(("speed", "power"), [(SPEED_MAX_RPM + 1, 0), (6_000, POWER_MAX_W + 1)])
def test_before_the_first_frame_left_nothing_is_on_its_way(speed, power):
    assert check(Gate(IDS, LIMITS), frame(speed=speed, power=power)) is not None


# Regeneration.


@pytest.mark.parametrize(
    ("speeds", "rule"),
    [
        ((100.0, 100.0), None),
        ((math.nextafter(100, 0), 100.0), "regeneration"),
        ((100.0, math.nextafter(100, 0)), "regeneration"),
        ((None, 1_000.0), "regeneration"),
        ((1_000.0, None), "regeneration"),
    ],
)
@pytest.mark.parametrize("data", [frame(0x24), frame(0x24, brake=255)])
def test_nothing_regenerates_unless_both_motors_are_known_to_turn(gate, speeds, rule, data):
    assert check(gate, data, speeds=speeds) == rule


@pytest.mark.parametrize("speeds", [(0.0, 0.0), (None, None)])
def test_the_pedal_alone_passes_at_any_speed(gate, speeds):
    assert_passes(gate, frame(brake=255), speeds=speeds)


@pytest.mark.parametrize("speeds", [(0.0, 0.0), (None, None)])
def test_a_least_speed_of_zero_lets_everything_regenerate(gate, speeds):
    gate.limits = replace(LIMITS, regen_min_rpm=0)
    assert_passes(gate, frame(0x24, brake=255), speeds=speeds)


def test_a_least_speed_of_one_rpm_lets_nothing_brake_at_a_standstill(gate):
    gate.limits = replace(LIMITS, regen_min_rpm=1)
    assert_blocked(gate, "regeneration", frame(0x24, brake=255), speeds=STANDING)


# Throttle.


@pytest.mark.parametrize(("throttle", "rule"), [(0, None), (1, "power_mode")])
def test_there_is_no_throttle_in_power_mode_safety(gate, throttle, rule):
    assert check(gate, frame(0x0C, throttle)) == rule


@pytest.mark.parametrize(("throttle", "rule"), [(0, None), (1, "directions")])
@pytest.mark.parametrize("slot", [0, 1])
def test_there_is_no_throttle_while_the_slots_have_two_directions(gate, throttle, rule, slot):
    gate.sent(1, ZERO_TORQUE_REVERSE, 0)
    first = 0x14 if slot else 0x04
    assert check(gate, frame(first, throttle), slot=slot) == rule


def test_two_directions_pass_where_the_configuration_says_so(gate):
    gate.limits = replace(LIMITS, independent_directions=True)
    gate.sent(1, ZERO_TORQUE_REVERSE, 0)
    assert_passes(gate, frame(throttle=1))


# Unarmed means zero torque.


@pytest.mark.parametrize(
    ("field", "data"),
    [
        ("eco", bytes.fromhex("0000000070170000")),
        ("normal", bytes.fromhex("0400000070170000")),
        ("turbo", bytes.fromhex("0800000070170000")),
        ("regeneration", bytes.fromhex("2c00000070170000")),
        ("throttle", bytes.fromhex("0c01000070170000")),
        ("brake", bytes.fromhex("0c00010070170000")),
        ("power, low byte", bytes.fromhex("0c00000070170100")),
        ("power, high byte", bytes.fromhex("0c00000070170001")),
    ],
)
def test_unarmed_one_field_beyond_the_safe_frame_is_blocked(gate, field, data):
    assert_blocked(gate, "unarmed", data, armed=False)


@pytest.mark.parametrize("data", [ZERO_TORQUE, POWER_CUT, frame(0x0C, speed=5_800, power=0)])
def test_unarmed_a_safe_frame_passes(gate, data):
    assert_passes(gate, data, armed=False)


# Slew.


@pytest.mark.parametrize(
    ("before", "elapsed_ns", "highest"),
    [
        (0, 0, 1),  # nothing earned: half a bit of rounding now, half a bit before
        (0, 25 * MS, 7),  # 2.5 % are 6.4 codes
        (0, 50 * MS, 13),  # 5 % are 12.8 codes
        (100, 50 * MS, 113),
        (240, 50 * MS, 253),
        (0, 51 * MS, 13),  # more than a period earns no more
        (0, 10_000 * MS, 13),
        (100, -1 * MS, 101),  # time that goes backwards earns nothing
        (100, -10_000 * MS, 101),
    ],
)
def test_the_throttle_rises_by_the_slew_since_the_last_frame_sent(before, elapsed_ns, highest):
    at_ns = 1_000_000 * MS
    for throttle, blocked in ((highest, None), (highest + 1, "throttle_slew")):
        gate = Gate(IDS, LIMITS)
        gate.sent(0, frame(throttle=before), at_ns)
        assert check(gate, frame(throttle=throttle), now_ns=at_ns + elapsed_ns) == blocked


def test_a_whole_code_earned_exactly_is_allowed():
    limits = replace(LIMITS, throttle_slew_pct_per_s=39.0, period_ns=10 * MS)
    gate = Gate(IDS, limits)
    gate.sent(0, frame(throttle=10), 0)
    assert check(gate, frame(throttle=12), now_ns=10 * MS) is None
    assert check(gate, frame(throttle=13), now_ns=10 * MS) == "throttle_slew"


@pytest.mark.parametrize("throttle", [0, 1, 100, 199, 200])
def test_the_throttle_falls_or_stays_at_any_time(throttle):
    gate = Gate(IDS, LIMITS)
    gate.sent(0, frame(throttle=200), 0)
    assert_passes(gate, frame(throttle=throttle), now_ns=0)


def test_a_frame_that_was_not_sent_earns_no_rise(gate):
    assert_passes(gate, frame(throttle=13), now_ns=50 * MS)
    assert_blocked(gate, "throttle_slew", frame(throttle=26), now_ns=100 * MS)


def test_each_slot_has_its_own_last_frame(gate):
    gate.sent(0, frame(), 50 * MS)
    gate.sent(1, frame(throttle=13), 50 * MS)
    assert_passes(gate, frame(throttle=26), slot=1, now_ns=100 * MS)
    assert_blocked(gate, "throttle_slew", frame(throttle=26), slot=0, now_ns=100 * MS)


def test_before_the_first_frame_left_only_a_throttle_of_zero_passes():
    assert check(Gate(IDS, LIMITS), frame(throttle=0)) is None
    assert check(Gate(IDS, LIMITS), frame(throttle=1)) == "throttle_slew"


def test_a_stricter_slew_counts_at_once(gate):
    gate.limits = replace(LIMITS, throttle_slew_pct_per_s=10.0)
    assert_passes(gate, frame(throttle=2))
    assert_blocked(gate, "throttle_slew", frame(throttle=3))


# PowerMode.

ECO, NORMAL, TURBO, SAFETY = (code << 2 for code in range(4))
RISING = [SAFETY, ECO, NORMAL, TURBO]


@pytest.mark.parametrize("thrown", [(13, 0), (0, 13), (255, 255)])
@pytest.mark.parametrize("after", RISING)
@pytest.mark.parametrize("before", RISING)
def test_power_mode_rises_only_where_each_slot_was_released(gate, before, after, thrown):
    for slot, throttle in enumerate((12, 12)):
        gate.sent(slot, frame(before, throttle), 0)
    assert_passes(gate, frame(after, brake=1))
    for slot, throttle in enumerate(thrown):
        gate.sent(slot, frame(before, throttle), 0)
    rises = RISING.index(after) > RISING.index(before)
    for slot in (0, 1):
        expected = "power_mode_rise" if rises else None
        assert check(gate, frame(after, brake=1), slot=slot) == expected


def test_power_mode_of_a_slot_without_a_frame_rises_only_where_the_other_was_released():
    gate = Gate(IDS, LIMITS)
    gate.sent(1, frame(ECO, 12), 0)
    assert check(gate, frame(ECO)) is None
    gate.sent(1, frame(ECO, 13), 0)
    assert check(gate, frame(ECO)) == "power_mode_rise"
    assert check(gate, frame(SAFETY, brake=1)) is None
    assert check(gate, ZERO_TORQUE) is None


# Direction.


@pytest.mark.parametrize(
    "speeds", [(0.0, 0.0), (49.9, 49.9), (49.9, 0.0), (math.nextafter(50, 0), 49)]
)
@pytest.mark.parametrize("data", [frame(0x14), ZERO_TORQUE_REVERSE, POWER_CUT_REVERSE])
def test_the_direction_changes_while_both_motors_are_slow(gate, speeds, data):
    assert_passes(gate, data, speeds=speeds)


@pytest.mark.parametrize(
    "speeds", [(50.0, 0.0), (0.0, 50.0), (50.1, 50.1), (None, 0.0), (0.0, None), (None, None)]
)
@pytest.mark.parametrize("data", [frame(0x14), ZERO_TORQUE_REVERSE, POWER_CUT_REVERSE])
@pytest.mark.parametrize("armed", [True, False])
def test_the_direction_stays_while_a_motor_is_not_known_to_be_slow(gate, speeds, data, armed):
    assert_blocked(gate, "direction", data, speeds=speeds, armed=armed)


def test_the_direction_does_not_change_together_with_throttle(gate):
    assert_blocked(gate, "direction", frame(0x14, throttle=1))


def test_the_direction_does_not_change_right_after_throttle():
    gate = Gate(IDS, LIMITS)
    gate.sent(0, frame(throttle=1), 0)
    assert_blocked(gate, "direction", frame(0x14))


@pytest.mark.parametrize("speeds", [(6000.0, 6000.0), (None, None)])
@pytest.mark.parametrize("first", [0x04, 0x14])
def test_the_direction_that_was_sent_passes_at_any_speed(speeds, first):
    gate = Gate(IDS, LIMITS)
    gate.sent(0, frame(first, throttle=50), 0)
    assert_passes(gate, frame(first, throttle=50), speeds=speeds)


def test_a_change_that_did_not_leave_is_still_a_change(gate):
    assert_passes(gate, frame(0x14), speeds=STANDING)
    assert_blocked(gate, "direction", frame(0x14), speeds=(50.0, 50.0))


# Blocked frames.


def test_every_blocked_frame_is_counted_by_its_rule(gate):
    for data in (frame(power=0xFFFF), frame(power=0xFFFF), frame(throttle=99), b"", frame()):
        check(gate, data)
    check(gate, frame(throttle=99), slot=1)
    assert gate.blocked == {"power_limit": 2, "throttle_slew": 2, "length": 1}


def test_a_frame_sent_is_kept_as_it_was_then(gate):
    data = bytearray(frame())
    gate.sent(0, data, 0)
    data[1] = 255
    assert_blocked(gate, "throttle_slew", frame(throttle=100))


# Whatever happened before.

LAST_SENT = st.none() | st.builds(
    frame,
    st.sampled_from([0x00, 0x04, 0x08, 0x0C, 0x14, 0x34, 0x8C]),
    st.integers(0, 255),
    st.integers(0, 255),
    speed=st.integers(0, 12_000),
    power=st.integers(0, 60_000),
)
SPEEDS = st.tuples(*[st.none() | st.floats(0, 6000)] * 2)
TIMES_NS = st.integers(-(10**12), 10**15)


def gate_after(last_sent):
    gate = Gate(IDS, LIMITS)
    if last_sent is not None:
        gate.sent(0, last_sent, 0)
    return gate


@given(last_sent=LAST_SENT, armed=st.booleans(), speeds=SPEEDS, now_ns=TIMES_NS, cut=st.booleans())
def test_the_safe_frame_always_passes(last_sent, armed, speeds, now_ns, cut):
    gate = gate_after(last_sent)
    speed = SPEED_MAX_RPM
    if last_sent is not None:
        speed = max(speed, (last_sent[4] | last_sent[5] << 8) - 200)
    reverse = 0x10 if last_sent is not None and last_sent[0] & 0x10 else 0
    data = bytearray(frame(0x0C | reverse, speed=speed, power=0))
    data[0] |= 0x80 if cut else 0
    assert_passes(gate, bytes(data), armed=armed, speeds=speeds, now_ns=now_ns)


@given(
    last_sent=LAST_SENT,
    data=st.binary(max_size=12) | LAST_SENT.filter(bool),
    armed=st.booleans(),
    speeds=SPEEDS,
    now_ns=TIMES_NS,
    can_id=st.sampled_from([PCU1_ID, PCU2_ID]) | st.integers(0, 2**29 - 1),
)
def test_whatever_passes_is_the_slots_own_and_carries_torque_only_when_armed(
    last_sent, data, armed, speeds, now_ns, can_id
):
    gate = gate_after(last_sent)
    rule = check(gate, data, can_id=can_id, armed=armed, speeds=speeds, now_ns=now_ns)
    assert gate.blocked == ({} if rule is None else {rule: 1})
    if rule is None:
        assert (can_id, len(data)) == (PCU1_ID, 8)
        first, throttle, brake, _, _, _, power_low, power_high = data
        torque = (throttle, brake, power_low, power_high, first & 0x2C)
        assert armed or torque == (0, 0, 0, 0, 0x0C)


# Independence.


def test_the_gate_imports_nothing_of_the_modules_that_it_checks():
    tree = ast.parse(Path(gate_module.__file__).read_text(encoding="utf-8"))
    imported = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(node.module)
    assert imported == {"dataclasses", "typing"}


# What is demanded.


@pytest.mark.parametrize(
    ("data", "demanded"),
    [
        (frame(throttle=10), (3.9, 0.0, 60_000.0)),
        (frame(throttle=10), (3.706, 0.0, 60_000.0)),
        (frame(brake=100), (0.0, 38.806, 60_000.0)),
        (frame(power=6000), (0.0, 0.0, 5999.5)),
    ],
)
def test_what_is_demanded_passes_rounded(gate, data, demanded):
    assert_passes(gate, data, demanded=Asked(*demanded))


@pytest.mark.parametrize(
    ("data", "demanded"),
    [
        (frame(throttle=11), (3.9, 0.0, 60_000.0)),
        (frame(throttle=10), (3.704, 0.0, 60_000.0)),
        (frame(throttle=1), (0.0, 100.0, 60_000.0)),
        (frame(brake=101), (100.0, 39.0, 60_000.0)),
        (frame(brake=1), (100.0, 0.0, 60_000.0)),
        (frame(power=6001), (100.0, 100.0, 6000.0)),
        (frame(power=6000), (100.0, 100.0, 5999.4)),
    ],
)
def test_more_than_is_demanded_is_blocked(gate, data, demanded):
    assert_blocked(gate, "not_demanded", data, demanded=Asked(*demanded))


def test_half_a_bit_of_rounding_is_not_more_than_is_demanded(gate):
    assert_passes(gate, frame(throttle=2), demanded=Asked(0.585, 100.0, 60_000.0))


@pytest.mark.parametrize("safe", SAFE_FRAMES[:2])
def test_a_safe_frame_needs_no_demand(gate, safe):
    data = safe if safe is ZERO_TORQUE else ZERO_TORQUE
    assert_passes(gate, data, demanded=None)


def test_without_a_demand_nothing_but_a_safe_frame_passes(gate):
    assert_blocked(gate, "not_demanded", frame(throttle=0), demanded=None)


# Both together.

STEP_PCT = 5.0
APART_RAW = int(4 * STEP_PCT / 0.39) + 1  # four steps of the slew, rounded


def check_both(gate, throttles, *, first=(0x04, 0x04), demanded_alike=True):
    data = [frame(byte, throttle=raw) for byte, raw in zip(first, throttles, strict=True)]
    return gate.check_both(*data, demanded_alike=demanded_alike)


def sent_apart(*throttles_raw) -> Gate:
    gate = Gate(IDS, LIMITS)
    for slot, raw in enumerate(throttles_raw):
        gate.sent(slot, frame(throttle=raw), 0)
    return gate


@pytest.mark.parametrize("throttles", [(100, 100 + APART_RAW), (100 + APART_RAW, 100), (9, 9)])
def test_throttles_of_equal_demands_may_be_four_steps_apart(throttles):
    assert check_both(sent_apart(0, 0), throttles) is None


@pytest.mark.parametrize("throttles", [(100, 101 + APART_RAW), (101 + APART_RAW, 100), (0, 255)])
def test_throttles_of_equal_demands_that_are_further_apart_are_blocked(throttles):
    gate = sent_apart(0, 0)
    assert check_both(gate, throttles) == "asymmetry"
    assert gate.blocked == {"asymmetry": 1}
    assert check_both(gate, throttles, demanded_alike=False) is None


def test_throttles_may_stay_as_far_apart_as_they_were_sent():
    gate = sent_apart(0, 200)
    assert check_both(gate, (10, 211)) is None
    assert check_both(gate, (10, 212)) == "asymmetry"
    assert check_both(sent_apart(100, 100), (100, 101 + APART_RAW)) == "asymmetry"


@pytest.mark.parametrize("first", [(0x0C, 0x04), (0x04, 0x0C)])
def test_a_controller_in_safety_is_left_behind(first):
    assert check_both(sent_apart(0, 0), (0, 255), first=first) is None


def test_in_other_power_modes_that_differ_throttles_stay_together():
    assert check_both(sent_apart(0, 0), (0, 255), first=(0x00, 0x08)) == "asymmetry"


def test_a_slip_limiter_may_have_them_further_apart():
    slip = replace(LIMITS, tuning=Tuning(slip=SlipLimiter(asymmetry_max_pct=20)))
    gate = Gate(IDS, slip)
    assert check_both(gate, (0, APART_RAW + 51)) is None
    assert check_both(gate, (0, APART_RAW + 52)) == "asymmetry"
