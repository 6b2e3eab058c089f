"""Nothing that arrived between two ticks is lost: not a code, a mark, a life signal, a demand."""

import contextlib
import itertools
import time

import pytest

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench

BATTERY, LEFT, RIGHT = "BMS_Status", "PCU1_Status1", "PCU2_Status1"
DISTANCES_MS = (1, 2, 5, 10, 20, 30, 40)
# Each told in its own frame; none of them latches, so that one hold serves them all.
CODES = [
    (BATTERY, "TemperatureImbalance", 1, "alarm"),
    (BATTERY, "Overtemperature", 1, "alarm"),
    (BATTERY, "VoltageImbalance", 1, "alarm"),
    (BATTERY, "CellOvervoltage", 1, "regen limit"),
    (BATTERY, "CellUndervoltage", 1, "power limit"),
    (BATTERY, "Undertemperature", 1, "regen off"),
    (BATTERY, "DischargeOvercurrent", 1, "power limit"),
    (LEFT, "TemperatureProtectLevel", 1, "turbo off"),
    (RIGHT, "TemperatureProtectLevel", 1, "turbo off"),
    (LEFT, "VoltageLevel", 5, "regen off"),
    (RIGHT, "VoltageLevel", 1, "power limit"),
]


def told(bench: Bench) -> set[tuple[str, str]]:
    """Every cause that counts now: its subject and effect."""
    why = bench.why()
    causes = itertools.chain(why["blocks"], why["limits"], why["alarms"])
    return {(cause["subject"], cause["effect"]) for cause in causes}


@pytest.mark.parametrize("distance_ms", DISTANCES_MS)
def test_a_code_counts_though_a_good_frame_follows_it(bench, figures, distance_ms):
    seen, missed = 0, []
    for number, (message, signal, code, effect) in enumerate(CODES):
        bench.vehicle.script(
            (0.0, message, {signal: code}), (distance_ms / 1000, message, {}),
            after_tick_ms=5 + number * 4,
        )  # fmt: skip
        cause = (f"{message}.{signal}", effect)
        with contextlib.suppress(AssertionError):  # held for a second from the tick after the code
            bench.wait(lambda: cause in told(bench), signal, 0.5)  # noqa: B023
        found = cause in told(bench)
        seen += found
        missed += [] if found else [signal]
    figures.append(f"a code, a good frame {distance_ms} ms later: {seen} of {len(CODES)} counted")
    assert not missed


def cut_then_good(bench: Bench, message: str, values: dict, good: dict) -> float:
    """The stamp of the bad frame, which a good one follows after 1 ms."""
    since = time.monotonic()
    bench.vehicle.script((0.0, message, values), (0.001, message, good))
    return bench.frame(message, since).t


FLEETING = [
    (BATTERY, {"InternalFault": 1}, "service"),
    (BATTERY, {"CellUndervoltage": 2}, "driver"),
    (BATTERY, {"CellUndervoltage": 3}, "service"),
    (LEFT, {"TemperatureProtectLevel": 2}, "driver"),
    (RIGHT, {"TemperatureProtectLevel": 2}, "driver"),
]


@pytest.mark.parametrize(("message", "values", "fault_class"), FLEETING)
def test_while_driving_a_fleeting_stop_or_cut_latches(bench, message, values, fault_class):
    wanted = wire.POWER_CUT if fault_class == "service" else wire.ZERO_TORQUE

    bench.drive(throttle_pct=30)
    bench.must_be_safe_after(cut_then_good(bench, message, values, {}), wanted)
    assert bench.why()["latch"]["fault_class"] == fault_class


def test_an_internal_fault_that_a_good_frame_follows_cuts_ten_times_of_ten(bench, figures):
    def cut(number: int) -> bool:
        bench.standby()
        bench.vehicle.script(
            (0.0, BATTERY, {"InternalFault": 1}), (0.001, BATTERY, {}), after_tick_ms=1 + number * 5
        )
        bench.rest(0.160)
        return bool(bench.command().cut)

    cuts = bench.of_ten(cut)
    figures.append(f"InternalFault, a good frame 1 ms later: {cuts} of 10 cut the power")
    assert cuts == 10


