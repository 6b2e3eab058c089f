"""The dead-man on the client's side, with a clock that the test owns."""

import pytest

from vcu_gateway.api.methods import DemandParams
from vcu_gateway.client import RefusedError
from vcu_gateway.client.demand import DeadMan, request_values

MS = 1_000_000
S = 1_000_000_000
START_NS = 5_000 * S
TTL_MS = 300
PAUSE_NS = 100 * MS
DRIVING = request_values({"throttle_pct": 20})
ZERO = {"throttle_pct": 0.0, "throttle_track2_pct": 0.0, "brake_pct": 0.0}
GRANTED = {"granted": True, "mode": "active"}


def refusal(word: str = "other_owner") -> RefusedError:
    return RefusedError(-32002, "refused", "another owns the demand", word)


@pytest.fixture
def dead_man():
    return DeadMan("driver", TTL_MS, hold_s=0.5)


@pytest.fixture
def driving(dead_man):
    dead_man.new_values(DRIVING, START_NS)
    dead_man.granted(GRANTED)
    return dead_man


def test_a_demand_is_one_of_the_contract(dead_man):
    demand = dead_man.new_values(DRIVING, START_NS)
    assert DemandParams.model_validate(demand).values.throttle_pct == 20
    assert demand == {
        "source": "driver",
        "sequence": START_NS // 1000,
        "ttl_ms": TTL_MS,
        "made_ns": START_NS,
        "values": {"throttle_pct": 20.0},
    }


def test_before_anything_is_asked_no_motion_is(dead_man):
    assert dead_man.repeat(START_NS)["values"] == ZERO


def test_a_demand_is_due_again_after_a_third_of_its_time_to_live(driving):
    assert driving.due_ns == START_NS + PAUSE_NS


def test_a_repeated_demand_is_vouched_for_anew(driving):
    again = driving.repeat(START_NS + PAUSE_NS)
    assert again["values"] == {"throttle_pct": 20.0}
    assert again["made_ns"] == START_NS + PAUSE_NS


def test_the_hold_counts_from_the_last_set_not_from_the_last_repetition(driving):
    driving.repeat(START_NS + 350 * MS)
    assert driving.due_ns == START_NS + 450 * MS
    driving.repeat(START_NS + 450 * MS)
    assert driving.due_ns == START_NS + 500 * MS


def test_a_nanosecond_before_the_hold_ends_the_values_stand(driving):
    assert driving.repeat(START_NS + 500 * MS - 1)["values"] == {"throttle_pct": 20.0}


def test_when_the_hold_ends_no_motion_is_asked_for(driving):
    assert driving.repeat(START_NS + 500 * MS)["values"] == ZERO


def test_after_the_hold_no_motion_goes_on_until_the_next_set(driving):
    driving.repeat(START_NS + 500 * MS)
    assert driving.repeat(START_NS + 600 * MS)["values"] == ZERO
    assert driving.new_values(DRIVING, START_NS + 700 * MS)["values"] == {"throttle_pct": 20.0}
    assert driving.repeat(START_NS + 800 * MS)["values"] == {"throttle_pct": 20.0}


def test_a_process_that_was_frozen_past_the_hold_wakes_with_no_motion(driving):
    assert driving.repeat(START_NS + 3600 * S)["values"] == ZERO


def test_every_set_begins_the_hold_anew(driving):
    driving.new_values(DRIVING, START_NS + 400 * MS)
    assert driving.repeat(START_NS + 899 * MS)["values"] == {"throttle_pct": 20.0}
    assert driving.repeat(START_NS + 900 * MS)["values"] == ZERO


def test_without_a_hold_the_values_go_on_for_as_long_as_the_process():
    dead_man = DeadMan("bench", TTL_MS, hold_s=None)
    dead_man.new_values(DRIVING, START_NS)
    assert dead_man.repeat(START_NS + 3600 * S)["values"] == {"throttle_pct": 20.0}
    assert dead_man.due_ns == START_NS + 3600 * S + PAUSE_NS


def test_the_direction_outlasts_the_hold(dead_man):
    dead_man.new_values(request_values({"throttle_pct": 20, "motor_reverse": True}), START_NS)
    after = dead_man.repeat(START_NS + S)["values"]
    assert after == {**ZERO, "motor_reverse": True}


