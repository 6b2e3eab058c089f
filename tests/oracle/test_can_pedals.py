"""A pedal node and its frames, by docs/safety.md, Pedals."""

import time
from typing import Any

import pytest

from tests.oracle import pedal_node, wire
from tests.oracle.bench import GRACE_S
from tests.oracle.pedal_node import MESSAGE, asked_pct, code, codes
from tests.oracle.watching import TICK_S, rises, throttles_stay_zero

SECTIONS = pedal_node.SECTIONS
COAST = [[0, 15], [5, 0]]
SOME = wire.percent(20)
UNBELIEVED_S, SILENT_S, LATCHED_S = 0.100, 0.060, 1.0


def travelled(throttle: float = 0, track2: float | None = None, brake: float = 0) -> dict[str, int]:
    """The codes of so many per cent of each travel."""
    return {
        "throttle": code("throttle", throttle),
        "throttle_track2": code("throttle_track2", throttle if track2 is None else track2),
        "brake": code("brake", brake),
    }


def drive(bench, **values: Any) -> None:
    bench.drive(power_mode="turbo", **{"throttle_pct": 20, **values})


def once(bench, **raws: int) -> list[int]:
    """Throttles of the ticks after one frame that a good one follows, before the next tick."""
    since = time.monotonic()
    bench.vehicle.script((0.0, MESSAGE, raws), (0.003, MESSAGE, {}), after_tick_ms=20)
    return [frame.command.throttle for frame in bench.ticks(since, 8)]


def first_zero(bench, since: float) -> float:
    def there() -> float | None:
        zero = (f.t for f in bench.commands(since) if f.command.throttle == 0)
        return next(zero, None)

    return bench.wait(there, "throttle 0", 1.0)


def test_the_checksum_is_that_of_the_standard():
    assert pedal_node.crc8_j1850(b"123456789") == 0x4B


def test_throttle_and_brake_are_travel_between_the_dead_zones(bench):
    drive(bench, throttle_pct=0)
    assert bench.command().power_mode == wire.TURBO
    bench.press(**travelled(109, 109))
    bench.wait(lambda: bench.command().throttle == 255, "full throttle", 2.0)
    for throttle in (97, 95, 50, 12, 4, 2.9, -9):
        bench.press(**travelled(throttle))
        bench.ticks(time.monotonic() + GRACE_S, 1)
        assert bench.command().throttle == wire.percent(asked_pct(throttle)), throttle
    for brake in (2.8, 4, 50, 109):
        bench.press(**travelled(brake=brake))
        bench.ticks(time.monotonic() + GRACE_S, 1)
        exact = asked_pct(pedal_node.travel_pct("brake", code("brake", brake)))
        assert bench.command().brake == wire.percent(exact), brake
    assert not bench.why()["alarms"]


def test_no_other_source_is_granted_while_the_pedals_are_fresh(bench):
    assert bench.client.refused_demand("driver", throttle_pct=0)
    assert bench.client.refused_demand("pedals", throttle_pct=0)


@pytest.mark.parametrize(
    "broken",
    [
        {"throttle": code("throttle", 111)},
        {"throttle_track2": code("throttle_track2", -11)},
        {"brake": code("brake", 111)},
        {"reverse": 2},
    ],
    ids=["track 1", "track 2", "brake", "switch"],
)
def test_one_frame_that_is_not_believed_takes_the_throttle_for_one_tick(bench, broken):
    drive(bench)
    throttles = once(bench, **broken)
    zero = throttles.index(0)
    assert throttles.count(0) == 1, throttles
    assert zero <= 2, throttles
    assert throttles[zero + 1] > 0, throttles
    assert any("pedal_signal" in str(alarm) for alarm in bench.why()["alarms"]), bench.why()
    assert bench.mode() == "active"


def test_unbelieved_frames_beyond_100_ms_latch_until_a_second_of_release(bench):
    drive(bench)
    pressed, opened = codes({"throttle_pct": 20}), {"throttle": 0}
    since = time.monotonic()
    bench.press(**{**pressed, **opened})
    bench.rest(0.060)
    bench.press(**pressed)
    assert rises(bench, 0.2), "shorter than 100 ms"
    assert first_zero(bench, since) <= since + TICK_S + 2 * GRACE_S

    bench.press(**{**pressed, **opened, "brake": code("brake", 40)})
    bench.rest(0.180)
    brake = asked_pct(pedal_node.travel_pct("brake", code("brake", 40)))
    assert (bench.command().throttle, bench.command().brake) == (0, wire.percent(brake))
    bench.press(**pressed)
    assert throttles_stay_zero(bench, 0.2), "latched"
    bench.press(**travelled(4, 9))
    bench.rest(LATCHED_S + 0.1)
    bench.press(**pressed)
    assert throttles_stay_zero(bench, 0.15), "one track was not released"
    bench.press()
    bench.rest(LATCHED_S - 0.15)
    bench.press(**pressed)
    assert throttles_stay_zero(bench, 0.15), "not for a second"
    bench.press()
    bench.rest(LATCHED_S + 0.1)
    bench.press(**pressed)
    assert rises(bench)
    assert bench.mode() == "active"


def test_tracks_that_differ_for_long_take_the_throttle_until_both_are_released(bench):
    drive(bench)
    bench.demand(throttle_pct=20, throttle_track2_pct=29)
    bench.rest(0.25)
    assert bench.command().throttle == SOME
    began = time.monotonic()
    bench.demand(throttle_pct=20, throttle_track2_pct=31)
    took = first_zero(bench, began) - began
    assert 0.095 <= took <= 0.100 + TICK_S + 0.03, f"{took * 1000:.0f} ms"
    for values in (
        {"throttle_pct": 20},
        {"throttle_pct": 4, "throttle_track2_pct": 6},
        {"throttle_pct": 6, "throttle_track2_pct": 4},
    ):
        bench.demand(**values)
        assert throttles_stay_zero(bench, 0.15), values
    bench.demand(throttle_pct=4)
    assert rises(bench)


