"""The grid: absolute deadlines, skip and count, never a burst."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.core.schedule import (
    LATENESS_BOUNDS_NS,
    Schedule,
    lateness_at,
    lateness_bin,
    percentile_ns,
)

MS = 1_000_000
PERIOD = 50 * MS


def test_nothing_is_due_before_the_deadline():
    schedule = Schedule(1000, PERIOD)
    assert schedule.due(999) is None
    assert schedule.ticks == schedule.skipped == 0


def test_the_first_tick_is_due_at_the_origin_and_the_next_one_period_later():
    schedule = Schedule(1000, PERIOD)
    tick = schedule.due(1000)
    assert tick is not None
    assert (tick.index, tick.deadline_ns, tick.lateness_ns, tick.skipped) == (0, 1000, 0, 0)
    assert schedule.next_deadline_ns == 1000 + PERIOD
    assert schedule.due(1000 + PERIOD - 1) is None
    assert schedule.due(1000 + PERIOD) is not None


def test_lateness_does_not_move_the_grid():
    schedule = Schedule(0, PERIOD)
    for index in range(100):
        tick = schedule.due(index * PERIOD + 3 * MS)
        assert tick is not None
        assert tick.lateness_ns == 3 * MS
    assert schedule.next_deadline_ns == 100 * PERIOD


@pytest.mark.parametrize(
    ("late_ns", "sent", "skipped"),
    [
        (0, True, 0),
        (PERIOD // 2 - 1, True, 0),
        (PERIOD // 2, False, 1),  # a frame now would come too close to the next one
        (PERIOD - 1, False, 1),
        (PERIOD, True, 1),
        (PERIOD + PERIOD // 2 - 1, True, 1),
        (PERIOD + PERIOD // 2, False, 2),
        (4 * PERIOD, True, 4),
        (40 * PERIOD + 1, True, 40),
    ],
)
def test_missed_ticks_are_skipped_and_counted_never_made_up(late_ns, sent, skipped):
    schedule = Schedule(0, PERIOD)
    tick = schedule.due(late_ns)
    assert (tick is not None) == sent
    assert schedule.skipped == skipped
    assert schedule.due(late_ns) is None, "a second tick at the same instant is a burst"


def test_the_next_tick_names_the_ones_skipped_before_it():
    schedule = Schedule(0, PERIOD)
    assert schedule.due(PERIOD // 2) is None
    assert schedule.due(PERIOD + PERIOD // 2) is None
    tick = schedule.due(2 * PERIOD)
    assert tick is not None
    assert (tick.index, tick.skipped) == (2, 2)
    following = schedule.due(3 * PERIOD)
    assert following is not None
    assert following.skipped == 0


@given(st.lists(st.integers(0, 500 * MS), max_size=60), st.integers(0, 2**60))
def test_every_grid_point_is_done_or_skipped_and_two_ticks_are_half_a_period_apart(steps, origin):
    schedule, now, done = Schedule(origin, PERIOD), origin, []
    for step in steps:
        now += step
        tick = schedule.due(now)
        if tick is not None:
            done.append(now)
            assert 0 <= tick.lateness_ns < PERIOD // 2
    assert schedule.ticks + schedule.skipped == schedule.next_index
    assert schedule.next_deadline_ns > now - PERIOD // 2
    assert all(b - a > PERIOD // 2 for a, b in itertools.pairwise(done))
    assert sum(schedule.lateness_counts) == schedule.ticks == len(done)


def test_a_tick_keeps_half_a_period_from_frames_that_left_late():
    schedule = Schedule(0, PERIOD)
    assert schedule.due(0) is not None
    schedule.left(PERIOD // 2 + 1)  # the machine stalled between deciding and sending
    assert schedule.due(PERIOD) is None
    assert schedule.skipped == 1
    tick = schedule.due(2 * PERIOD)
    assert tick is not None
    assert (tick.index, tick.skipped) == (2, 1)


def test_frames_that_left_in_the_first_half_of_their_period_hold_nothing_up():
    schedule = Schedule(0, PERIOD)
    schedule.due(0)
    schedule.left(PERIOD // 2)
    assert schedule.due(PERIOD) is not None


def test_a_decision_half_a_period_old_is_too_late_to_be_sent():
    schedule = Schedule(1000, PERIOD)
    tick = schedule.due(1500)
    assert tick is not None
    assert not schedule.too_late(tick, 1000 + PERIOD // 2 - 1)
    assert schedule.too_late(tick, 1000 + PERIOD // 2)


def test_two_hundred_days_of_uptime_are_exact_to_the_nanosecond():
    schedule = Schedule(200 * 86400 * 1_000_000_000 + 7, PERIOD)
    for index in range(10):
        tick = schedule.due(schedule.origin_ns + index * PERIOD)
        assert tick is not None
        assert tick.lateness_ns == 0


@pytest.mark.parametrize("period_ns", [0, -1])
def test_a_period_that_is_not_above_zero_is_refused(period_ns):
    with pytest.raises(ValueError, match=f"period_ns must be above 0, not {period_ns}"):
        Schedule(0, period_ns)


def test_the_histogram_puts_a_lateness_into_the_bin_with_its_upper_bound():
    assert lateness_bin(0) == 0
    for index, bound in enumerate(LATENESS_BOUNDS_NS):
        assert lateness_bin(bound) == index
        assert lateness_bin(bound + 1) == index + 1


def test_the_percentile_is_the_upper_bound_of_its_bin():
    counts = [98, 1, 0, 0, 0, 0, 0, 0, 0, 1]
    assert lateness_at(counts, 0.5) == LATENESS_BOUNDS_NS[0]
    assert lateness_at(counts, 0.99) == LATENESS_BOUNDS_NS[1]
    assert lateness_at(counts, 1.0) is None, "beyond the last bound nobody knows how late"
    assert lateness_at([0] * 10, 0.5) is None


def test_the_latest_ticks_are_kept_for_exact_percentiles_and_no_more_of_them():
    schedule = Schedule(0, PERIOD)
    for index in range(1300):
        schedule.due(index * PERIOD + index)
    assert list(schedule.recent_lateness_ns) == list(range(100, 1300))


@pytest.mark.parametrize(
    ("values", "share", "expected"),
    [
        ([], 0.5, None),
        ([7], 0.0, 7),
        ([3, 1, 2, 4], 0.0, 1),
        ([7], 1.0, 7),
        ([3, 1, 2, 4], 0.5, 2),
        ([3, 1, 2, 4], 0.51, 3),
        ([3, 1, 2, 4], 1.0, 4),
        (range(100), 0.99, 98),
    ],
)
def test_a_percentile_is_the_smallest_value_that_the_share_does_not_exceed(values, share, expected):
    assert percentile_ns(values, share) == expected
