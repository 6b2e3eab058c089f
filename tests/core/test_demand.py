"""Demands: what is refused, who owns the demand, and for how long one counts."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.core.demand import (
    BENCH_SOURCE,
    CONTROLLERS,
    GRANTED,
    ControllerDemand,
    Demand,
    DemandArbiter,
    PowerMode,
    Refusal,
    fault_of,
    refused,
)
from vcu_gateway.core.settings import Settings
from vcu_gateway.demand_ranges import RANGES

MS = 1_000_000
TTL_MAX_MS = 1000
PRIORITIES = {"remote": 5, "driver": 5, "supervisor": 10, "guest": 1, "last": -1}
TERMS = Settings(priorities=PRIORITIES)
IDLE = ControllerDemand()


def demand(source="driver", sequence=1, ttl_ms=200, controllers=None, **demanded):
    both = dict.fromkeys(CONTROLLERS, ControllerDemand(**demanded))
    return Demand(source, sequence, ttl_ms, both if controllers is None else controllers)


@pytest.fixture
def arbiter():
    return DemandArbiter(None)


def offer(arbiter, *args, now_ns=0, priorities=PRIORITIES, **kwargs):
    terms = dataclasses.replace(TERMS, priorities=priorities)
    return arbiter.offer(demand(*args, **kwargs), terms, now_ns)


# Values.


@pytest.mark.parametrize("name", RANGES)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400, -(10**400)])
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_value_that_is_not_finite_is_refused_by_name(arbiter, name, value, controller):
    controllers = dict.fromkeys(CONTROLLERS, IDLE)
    controllers[controller] = dataclasses.replace(IDLE, **{name: value})
    answer = offer(arbiter, controllers=controllers)
    shown = {10**400: "inf", -(10**400): "inf"}.get(value, f"{value}")
    assert answer == (False, Refusal.NOT_FINITE, f"{controller} {name} is {shown}")
    assert arbiter.current is None


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("throttle_pct", 0, 100),
        ("brake_pct", 0, 100),
        ("speed_limit_rpm", 0, 12_000),
        ("power_limit_w", 0, 60_000),
        ("throttle_track2_pct", 0, 100),
    ],
)
def test_the_range_ends_exactly_at_its_limits(arbiter, name, low, high):
    for sequence, value in enumerate((low, high, float(low), float(high), -0.0)):
        assert offer(arbiter, sequence=sequence, **{name: value}) == GRANTED
    for value in (low - 1, math.nextafter(low, -1), math.nextafter(high, math.inf), high + 1):
        answer = offer(arbiter, sequence=9, **{name: value})
        assert answer.refusal is Refusal.OUT_OF_RANGE
        sentence = f"PCU1 {name} must be {low:g} to {high:g}, not {value:g}"
        assert (answer.granted, answer.sentence) == (False, sentence)
    assert arbiter.current.sequence == 4


@given(
    demanded=st.builds(
        ControllerDemand,
        **dict.fromkeys(RANGES, st.floats() | st.integers()),
    )
)
def test_only_finite_values_inside_their_ranges_are_taken(demanded):
    answer = fault_of(demand(controllers=dict.fromkeys(CONTROLLERS, demanded)), TERMS)
    inside = all(low <= getattr(demanded, name) <= high for name, (low, high) in RANGES.items())
    assert answer.granted is inside
    assert (answer.refusal is None) is inside


@pytest.mark.parametrize("missing", CONTROLLERS)
def test_a_demand_without_one_of_the_controllers_is_refused(arbiter, missing):
    controllers = {name: IDLE for name in CONTROLLERS if name != missing}
    answer = offer(arbiter, controllers=controllers)
    assert not answer.granted
    assert answer.refusal is Refusal.CONTROLLER_MISSING
    assert missing in answer.sentence


def test_the_second_controllers_values_are_checked_as_well_as_the_firsts(arbiter):
    wrong = dataclasses.replace(IDLE, brake_pct=101)
    for name in CONTROLLERS:
        controllers = dict.fromkeys(CONTROLLERS, IDLE) | {name: wrong}
        assert offer(arbiter, controllers=controllers).sentence.startswith(f"{name} brake_pct")


@pytest.mark.parametrize("ttl_ms", [1, 2, TTL_MAX_MS - 1, TTL_MAX_MS])
def test_a_time_to_live_up_to_the_maximum_is_taken(arbiter, ttl_ms):
    assert offer(arbiter, ttl_ms=ttl_ms) == GRANTED


@pytest.mark.parametrize("ttl_ms", [0, -1, TTL_MAX_MS + 1, math.inf, math.nan])
def test_any_other_time_to_live_is_refused(arbiter, ttl_ms):
    answer = offer(arbiter, ttl_ms=ttl_ms)
    sentence = f"ttl_ms must be 1 to {TTL_MAX_MS}, not {ttl_ms}"
    assert answer == (False, Refusal.TTL_OUT_OF_RANGE, sentence)


def test_unless_configured_otherwise_a_demand_counts_for_a_second_at_most():
    assert fault_of(demand(ttl_ms=1000), TERMS) == GRANTED
    assert fault_of(demand(ttl_ms=1001), TERMS).refusal is Refusal.TTL_OUT_OF_RANGE


def test_a_demand_that_never_ends_is_taken_from_the_configuration_only(arbiter):
    for wrong in (demand(ttl_ms=None), demand(source=BENCH_SOURCE)):
        answer = arbiter.offer(wrong, TERMS, 0)
        sentence = "bench is the configured bench demand"
        assert answer == (False, Refusal.NAME_RESERVED, sentence)
    assert arbiter.current is None
    assert fault_of(demand(ttl_ms=None), TERMS) == GRANTED


def test_a_refusal_is_never_granted():
    assert refused(Refusal.OLD_SEQUENCE, "why") == (False, Refusal.OLD_SEQUENCE, "why")
    assert GRANTED == (True, None, "")


# Sequence.


@pytest.mark.parametrize(("sequence", "taken"), [(8, True), (7, False), (6, False), (10**30, True)])
@pytest.mark.parametrize("now_ns", [0, 10_000 * MS])
def test_only_a_higher_sequence_number_replaces_ones_own_demand(arbiter, sequence, taken, now_ns):
    offer(arbiter, sequence=7)
    answer = offer(arbiter, sequence=sequence, throttle_pct=9, now_ns=now_ns)
    assert answer.granted is taken
    assert arbiter.current.sequence == (sequence if taken else 7)
    if not taken:
        sentence = f"sequence {sequence} is not above 7"
        assert answer == (False, Refusal.OLD_SEQUENCE, sentence)


def test_a_refused_demand_does_not_prolong_the_one_before(arbiter):
    offer(arbiter, sequence=7, ttl_ms=200)
    assert not offer(arbiter, sequence=7, now_ns=100 * MS).granted
    assert not offer(arbiter, sequence=8, throttle_pct=math.nan, now_ns=100 * MS).granted
    assert arbiter.age_ns(200 * MS) == 200 * MS
    assert not arbiter.fresh(200 * MS + 1)


# Ownership.


@pytest.mark.parametrize(
    ("owner", "other", "taken"),
    [
        ("driver", "remote", False),  # equal priorities
        ("driver", "supervisor", True),
        ("supervisor", "driver", False),
        ("driver", "unlisted", False),  # not listed means 0
        ("unlisted", "driver", True),
        ("unlisted", "stranger", False),
        ("unlisted", "guest", True),
        ("guest", "unlisted", False),
        ("last", "unlisted", True),
        ("unlisted", "last", False),
    ],
)
def test_another_source_takes_a_fresh_desk_over_by_priority_only(arbiter, owner, other, taken):
    offer(arbiter, owner, sequence=50)
    answer = offer(arbiter, other, sequence=1, now_ns=200 * MS)
    assert answer.granted is taken
    assert arbiter.current.source == (other if taken else owner)
    if not taken:
        assert answer == (False, Refusal.OTHER_OWNER, f"{owner} owns the demand")


def test_any_source_takes_the_desk_over_when_its_demand_has_expired(arbiter):
    offer(arbiter, "supervisor", sequence=50, ttl_ms=200)
    assert offer(arbiter, "unlisted", now_ns=200 * MS).refusal is Refusal.OTHER_OWNER
    assert offer(arbiter, "unlisted", now_ns=200 * MS + 1) == GRANTED
    assert arbiter.current.source == "unlisted"


def test_a_new_owner_begins_with_any_sequence_number(arbiter):
    offer(arbiter, "driver", sequence=1000)
    assert offer(arbiter, "remote", sequence=-3, now_ns=201 * MS) == GRANTED


def test_the_owner_ends_its_demand_and_its_old_requests_do_not_come_back(arbiter):
    offer(arbiter, "driver", sequence=1000, throttle_pct=30)
    assert arbiter.end("driver") == GRANTED
    assert not arbiter.fresh(0)
    assert offer(arbiter, "driver", sequence=1000).refusal is Refusal.OLD_SEQUENCE
    assert not arbiter.fresh(0)
    assert offer(arbiter, "driver", sequence=1001) == GRANTED
    assert arbiter.fresh(0)


def test_another_source_may_own_the_desk_as_soon_as_the_demand_was_ended(arbiter):
    offer(arbiter, "driver")
    arbiter.end("driver")
    assert offer(arbiter, "remote") == GRANTED


def test_nobody_else_ends_a_demand(arbiter):
    refusal = (False, Refusal.OTHER_OWNER, "remote does not own the demand")
    assert arbiter.end("remote") == refusal
    offer(arbiter, "driver")
    assert arbiter.end("remote") == refusal
    assert arbiter.fresh(0)


# Time to live.


@pytest.mark.parametrize("ttl_ms", [1, 200, 1000])
def test_a_demand_counts_until_exactly_its_time_to_live(arbiter, ttl_ms):
    start_ns = 5_000 * MS
    offer(arbiter, ttl_ms=ttl_ms, now_ns=start_ns)
    end_ns = start_ns + ttl_ms * MS
    assert arbiter.fresh(start_ns)
    assert arbiter.fresh(end_ns)
    assert not arbiter.fresh(end_ns + 1)
    assert arbiter.age_ns(end_ns + 1) == ttl_ms * MS + 1


def test_a_demand_from_the_future_does_not_count(arbiter):
    offer(arbiter, now_ns=10 * MS)
    assert arbiter.fresh(10 * MS)
    assert not arbiter.fresh(10 * MS - 1)


def test_a_new_demand_counts_from_its_own_arrival(arbiter):
    offer(arbiter, sequence=1, now_ns=0)
    offer(arbiter, sequence=2, now_ns=150 * MS)
    assert arbiter.fresh(350 * MS)
    assert not arbiter.fresh(350 * MS + 1)


def made(arbiter, made_ns: int, now_ns: int, sequence: int = 1, ttl_ms: int = 200):
    demand = Demand("driver", sequence, ttl_ms, dict.fromkeys(CONTROLLERS, IDLE), made_ns)
    return arbiter.offer(demand, TERMS, now_ns)


def test_the_time_to_live_counts_from_when_the_demand_was_made(arbiter):
    assert made(arbiter, made_ns=50 * MS, now_ns=100 * MS) == GRANTED
    assert arbiter.age_ns(100 * MS) == 50 * MS
    assert arbiter.fresh(250 * MS)
    assert not arbiter.fresh(250 * MS + 1)


def test_a_demand_that_waited_in_a_buffer_beyond_its_time_to_live_is_refused(arbiter):
    assert made(arbiter, made_ns=0, now_ns=200 * MS) == GRANTED
    late = (False, Refusal.EXPIRED, "it is 200 ms old and counts for 200 ms")
    assert made(arbiter, made_ns=0, now_ns=200 * MS + 1, sequence=2) == late
    assert arbiter.current.sequence == 1


def test_a_demand_made_in_the_future_is_refused(arbiter):
    answer = made(arbiter, made_ns=11, now_ns=10)
    assert answer.refusal is Refusal.FROM_THE_FUTURE
    assert answer.sentence == "made_ns is 1 ns ahead of this machine's monotonic clock"
    assert arbiter.current is None
    assert made(arbiter, made_ns=10, now_ns=10) == GRANTED


def test_before_the_first_demand_nothing_counts(arbiter):
    assert arbiter.current is None
    assert not arbiter.fresh(0)
    assert arbiter.age_ns(0) is None


# The pedal's second track, and directions.


def two_ways(**first):
    return {"PCU1": ControllerDemand(**first), "PCU2": ControllerDemand(motor_reverse=True)}


def test_a_demand_without_a_second_track_is_taken_unless_it_is_required(arbiter):
    track = ControllerDemand(throttle_track2_pct=0.0)
    terms = dataclasses.replace(TERMS, second_track_required=True)
    for missing in CONTROLLERS:
        controllers = dict.fromkeys(CONTROLLERS, track) | {missing: IDLE}
        answer = arbiter.offer(demand(controllers=controllers), terms, 0)
        assert answer.refusal is Refusal.SECOND_TRACK_MISSING
        sentence = f"{missing} throttle_track2_pct is missing; the configuration requires it"
        assert answer.sentence == sentence
    assert arbiter.offer(demand(controllers=dict.fromkeys(CONTROLLERS, track)), terms, 0) == GRANTED
    assert offer(arbiter, sequence=2) == GRANTED


def test_two_directions_are_refused_unless_they_are_configured(arbiter):
    answer = offer(arbiter, controllers=two_ways())
    sentence = "both controllers must have the same direction"
    assert answer == (False, Refusal.DIRECTIONS_DIFFER, sentence)
    independent = dataclasses.replace(TERMS, independent_directions=True)
    assert arbiter.offer(demand(controllers=two_ways()), independent, 0) == GRANTED
    assert offer(arbiter, sequence=2, controllers=two_ways(motor_reverse=True)) == GRANTED


# Sequence numbers of every source.


@pytest.mark.parametrize("between", ["expired", "taken over"])
def test_an_old_number_is_refused_whoever_had_the_demand_meanwhile(arbiter, between):
    offer(arbiter, "guest", sequence=7)
    now_ns = 0 if between == "taken over" else 201 * MS
    assert offer(arbiter, "driver", sequence=1, now_ns=now_ns) == GRANTED
    later_ns = now_ns + 201 * MS
    for sequence in (6, 7):
        answer = offer(arbiter, "guest", sequence=sequence, now_ns=later_ns)
        sentence = f"sequence {sequence} is not above 7"
        assert answer == (False, Refusal.OLD_SEQUENCE, sentence)
    assert offer(arbiter, "guest", sequence=8, now_ns=later_ns) == GRANTED


@pytest.mark.parametrize(
    "refused",
    [
        {"throttle_pct": 101},
        {"ttl_ms": 0},
        {"source": "guest"},
    ],
)
def test_a_refused_demand_does_not_count_for_the_sequence(arbiter, refused):
    offer(arbiter, sequence=1)
    assert not offer(arbiter, **{"sequence": 9} | refused).granted
    now_ns = 201 * MS
    assert offer(arbiter, refused.get("source", "driver"), sequence=2, now_ns=now_ns) == GRANTED


def test_no_more_than_64_sources_can_ask(arbiter):
    for number in range(64):
        assert offer(arbiter, f"source{number}", now_ns=number * 201 * MS) == GRANTED
    now_ns = 100_000 * MS
    answer = offer(arbiter, "driver", now_ns=now_ns)
    sentence = "64 sources have asked since the start, which is the most"
    assert answer == (False, Refusal.TOO_MANY_SOURCES, sentence)
    assert offer(arbiter, "source0", sequence=2, now_ns=now_ns) == GRANTED


# The bench demand.


def test_the_bench_demand_counts_for_ever_and_has_no_age():
    bench = ControllerDemand(throttle_pct=12)
    arbiter = DemandArbiter(bench)
    assert arbiter.fresh(-(10**15))
    assert arbiter.fresh(10**18)
    assert arbiter.age_ns(10**18) is None
    both = {"PCU1": bench, "PCU2": bench}
    assert arbiter.current == Demand(BENCH_SOURCE, sequence=0, ttl_ms=None, controllers=both)


def test_the_bench_demand_is_taken_over_once_somebody_asked():
    for arbiter in (DemandArbiter(None), DemandArbiter(ControllerDemand())):
        assert arbiter.taken is False
        assert offer(arbiter, source="driver", priorities={"driver": 5}).granted
        assert arbiter.taken is True
        arbiter.end("driver")
        assert arbiter.taken is True


def test_the_bench_demand_gives_way_to_a_higher_priority_only():
    arbiter = DemandArbiter(IDLE)
    assert offer(arbiter, "unlisted").refusal is Refusal.OTHER_OWNER
    assert offer(arbiter, "driver") == GRANTED


def test_the_defaults_of_a_demand_ask_for_no_torque():
    assert dataclasses.asdict(ControllerDemand()) == {
        "throttle_pct": 0.0,
        "brake_pct": 0.0,
        "power_mode": PowerMode.ECO,
        "motor_reverse": False,
        "regen_brake": False,
        "speed_limit_rpm": 12_000.0,
        "power_limit_w": 60_000.0,
        "throttle_track2_pct": None,
    }


def test_the_power_modes_are_the_codes_on_the_wire():
    assert {mode.name: mode.value for mode in PowerMode} == {
        "ECO": 0,
        "NORMAL": 1,
        "TURBO": 2,
        "SAFETY": 3,
    }
