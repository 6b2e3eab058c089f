"""Wall-clock stamps in monotonic time, whatever happens to the wall clock."""

from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.core.schedule import ClockPair, arrival_ns, steady

MS = 1_000_000
HOUR = 3600 * 1_000_000_000
DISTANCE = 1_700_000_000 * 1_000_000_000
BEFORE = ClockPair(1000 * MS, 1000 * MS + DISTANCE)


def now(distance: int = DISTANCE) -> ClockPair:
    return ClockPair(1100 * MS, 1100 * MS + distance)


def test_with_a_steady_wall_clock_a_stamp_is_shifted_by_the_distance():
    assert arrival_ns(1050 * MS + DISTANCE, BEFORE, now()) == 1050 * MS


def test_a_frame_that_waited_since_long_before_the_drain_keeps_its_age():
    assert arrival_ns(200 * MS + DISTANCE, BEFORE, now()) == 200 * MS


def test_a_step_forward_after_the_arrival_does_not_age_the_frame():
    stamped_before_the_step = 1050 * MS + DISTANCE
    assert arrival_ns(stamped_before_the_step, BEFORE, now(DISTANCE + HOUR)) == 1050 * MS


def test_a_step_forward_before_the_arrival_does_not_move_the_frame():
    stamped_after_the_step = 1050 * MS + DISTANCE + HOUR
    assert arrival_ns(stamped_after_the_step, BEFORE, now(DISTANCE + HOUR)) == 1050 * MS


def test_a_step_back_after_the_arrival_does_not_put_the_frame_into_the_future():
    stamped_before_the_step = 1050 * MS + DISTANCE
    assert arrival_ns(stamped_before_the_step, BEFORE, now(DISTANCE - HOUR)) == 1050 * MS


def test_a_reading_at_the_very_last_drain_is_possible_and_the_older_one_wins():
    assert arrival_ns(1050 * MS + DISTANCE, BEFORE, now(DISTANCE + 50 * MS)) == 1000 * MS


def test_a_step_back_before_the_arrival_does_not_age_the_frame():
    stamped_after_the_step = 1050 * MS + DISTANCE - HOUR
    assert arrival_ns(stamped_after_the_step, BEFORE, now(DISTANCE - HOUR)) == 1050 * MS


def test_where_a_small_step_allows_two_readings_the_older_one_counts():
    stepped = now(DISTANCE + 10 * MS)
    assert arrival_ns(1050 * MS + DISTANCE, BEFORE, stepped) == 1040 * MS


def test_the_newer_reading_counts_where_only_it_lies_after_the_drain_before():
    stepped = now(DISTANCE + 60 * MS)
    assert arrival_ns(1050 * MS + DISTANCE, BEFORE, stepped) == 1050 * MS
    assert arrival_ns(1000 * MS + DISTANCE, BEFORE, stepped) == 1000 * MS
    just_before = 1000 * MS - 1
    assert arrival_ns(just_before + DISTANCE, BEFORE, stepped) == just_before - 60 * MS


def test_a_stamp_from_the_future_counts_as_old_as_it_can_be():
    assert arrival_ns(1100 * MS + DISTANCE + 1, BEFORE, now()) == BEFORE.monotonic_ns
    assert arrival_ns(1100 * MS + DISTANCE, BEFORE, now()) == 1100 * MS


def test_the_clock_is_steady_up_to_a_millisecond_either_way():
    for error_ns in (-MS, 0, MS):
        assert steady(BEFORE, now(DISTANCE + error_ns))
    for error_ns in (-MS - 1, MS + 1):
        assert not steady(BEFORE, now(DISTANCE + error_ns))


@given(st.integers(0, 2**63), st.integers(0, 2**63), st.integers(0, 2**63))
def test_no_stamp_ever_lies_in_the_future(stamp, wall_before, wall_now):
    before, at = ClockPair(5 * MS, wall_before), ClockPair(9 * MS, wall_now)
    assert arrival_ns(stamp, before, at) <= at.monotonic_ns
