"""The motors' speeds at a tick, and limits that they are held against."""

import math

import pytest

from tests.core.simulated_drive import CODEC, data
from vcu_gateway.core import plausibility
from vcu_gateway.core.plausibility import NO_DEVIATION, Observed, RegenerationInterlock
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
    assert plausibility.of(store.take(0), NO_DEVIATION) == ((10, 40), (30, 40))


def test_a_speed_that_jumped_is_not_known_and_the_other_is(store):
    put(store, 30)
    observed = Observed(speed_steps_rpm={"PCU1": 700})
    assert plausibility.of(store.take(0), observed) == ((None, 40), (None, 40))


def test_a_stale_speed_is_not_known(store):
    put(store, 30)
    assert plausibility.of(store.take(1001), NO_DEVIATION) == plausibility.UNKNOWN


@pytest.mark.parametrize(
    ("speed", "below", "at_least"),
    [(BELOW, True, False), (30, False, True), (ABOVE, False, True), (None, False, False)],
)
def test_a_limit_holds_for_both_motors_or_not_at_all(speed, below, at_least):
    for pair in ((speed, 0), (0, speed), (speed, speed)):
        assert plausibility.all_below(pair, 30) is below
    for pair in ((speed, 60), (60, speed), (speed, speed)):
        assert plausibility.all_at_least(pair, 30) is at_least


def possible(*speeds_rpm, min_rpm=100.0):
    regeneration = RegenerationInterlock()
    return [regeneration.possible(speeds, min_rpm) for speeds in speeds_rpm]


@pytest.mark.parametrize("other", [150.0, 6000.0])
def test_it_begins_50_rpm_above_and_ends_below_the_least_speed(other):
    speeds = (149.999, 150.0, 100.0, math.nextafter(100, 0), 149.999, 150.0)
    expected = [False, True, True, False, False, True]
    assert possible(*((speed, other) for speed in speeds)) == expected
    assert possible(*((other, speed) for speed in speeds)) == expected


@pytest.mark.parametrize("unknown", [(None, 200.0), (200.0, None), (None, None)])
def test_a_speed_that_is_not_known_ends_it(unknown):
    assert possible(unknown, (200.0, 200.0), unknown, (120.0, 120.0)) == [False, True, False, False]


def test_a_least_speed_of_zero_switches_it_off():
    assert possible((None, None), (0.0, 0.0), min_rpm=0) == [True, True]