@pytest.mark.parametrize(
    ("worst", "others"),
    [
        ({"CellUndervoltage": 3}, [{"CellUndervoltage": 2}, {"CellUndervoltage": 1}]),
        ({"Undertemperature": 2}, [{"Undertemperature": 1}, {"CellUndervoltage": 2}]),
    ],
)
def test_of_several_codes_between_two_ticks_the_worst_counts_in_any_order(bench, worst, others):
    for order in ([worst, *others], [*others, worst], [others[0], worst, others[1]]):
        items = [(0.001 * n, BATTERY, values) for n, values in enumerate([*order, {}])]
        bench.vehicle.script(*items, after_tick_ms=15)
        bench.rest(0.160)
        assert bench.command().cut, order
        bench.standby()


def test_of_two_voltage_levels_between_two_ticks_both_effects_count(bench):
    bench.vehicle.script((0.0, LEFT, {"VoltageLevel": 0}), (0.001, LEFT, {"VoltageLevel": 1}))
    bench.rest(0.120)
    effects = {effect for subject, effect in told(bench) if subject == "PCU1_Status1.VoltageLevel"}
    assert effects == {"power limit", "regen off"}


def test_a_code_in_every_frame_counts_though_two_spoofed_good_ones_follow_each(bench):
    bench.drive(throttle_pct=30)
    bench.vehicle.follow(
        BATTERY, (0.001, {"CellUndervoltage": 0}), (0.002, {"CellUndervoltage": 0})
    )
    since = time.monotonic()
    bench.vehicle.set(BATTERY, CellUndervoltage=1)
    first = bench.frame(BATTERY, since).t
    bench.until(first + 2.6)
    late = [f.command for f in bench.commands(first + 0.95)]
    assert len(late) > 40
    assert all(c.power_limit == 10000 and c.power_mode == wire.ECO for c in late)
    since = time.monotonic()
    bench.vehicle.follow(BATTERY, (0.001, {"InternalFault": 0}), (0.002, {"InternalFault": 0}))
    bench.vehicle.set(BATTERY, InternalFault=1)
    bench.must_be_safe_after(bench.frame(BATTERY, since).t, wire.POWER_CUT)


def lives(bench: Bench, *lives: int) -> float:
    """BMS_Status frames 1 ms apart with these life signals; the stamp of the last."""
    since = time.monotonic()
    items = [(0.001 * n, BATTERY, {"life": life}) for n, life in enumerate(lives)]
    bench.vehicle.script(*items, after_tick_ms=10)
    bench.rest(0.115 + 0.001 * len(lives))  # a tick before them, and one after
    return bench.recorder.of(BATTERY, since)[-1].t


def test_a_life_signal_that_stood_still_between_two_ticks_limits_and_then_stops(bench):
    bench.drive(throttle_pct=30)
    last = lives(bench, 0, 1, 1, 0)
    assert all(c.command.power_mode == wire.ECO for c in bench.commands(last + GRACE_S))
    assert (BATTERY, "power limit") in {(s.split(".")[0], e) for s, e in told(bench)}
    assert bench.mode() == "active"

    bench.drive(throttle_pct=30)
    last = lives(bench, 0, 1, 1, 1, 0)
    bench.must_be_safe_after(last, wire.ZERO_TORQUE)
    assert bench.mode() == "fault"


