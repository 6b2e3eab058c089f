"""When the ticking thread reads the bus: how early, and whether in mid-period too."""

import pytest

from vcu_gateway.daemon.ticking_thread import DrainPlan

US = 1_000


@pytest.fixture
def plan() -> DrainPlan:
    return DrainPlan()


def test_a_quiet_bus_is_read_once_a_period(plan: DrainPlan):
    assert not plan.busy
    for frames in (0, 18, 139):
        plan.read_before_tick(frames, 300 * US)
        assert not plan.busy


def test_a_bus_that_fills_half_the_buffer_in_a_period_is_read_in_the_middle_too(plan: DrainPlan):
    plan.read_before_tick(140, 300 * US)
    assert plan.busy


def test_a_busy_bus_stays_busy_though_each_reading_finds_half_as_much(plan: DrainPlan):
    plan.read_before_tick(190, 300 * US)
    for _ in range(10):
        plan.read_between(70)
        plan.read_before_tick(70, 300 * US)
        assert plan.busy
    plan.read_between(69)
    plan.read_before_tick(70, 300 * US)
    assert not plan.busy


def test_what_was_read_in_a_period_counts_for_that_one_only(plan: DrainPlan):
    plan.read_between(100)
    plan.read_before_tick(100, 300 * US)
    plan.read_before_tick(100, 300 * US)
    assert not plan.busy


def test_the_lead_comes_near_to_the_time_that_waking_and_reading_take(plan: DrainPlan):
    assert plan.lead_ns == 0
    for _ in range(100):
        plan.read_before_tick(18, 400 * US)
    assert 390 * US < plan.lead_ns <= 400 * US


def test_of_changing_times_the_lead_is_in_the_middle(plan: DrainPlan):
    for number in range(200):
        plan.read_before_tick(18, (300 + 200 * (number % 2)) * US)
    assert 380 * US < plan.lead_ns < 420 * US


def test_a_stall_moves_the_lead_by_little_and_not_for_long(plan: DrainPlan):
    for _ in range(100):
        plan.read_before_tick(18, 400 * US)
    plan.read_before_tick(18, 500_000 * US)
    assert plan.lead_ns <= 450 * US
    for _ in range(8):
        plan.read_before_tick(18, 400 * US)
    assert plan.lead_ns < 420 * US


def test_the_lead_is_bounded_however_long_reading_takes(plan: DrainPlan):
    for _ in range(1000):
        plan.read_before_tick(400, 20_000 * US)
    assert 3_900 * US < plan.lead_ns <= 4_000 * US


def test_the_lead_follows_a_bus_that_is_full_and_then_quiet_within_a_second(plan: DrainPlan):
    for _ in range(40):
        plan.read_before_tick(190, 1_500 * US)
    assert plan.lead_ns > 1_400 * US
    for _ in range(20):
        plan.read_before_tick(18, 400 * US)
    assert plan.lead_ns < 500 * US