def test_sequences_rise_even_while_the_clock_stands_or_falls_back(dead_man):
    at = [START_NS, START_NS, START_NS + 1, START_NS - S, START_NS + S]
    numbers = [dead_man.repeat(now_ns)["sequence"] for now_ns in at]
    assert numbers == sorted(set(numbers))


def test_a_later_process_begins_above_the_numbers_of_an_earlier_one(driving):
    later = DeadMan("driver", TTL_MS, hold_s=0.5)
    last = driving.repeat(START_NS + PAUSE_NS)["sequence"]
    assert later.repeat(START_NS + PAUSE_NS + MS)["sequence"] > last


def test_a_refusal_is_raised_by_the_next_set_which_takes_nothing(driving):
    error = refusal()
    driving.refused(error)
    assert driving.refusal is error
    with pytest.raises(RefusedError) as raised:
        driving.new_values(request_values({"throttle_pct": 50}), START_NS + MS)
    assert raised.value is error
    assert driving.repeat(START_NS + 2 * MS)["values"] == ZERO


def test_the_set_after_the_one_that_raised_is_taken(driving):
    driving.refused(refusal())
    with pytest.raises(RefusedError):
        driving.new_values(DRIVING, START_NS)
    assert driving.new_values(DRIVING, START_NS + MS)["values"] == {"throttle_pct": 20.0}


def test_after_a_refusal_no_motion_is_due_at_once(driving):
    driving.refused(refusal())
    assert driving.due_ns <= START_NS
    assert driving.repeat(START_NS + MS)["values"] == ZERO


def test_a_refusal_of_no_motion_is_not_answered_at_once(driving):
    driving.refused(refusal())
    driving.repeat(START_NS)
    driving.refused(refusal())
    assert driving.due_ns > START_NS


def test_a_refusal_is_told_even_where_no_motion_was_granted_since(driving):
    driving.refused(refusal())
    driving.granted(GRANTED)
    assert driving.refusal is not None
    with pytest.raises(RefusedError):
        driving.new_values(DRIVING, START_NS)


def test_a_refusal_that_was_told_is_over_with_the_next_granted_demand(driving):
    driving.refused(refusal())
    with pytest.raises(RefusedError):
        driving.new_values(DRIVING, START_NS)
    assert driving.refusal is not None
    driving.granted(GRANTED)
    assert driving.refusal is None


def test_refusals_in_a_row_are_repeated_ever_more_slowly_up_to_a_second(driving):
    pauses_ms = []
    for count in range(1, 8):
        driving.refused(refusal())
        driving.repeat(START_NS + count * S)
        pauses_ms.append((driving.due_ns - START_NS - count * S) // MS)
    assert pauses_ms == [200, 400, 800, 1000, 1000, 1000, 1000]
    driving.granted(GRANTED)
    driving.repeat(START_NS + 9 * S)
    assert driving.due_ns == START_NS + 9 * S + PAUSE_NS


def test_a_time_to_live_longer_than_seconds_is_repeated_every_third_of_it_nevertheless():
    dead_man = DeadMan("driver", 6000, hold_s=None)
    dead_man.refused(refusal())
    dead_man.repeat(START_NS)
    assert dead_man.due_ns == START_NS + 2 * S


def test_a_time_to_live_of_nothing_does_not_spin():
    dead_man = DeadMan("driver", 0, hold_s=None)
    dead_man.repeat(START_NS)
    assert dead_man.due_ns > START_NS


def test_the_last_granted_answer_is_kept(dead_man):
    assert dead_man.last_answer is None
    dead_man.granted(GRANTED)
    assert dead_man.last_answer == GRANTED


@pytest.mark.parametrize(("word", "kept"), [("other_owner", True), ("directions_differ", False)])
def test_two_directions_that_were_refused_are_not_asked_for_again(dead_man, word, kept):
    dead_man.new_values(request_values({"PCU1": {"motor_reverse": True}, "PCU2": {}}), START_NS)
    dead_man.refused(refusal(word))
    again = dead_man.repeat(START_NS + PAUSE_NS)
    assert ("controllers" in again) is kept
    assert kept or again["values"] == ZERO
