"""Who may ask, for how long, and what arming needs."""

import time

import pytest

from tests.oracle import wire
from tests.oracle.api import RefusedError
from tests.oracle.bench import GRACE_S
from tests.oracle.watching import TICK_S, rises, throttles_stay_zero


def test_values_that_are_none_or_out_of_range_are_refused_and_change_nothing(bench):
    for values in (
        {"throttle_pct": 100.1}, {"throttle_pct": -0.1}, {"brake_pct": 101}, {"brake_pct": -1},
        {"speed_limit_rpm": 12001}, {"speed_limit_rpm": -1}, {"power_limit_w": 60001},
        {"power_limit_w": -1}, {"power_mode": "warp"}, {"throttle_pct": "20"},
        {"throttle_pct": None}, {"motor_reverse": 1}, {"thrott1e_pct": 1},
    ):  # fmt: skip
        with pytest.raises(RefusedError) as refused:
            bench.client.demand(bench.source, **values)
        assert refused.value.code in (-32002, -32602), values
    for number in (b"NaN", b"Infinity", b"-Infinity", b"1e999"):
        line = bench.client.line("demand.set", **bench.client.demand_params("driver"))
        line = line.replace(b'"values": {}', b'"values": {"throttle_pct": ' + number + b"}")
        bench.client.write(line)
        assert "error" in bench.client.answer(), number
    bench.demand()


def test_arming_is_refused_while_a_change_of_direction_is_pending(bench):
    bench.speeds(200)
    bench.rest(0.15)
    bench.demand(motor_reverse=True)
    bench.until(bench.released + 0.3)
    assert bench.client.refusal("arm")
    bench.demand()


def test_opposite_directions_are_refused(bench):
    opposite = {"PCU1": {"motor_reverse": True}, "PCU2": {"motor_reverse": False}}
    assert bench.client.refused_demand("driver", controllers=opposite) == "directions_differ"


def test_a_second_source_is_refused_while_the_first_is_fresh(bench):
    with bench.another() as other:
        assert other.refused_demand("second")
        bench.release()
        assert other.refused_demand("second") is None
        other.call("demand.release", source="second")
    bench.demand()


def test_an_old_sequence_number_is_refused(bench):
    params = bench.client.demand_params(bench.source)
    bench.client.call("demand.set", **params)
    for sequence in (params["sequence"], params["sequence"] - 1, 0):
        refused = bench.client.refusal("demand.set", **{**params, "sequence": sequence})
        assert refused
        assert refused.refusal == "old_sequence"


def test_an_old_number_is_refused_also_after_another_source_had_the_demand(bench, figures):
    refused = 0
    for number in range(10):
        bench.release()
        old = bench.client.demand_params(f"first{number % 3}")
        bench.client.call("demand.set", **old)
        bench.client.call("demand.release", source=old["source"])
        bench.client.demand(f"between{number % 3}")
        bench.client.call("demand.release", source=f"between{number % 3}")
        again = bench.client.refusal("demand.set", **old)
        refused += again is not None and again.refusal == "old_sequence"
        bench.client.refusal("demand.release", source=old["source"])
    figures.append(f"an old number after another source's demand: refused {refused} of 10")
    bench.demand()
    assert refused == 10


def test_a_demand_that_expires_ends_the_drive_in_the_next_tick(bench):
    bench.drive(throttle_pct=20)
    bench.let_go()
    sent = time.monotonic()
    bench.client.demand(bench.source, ttl_ms=None, throttle_pct=20)
    answered = time.monotonic()
    bench.rules.asked(sent, answered, {"throttle_pct": 20})
    bench.rest(0.4)
    last = [f.t for f in bench.commands(sent) if f.command.throttle][-1]
    assert sent + 0.2 - TICK_S - 0.005 <= last <= answered + 0.2 + GRACE_S
    assert bench.command() == wire.Command.of(wire.ZERO_TORQUE)
    assert bench.mode() == "standby"
    bench.demand()
    bench.rest(0.1)
    assert bench.mode() == "standby"


def test_times_to_live_and_dates_that_cannot_be_are_refused(bench):
    now_ns = time.monotonic_ns()
    for wrong in (
        {"ttl_ms": 1001}, {"ttl_ms": 0}, {"ttl_ms": -1},
        {"made_ns": now_ns + 10**9}, {"made_ns": now_ns - 2 * 10**9},
    ):  # fmt: skip
        params = {**bench.client.demand_params(bench.source), **wrong}
        assert bench.client.refusal("demand.set", **params), wrong


def test_the_time_to_live_counts_from_when_the_demand_was_made(bench):
    bench.drive(throttle_pct=20)
    bench.let_go()
    made = time.monotonic()
    params = bench.client.demand_params(bench.source, 300, throttle_pct=20)
    params["made_ns"] = int(made * 1e9) - 200_000_000
    bench.client.call("demand.set", **params)
    bench.rest(0.3)
    last = [f.t for f in bench.commands(made) if f.command.throttle]
    assert not last or last[-1] <= made + 0.1 + GRACE_S
    assert bench.mode() == "standby"


