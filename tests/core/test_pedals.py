"""The pedals between two ticks: each latch at its limits, and one bit or nanosecond beyond."""

import pytest

from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand
from vcu_gateway.core.pedals import Pedals, ThrottleHold

MS = 1_000_000
NOW_NS = 5_000 * MS
FORWARD = dict.fromkeys(CONTROLLERS, False)
BIT_PCT = 0.39


def both(throttle_pct=0.0, brake_pct=0.0, track2_pct=None, reverse=False):
    one = ControllerDemand(
        throttle_pct, brake_pct, motor_reverse=reverse, throttle_track2_pct=track2_pct
    )
    return dict.fromkeys(CONTROLLERS, one)


IDLE = both()


class Driver:
    """Pedals, and demands and ticks on a clock that the test moves."""

    def __init__(self):
        self.pedals = Pedals()
        self.now_ns = NOW_NS

    def asks(self, demanded=None, waited_ns=0, **values):
        demanded = both(**values) if demanded is None else demanded
        self.pedals.judge(demanded, self.now_ns - waited_ns, self.now_ns)
        return self

    def after(self, duration_ns):
        self.now_ns += duration_ns
        return self

    def held(self, demanded=IDLE, applied=FORWARD):
        return self.pedals.tick(demanded, applied, self.now_ns)


@pytest.fixture
def driver():
    return Driver()


def one_of(controller, **values):
    return IDLE | {controller: both(**values)[controller]}


# Brake over throttle.


@pytest.mark.parametrize(
    ("throttle_pct", "brake_pct", "held"),
    [
        (25.0, 5.0, False),
        (25.0, 100.0, False),
        (100.0, 5.0, False),
        (25.0 + BIT_PCT, 5.0 + BIT_PCT, True),
        (25.000001, 5.000001, True),
    ],
)
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_brake_over_throttle_begins_beyond_25_and_5_pct(
    driver, controller, throttle_pct, brake_pct, held
):
    demanded = one_of(controller, throttle_pct=throttle_pct, brake_pct=brake_pct)
    driver.asks(demanded)
    assert (ThrottleHold.OVERRIDE in driver.pedals.latched) is held
    assert driver.held(demanded) is held


@pytest.mark.parametrize(("throttle_pct", "held"), [(5.0, True), (4.999999, False), (0.0, False)])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_brake_over_throttle_ends_below_5_pct_of_both(driver, controller, throttle_pct, held):
    demanded = one_of(controller, throttle_pct=throttle_pct, brake_pct=100)
    driver.asks(throttle_pct=40, brake_pct=10).held(demanded)
    driver.asks(demanded)
    assert driver.held(demanded) is held


def test_a_latch_that_was_set_and_released_between_two_ticks_holds_one_tick(driver):
    driver.asks(throttle_pct=40, brake_pct=10).asks(IDLE).asks(throttle_pct=40)
    assert driver.pedals.latched == set()
    assert driver.held(both(40))
    assert not driver.held(both(40))


def test_a_latch_that_was_released_and_set_between_two_ticks_stays(driver):
    driver.asks(IDLE).asks(throttle_pct=40, brake_pct=10).asks(throttle_pct=40)
    assert driver.held(both(40))
    assert driver.held(both(40))


def test_a_demand_that_nobody_granted_before_the_tick_is_judged_in_it(driver):
    """The bench demand is never granted, it counts from the start."""
    assert driver.held(both(40, 10))
    assert driver.pedals.latched == {ThrottleHold.OVERRIDE}


def test_a_latch_outlasts_the_demand(driver):
    driver.asks(throttle_pct=40, brake_pct=10)
    assert driver.held(None)
    assert driver.held(None)


# Another source.


def test_who_takes_over_is_held_until_less_than_5_pct_is_asked_for(driver):
    driver.pedals.taken_over()
    for pct in (100.0, 5.0):
        driver.asks(throttle_pct=pct)
        assert driver.held(both(pct))
    driver.asks(throttle_pct=4.99).asks(throttle_pct=100)
    assert not driver.held(both(100))


# The tracks.


@pytest.mark.parametrize(
    ("throttle_pct", "track2_pct", "differ"),
    [
        (40, None, False),
        (40, 30, False),
        (30, 40, False),
        (40, 50, False),
        (40, 29.999999, True),
        (40, 50 + BIT_PCT, True),
        (0, 10.000001, True),
        (10.000001, 0, True),
    ],
)
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_tracks_differ_by_more_than_10_pct(driver, controller, throttle_pct, track2_pct, differ):
    demanded = one_of(controller, throttle_pct=throttle_pct, track2_pct=track2_pct)
    driver.asks(demanded).after(100 * MS + 1)
    assert driver.held(demanded) is differ