def test_brake_over_throttle_takes_the_throttle_until_its_release(bench):
    drive(bench, throttle_pct=26)
    bench.demand(throttle_pct=26, brake_pct=4.5)
    bench.rest(0.12)
    assert bench.command().throttle == wire.percent(26)
    began = time.monotonic()
    bench.demand(throttle_pct=26, brake_pct=5.5)
    assert first_zero(bench, began) - began <= TICK_S + 2 * GRACE_S
    for values in ({"throttle_pct": 26}, {"throttle_pct": 5.3}):
        bench.demand(**values)
        assert throttles_stay_zero(bench, 0.15), values
    bench.demand(throttle_pct=4.7)
    assert rises(bench)
    assert bench.mode() == "active"


@pytest.mark.parametrize(
    "wrong", [{"wrong": 1}, {"wrong": 0x80}, {"step": 0}, {"step": 2}], ids=str
)
def test_a_frame_with_wrong_checksum_or_counter_is_no_demand_and_three_are_told(bench, wrong):
    """Beside a frame that is as it should be, it changes nothing; alone they are no pedals."""
    drive(bench)
    more = codes({"throttle_pct": 60})
    since = time.monotonic()
    for _ in range(2):
        assert set(once(bench, **more, **wrong)) == {SOME}
    assert not bench.why()["alarms"]
    bench.press(**more, **wrong)
    bench.wait(lambda: bench.mode() == "standby", "STANDBY", 1.0)
    assert any("pedal_frame" in str(alarm) for alarm in bench.why()["alarms"]), bench.why()
    assert max(f.command.throttle for f in bench.commands(since)) == SOME
    bench.press()


def test_silent_pedals_end_the_drive_after_three_periods(bench):
    drive(bench)
    bench.vehicle.silence(MESSAGE)
    bench.pump()
    last = bench.recorder.of(MESSAGE)[-1].t
    zero = first_zero(bench, last) - last
    assert SILENT_S <= zero <= SILENT_S + TICK_S + 2 * GRACE_S, f"{zero * 1000:.0f} ms"
    bench.rest(0.1)
    assert bench.mode() == "standby"
    assert {f.data for f in bench.last_pair()} == {wire.ZERO_TORQUE}
    bench.vehicle.resume(MESSAGE)
    assert throttles_stay_zero(bench, 0.3)
    assert bench.client.refusal("arm"), "pressed"
    bench.demand()
    bench.rest(0.1)
    assert bench.client.refusal("arm"), "not released for 200 ms"
    bench.arm()
    bench.demand(throttle_pct=20)
    assert rises(bench)


def test_a_press_just_before_arm_is_no_drive(bench):
    """The request between two ticks comes before the gateway has read the frame, or after."""
    pressed = codes({"throttle_pct": 20})
    for _ in range(3):
        bench.demand()
        bench.rest(0.25)
        bench.ticks(time.monotonic(), 1)
        bench.press(**pressed)
        bench.client.refusal("arm")
        assert throttles_stay_zero(bench, 0.2)
        assert bench.mode() == "standby"


def test_the_switch_changes_the_direction_as_any_demand_does(bench):
    bench.speeds(60)
    drive(bench)
    assert not bench.command().reverse
    reverse = {"throttle_pct": 20, "motor_reverse": True}
    bench.demand(**reverse)
    assert throttles_stay_zero(bench, 0.2)
    assert not bench.command().reverse
    bench.speeds(49)
    bench.wait(lambda: bench.command().reverse, "the other direction", 1.0)
    bench.wait(lambda: bench.command().throttle == SOME, "throttle", 1.0)
    once(bench, reverse=3)
    assert bench.command().reverse, "the last known one"
    bench.demand(throttle_pct=20)
    bench.wait(lambda: not bench.command().reverse, "forward again", 1.0)


def test_without_the_key_a_released_pedal_does_not_brake(bench):
    bench.speeds(1000)
    drive(bench, throttle_pct=0)
    bench.rest(0.1)
    command = bench.command()
    assert (command.brake, command.regen) == (0, 1)


def test_coasting_brakes_with_the_released_pedal_and_the_higher_track_counts(own_bench):
    """Last of the file: it has a gateway of its own."""
    bench = own_bench
    bench.run({**SECTIONS, "pedals": {"can": {**pedal_node.KEYS, "coast_brake_pct": COAST}}})
    bench.speeds(1000)
    bench.standby()
    bench.arm()
    for first, second, braked, brake in (
        (0, 0, 0, 15), (2.5, 2.5, 0, 7.5), (0, 4, 0, 3), (4, 0, 0, 3), (5, 5, 0, 0),
        (0, 0, 30, asked_pct(30)), (0, 0, 10, 15), (-5, -5, 0, 15),
    ):  # fmt: skip
        bench.press(**travelled(first, second, braked))
        bench.ticks(time.monotonic() + GRACE_S, 1)
        command = bench.command()
        assert abs(command.brake - wire.percent(brake)) <= 1, (first, second, braked, command)
        assert command.regen == 1
    bench.speeds(0)
    bench.rest(0.2)
    assert (bench.command().brake, bench.command().regen) == (wire.percent(15), 0)
    bench.press(**{**travelled(), "throttle": 0})
    bench.ticks(time.monotonic() + GRACE_S, 1)
    assert bench.command().brake == 0, "not believed: it does not coast"
    bench.press()