def test_a_life_signal_that_stands_still_in_every_other_frame_limits(bench):
    bench.drive(throttle_pct=30)
    bench.vehicle.periods(BMS_Status=1000)  # none but these: one more would be a third
    began = time.monotonic()
    life = bench.recorder.of(BATTERY, began - 1)[-1].data[7] >> 7
    for _ in range(8):
        life ^= 1
        bench.vehicle.script((0.0, BATTERY, {"life": life}), (0.001, BATTERY, {"life": life}))
        bench.rest(0.045)
    bench.vehicle.periods(BMS_Status=500)
    heard = bench.recorder.of(BATTERY, began)
    stood = next(
        after
        for before, after in itertools.pairwise(heard)
        if after.data[7] & 128 == before.data[7] & 128
    )
    late = bench.commands(stood.t + GRACE_S)
    assert late
    assert all(f.command.power_mode == wire.ECO for f in late)


def test_a_value_out_of_range_is_told_though_a_good_frame_follows(bench):
    bench.vehicle.script((0.0, BATTERY, {"SOC": 101}), (0.001, BATTERY, {}), after_tick_ms=10)
    bench.rest(0.120)
    assert (f"{BATTERY}.SOC", "alarm") in told(bench)
    bench.speeds(1900)
    bench.rest(0.2)
    bench.speeds(3800)
    bench.rest(0.2)
    bench.speeds(5700)
    bench.rest(0.2)
    bench.vehicle.script(
        (0.0, "PCU2_Status2", {"MotorSpeed": 6001}), (0.001, "PCU2_Status2", {}), after_tick_ms=10
    )
    bench.rest(0.120)
    assert ("PCU2_Status2.MotorSpeed", "alarm") in told(bench)
    bench.speeds(3800)
    bench.rest(0.15)
    bench.speeds(1900)
    bench.rest(0.15)


def test_an_echo_of_too_much_throttle_stops_though_a_good_one_follows(bench):
    bench.drive(throttle_pct=20)
    bench.rest(0.6)
    since = time.monotonic()
    much = (0x0808D0A7, wire.status1(wire.STATUS1_HEALTHY, bytes([0, 64, 0])))
    bench.vehicle.script((0.0, None, wire.packed(*much)), (0.001, LEFT, {}))
    bench.must_be_safe_after(bench.frame(LEFT, since).t, wire.ZERO_TORQUE)
    assert bench.mode() == "fault"


def demands(bench: Bench, distance_s: float, *several: dict) -> float:
    """Demands of one connection so far apart, 0 in one write; when the last was answered."""
    sent = time.monotonic()
    for values in several:
        params = bench.client.demand_params(bench.source, **values)
        bench.client.write(bench.client.line("demand.set", **params))
        bench.rules.asked(sent, time.monotonic() + 0.01, values)
        time.sleep(distance_s)
    for _ in several:
        assert "result" in bench.client.answer()
    bench.pedals, bench.renewed = several[-1], time.monotonic()
    return time.monotonic()


@pytest.mark.parametrize("distance_ms", [0, 1])
def test_brake_over_throttle_counts_in_a_demand_that_another_follows(bench, figures, distance_ms):
    def held(number: int) -> bool:
        bench.drive(throttle_pct=0)
        bench.rest(0.12)
        bench.drive(throttle_pct=30)
        bench.rest(0.003 * number)
        braked, released = {"throttle_pct": 40, "brake_pct": 10}, {"throttle_pct": 40}
        answered = demands(bench, distance_ms / 1000, braked, released)
        bench.until(answered + 0.25)
        return all(f.command.throttle == 0 for f in bench.commands(answered + 0.070))

    right = bench.of_ten(held)
    figures.append(
        f"throttle 40 with brake 10, without brake {distance_ms} ms later: throttle 0 {right} of 10"
    )
    assert right == 10


def test_a_wish_for_the_other_direction_counts_though_another_demand_follows(bench):
    bench.speeds(1000)
    bench.drive(throttle_pct=30)
    sent = time.monotonic()
    forward = {"throttle_pct": 30}
    answered = demands(bench, 0.001, {"throttle_pct": 30, "motor_reverse": True}, forward)
    bench.until(answered + 0.1)
    assert any(f.command.throttle == 0 for f in bench.commands(sent))
    assert not any(f.command.reverse for f in bench.commands(sent))