@pytest.mark.parametrize("how", ["close", "release", "disarm"])
def test_whoever_leaves_stops(bench, how):
    bench.standby()
    bench.release()
    with bench.another() as driver:
        bench.client, mine = driver, bench.client
        try:
            bench.source = "passenger"
            bench.drive(throttle_pct=20)
            bench.let_go()
            left = time.monotonic()
            if how == "close":
                driver.socket.shutdown(2)
            elif how == "release":
                driver.call("demand.release", source="passenger")
            else:
                driver.call("disarm")
            answered = time.monotonic()
            bench.rest(0.2)
        finally:
            bench.client, bench.source = mine, "driver"
    bound = (left if how == "close" else answered) + GRACE_S
    bound += TICK_S if how == "close" else 0
    assert all(f.data == wire.ZERO_TORQUE for f in bench.commands(bound))
    assert bench.mode() == "standby"
    bench.client.call("disarm")


def test_arming_needs_a_fresh_demand_released_for_200_ms(bench):
    bench.release()
    bench.rest(0.1)
    assert bench.client.refusal("arm"), "without a demand"
    bench.demand(throttle_pct=1)
    assert bench.client.refusal("arm"), "with throttle"
    bench.demand()
    assert bench.client.refusal("arm"), "just released"
    bench.rest(0.13)
    assert bench.client.refusal("arm"), "released 130 ms ago"
    bench.rest(0.1)
    bench.rules.armed()
    bench.client.call("arm")
    assert bench.mode() == "active"
    bench.client.call("disarm")
    bench.rest(0.12)
    bench.rules.may_drive = False


def test_arming_is_refused_until_a_stop_cause_has_been_gone_for_a_second(bench):
    bench.vehicle.set("PCU1_Status1", TemperatureProtectLevel=2)
    bench.rest(0.3)
    assert bench.mode() == "standby", "without torque nothing latches"
    assert bench.client.refusal("arm")
    gone = time.monotonic()
    bench.vehicle.set("PCU1_Status1", TemperatureProtectLevel=0)
    bench.until(gone + 0.95)
    assert bench.client.refusal("arm")
    bench.until(gone + 1.0 + 2 * TICK_S + 0.05)
    bench.arm()
    bench.client.call("disarm")
    bench.rest(0.12)
    bench.rules.may_drive = False


def test_demand_0_arm_and_demand_50_in_one_write_do_not_drive(bench, figures):
    drove = 0
    for _ in range(10):
        bench.standby()
        bench.demand(throttle_pct=3)
        bench.rest(0.02)
        bench.let_go()
        since = time.monotonic()
        c = bench.client
        bench.rules.armed()
        bench.rules.asked(since, since + 1, {"throttle_pct": 50})
        c.write(
            c.line("demand.set", **c.demand_params(bench.source, throttle_pct=0)),
            c.line("arm"),
            c.line("demand.set", **c.demand_params(bench.source, throttle_pct=50)),
        )
        answers = [c.answer() for _ in range(3)]
        bench.rest(0.17)
        drove += "result" in answers[1] or any(f.command.throttle for f in bench.commands(since))
        bench.rules.may_drive = False
    figures.append(f"demand 0, arm, demand 50 in one write: drove {drove} of 10")
    assert drove == 0


# --- with other keys, taken by a running gateway ---------------------------------------------


def test_a_source_of_higher_priority_takes_over_and_must_release_first(bench, reloaded):
    reloaded(demand={"priorities": {"remote": 10}})
    bench.drive(throttle_pct=20)
    with bench.another() as remote:
        bench.let_go()
        bench.client, mine, bench.source = remote, bench.client, "remote"
        try:
            bench.demand(throttle_pct=30)
            assert mine.refused_demand("driver", throttle_pct=20)
            assert throttles_stay_zero(bench, 0.3)
            bench.demand(throttle_pct=5)
            assert throttles_stay_zero(bench, 0.2)
            assert bench.mode() == "active"
            bench.demand(throttle_pct=4)
            assert rises(bench)
            bench.demand(throttle_pct=30)
            bench.wait(lambda: bench.command().throttle == wire.percent(30), "throttle", 2.0)
        finally:
            bench.let_go()
            remote.refusal("demand.release", source="remote")
            bench.client, bench.source = mine, "driver"


def test_where_the_second_track_is_required_a_demand_without_it_is_refused(bench, reloaded):
    reloaded(demand={"second_track_required": True})
    assert bench.client.refused_demand("driver", throttle_pct=0) == "second_track_missing"
    assert bench.client.refused_demand("driver", throttle_pct=0, throttle_track2_pct=0) is None


def test_where_directions_are_independent_they_may_differ(bench, reloaded):
    reloaded(demand={"independent_directions": True})
    opposite = {"PCU1": {"motor_reverse": True}, "PCU2": {"motor_reverse": False}}
    bench.rules.independent = True
    assert bench.client.refused_demand("driver", controllers=opposite) is None
    bench.rest(0.12)
    bench.demand()
    bench.rest(0.12)
    bench.rules.independent = False
