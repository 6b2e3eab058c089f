"""The motors' speeds at a tick, and limits that they are held against."""

import math

import pytest

from tests.core.safety_world import CODEC, data
from vcu_gateway.core import motor_speeds
from vcu_gateway.core.plausibility import NO_DEVIATION, Observed
from vcu_gateway.core.state import Store

STATUS2 = ("PCU1_Status2", "PCU2_Status2")
BELOW, ABOVE = math.nextafter(30, 0), math.nextafter(30, 60)


@pytest.fixture
def store(protocol) -> Store:
    return Store(protocol.received_by("VCU"), dict.fromkeys(STATUS2, 1000))


def put(store: Store, *first_rpm: int, second_rpm: int = 40) -> None:
    """Frames of the first motor, and one of the second."""
    for name, rpm in [*((STATUS2[0], rpm) for rpm in first_rpm), (STATUS2[1], second_rpm)]:
        store.put(name, CODEC.by_name[name].decode(data(name, {"MotorSpeed": rpm})), 0)


def test_the_lowest_and_the_highest_since_the_tick_before_are_told(store):
    put(store, 30, 10, 20)
    assert motor_speeds.of(store.take(0), NO_DEVIATION) == ((10, 40), (30, 40))


def test_a_speed_that_jumped_is_not_known_and_the_other_is(store):
    put(store, 30)
    observed = Observed(speed_steps_rpm={"PCU1": 700})
    assert motor_speeds.of(store.take(0), observed) == ((None, 40), (None, 40))


def test_a_stale_speed_is_not_known(store):
    put(store, 30)
    assert motor_speeds.of(store.take(1001), NO_DEVIATION) == motor_speeds.UNKNOWN


@pytest.mark.parametrize(
    ("speed", "below", "at_least"),
    [(BELOW, True, False), (30, False, True), (ABOVE, False, True), (None, False, False)],
)
def test_a_limit_holds_for_both_motors_or_not_at_all(speed, below, at_least):
    for pair in ((speed, 0), (0, speed), (speed, speed)):
        assert motor_speeds.all_below(pair, 30) is below
    for pair in ((speed, 60), (60, speed), (speed, speed)):
        assert motor_speeds.all_at_least(pair, 30) is at_least