@pytest.mark.parametrize(("lasted_ns", "held"), [(100 * MS, False), (100 * MS + 1, True)])
@pytest.mark.parametrize("judged", ["at a tick", "by the demand that ends it"])
def test_tracks_may_differ_for_100_ms(driver, lasted_ns, held, judged):
    apart, together = both(40, track2_pct=20), both(40, track2_pct=40)
    driver.asks(apart).after(lasted_ns)
    demanded = apart if judged == "at a tick" else together
    if demanded is together:
        driver.asks(together)
    assert driver.held(demanded) is held


def test_tracks_that_agree_for_a_moment_begin_the_100_ms_anew(driver):
    apart = both(40, track2_pct=20)
    driver.asks(apart).after(100 * MS).asks(throttle_pct=40, track2_pct=40).asks(apart)
    assert not driver.after(100 * MS).held(apart)
    assert driver.after(1).held(apart)


def test_the_time_that_a_demand_waited_counts_for_its_tracks(driver):
    apart = both(40, track2_pct=20)
    driver.asks(apart, waited_ns=60 * MS).after(40 * MS)
    assert not driver.held(apart)
    assert driver.after(1).held(apart)


def test_without_a_fresh_demand_the_tracks_do_not_differ(driver):
    apart = both(40, track2_pct=20)
    driver.asks(apart).after(90 * MS)
    driver.pedals.interrupted()
    driver.asks(apart)
    assert not driver.after(90 * MS).held(apart)


@pytest.mark.parametrize(
    ("throttle_pct", "track2_pct", "held"),
    [(4.99, 4.99, False), (4.99, None, False), (5.0, 4.99, True), (4.99, 5.0, True)],
)
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_the_tracks_latch_ends_with_both_tracks_of_both_below_5_pct(
    driver, controller, throttle_pct, track2_pct, held
):
    apart = both(40, track2_pct=20)
    driver.asks(apart).after(101 * MS).held(apart)
    demanded = one_of(controller, throttle_pct=throttle_pct, track2_pct=track2_pct)
    driver.asks(demanded)
    driver.held(demanded)
    assert driver.held(demanded) is held


# Directions.


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_direction_asked_between_two_ticks_holds_one_tick(driver, controller):
    driver.asks(one_of(controller, reverse=True)).asks(IDLE)
    assert driver.held()
    assert not driver.held()


def test_the_applied_direction_holds_nothing(driver):
    backward = dict.fromkeys(CONTROLLERS, True)
    driver.asks(reverse=True)
    assert not driver.held(both(reverse=True), applied=backward)
    assert driver.held(both(reverse=True), applied=backward | {"PCU2": False})
    assert not driver.held(None, applied=backward)


# How long the throttle was released.


def test_the_throttle_counts_as_released_from_the_first_demand_of_zero_on(driver):
    assert driver.pedals.zero_for_ns(driver.now_ns) is None
    driver.asks(IDLE).after(70).asks(IDLE).after(50)
    assert driver.pedals.zero_for_ns(driver.now_ns) == 120
    driver.held(IDLE)
    assert driver.pedals.zero_for_ns(driver.now_ns) == 120


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_any_throttle_of_either_controller_ends_it(driver, controller):
    driver.asks(IDLE).after(100).asks(one_of(controller, throttle_pct=1e-9))
    assert driver.pedals.zero_for_ns(driver.now_ns) is None
    driver.asks(IDLE).after(1)
    assert driver.pedals.zero_for_ns(driver.now_ns) == 1


def test_a_tick_without_a_fresh_demand_ends_it(driver):
    driver.asks(IDLE).after(100).held(None)
    assert driver.pedals.zero_for_ns(driver.now_ns) is None


# A demand that lasts: judged when it is granted, and met again by every tick.


def test_a_direction_that_is_waited_for_holds_in_every_tick(driver):
    reverse = both(throttle_pct=20.0, reverse=True)
    driver.asks(reverse)
    assert [driver.held(reverse) for _ in range(3)] == [True, True, True]


def test_a_demand_that_nobody_granted_is_judged_by_the_tick(driver):
    driver.asks(IDLE)
    assert driver.held(both(throttle_pct=30.0, brake_pct=10.0))


def test_the_released_time_begins_anew_with_the_first_fresh_demand(driver):
    driver.asks(IDLE)
    driver.after(50 * MS).held(None)
    driver.after(50 * MS).held(IDLE)
    assert driver.pedals.zero_for_ns(driver.now_ns + 10 * MS) == 10 * MS


def test_a_released_demand_ends_a_take_over_also_where_it_is_the_same(driver):
    driver.asks(IDLE)
    driver.pedals.taken_over()
    assert [driver.held(IDLE), driver.held(IDLE)] == [True, False]
