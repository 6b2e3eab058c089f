"""What a frame says that holds only against the ones before it, at its boundaries."""

from typing import Any

import pytest

from tests.core.simulated_drive import CODEC, MS, PROTOCOL, data
from vcu_gateway.core import plausibility
from vcu_gateway.core.plausibility import NO_DEVIATION, Plausibility
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Store
from vcu_gateway.core.transmit import SentValues

START_NS = 10_000 * MS
WHEELS = "ARD2_SteeringWheel"
BIT_PCT = 0.39


class Watch:
    """Frames in, one tick after the other."""

    def __init__(self, **settings: Any) -> None:
        received = PROTOCOL.received_by("VCU")
        self.store = Store(received, {message.name: 2**62 for message in received})
        self.plausibility = Plausibility()
        self.settings = Settings(**settings)
        self.history: dict[str, list[SentValues]] = {}

    def put(self, message: str, at_ms: float, **raws: int) -> "Watch":
        decoded = CODEC.by_name[message].decode(data(message, raws))
        self.store.put(message, decoded, START_NS + int(at_ms * MS))
        return self

    def tick(self, at_ms: int = 60_000):
        snapshot = self.store.take(START_NS + at_ms * MS)
        return self.plausibility.observe(snapshot, self.history, self.settings)

    def sent(self, *commands: tuple[float, float], reverse: bool = False) -> None:
        """Commands to PCU1 at these ms, of this throttle."""
        kept = self.history.setdefault("PCU1", [])
        kept += [SentValues(START_NS + int(at_ms * MS), pct, reverse) for at_ms, pct in commands]


def steady(until_ms: float, throttle_pct: float) -> list[tuple[float, float]]:
    return [(at_ms, throttle_pct) for at_ms in range(-2000, int(until_ms), 50)]


# More throttle than commanded; a bit is 0.39 %: 100 bits are 39 %, 12 bits are below 5 %.


@pytest.mark.parametrize(
    ("raw", "sent", "found"),
    [
        (100, [(-50, 39.0)], False),
        (100, [(-50, 34.0)], False),
        (100, [(-50, 33.999)], True),
        (101, [(-50, 34.0)], True),
        (12, [(-50, 0.0)], False),
        (13, [(-50, 0.0)], True),
        (100, [(-1000, 39.0), (0, 0.0)], False),
        (100, [(-1000.000001, 39.0), (0, 0.0)], True),
        (100, [(0, 39.0)], False),
        (100, [(0.000001, 39.0)], True),
        (12, [], False),
        (13, [], True),
        (255, [(0, 39.0)], True),
    ],
    ids=[
        *("as commanded", "5 % more", "a little more than 5 %", "one bit more than 5 %"),
        *("12 bits above 0", "13 bits above 0", "a command of one second ago", "an older one"),
        *("a command at that instant", "a command after the echo"),
        *("12 bits, never commanded", "13 bits, never commanded", "the highest code"),
    ],
)
def test_an_echo_is_too_high_by_more_than_5_percent(raw, sent, found):
    watch = Watch()
    watch.sent(*sent)
    watch.put("PCU1_Status1", 0, Throttle=raw)
    for _ in range(2):
        above = watch.tick().echo_above
        assert above.keys() == ({"PCU1"} if found else set()), "it stands until the next frame"
        if found:
            assert above["PCU1"].echoed_pct == pytest.approx(raw * BIT_PCT)
            highest = max((pct for at_ms, pct in sent if -1000 <= at_ms <= 0), default=0)
            assert above["PCU1"].commanded_pct == highest


def test_the_highest_echo_between_two_ticks_counts_though_an_obedient_one_followed():
    watch = Watch()
    watch.sent((-1, 0.0))
    for at_ms, raw in ((0, 50), (1, 100), (2, 60), (3, 0)):
        watch.put("PCU1_Status1", at_ms, Throttle=raw)
    assert watch.tick().echo_above["PCU1"].echoed_pct == pytest.approx(39.0)
    assert watch.tick() is NO_DEVIATION


# Less throttle than commanded.


@pytest.mark.parametrize(
    ("raw", "run"),
    [(100, 0), (62, 0), (61, 1), (0, 1)],
    ids=["as commanded", "14.82 % less", "15.21 % less", "none"],
)
def test_an_echo_is_too_low_by_more_than_15_percent(raw, run):
    watch = Watch()
    watch.sent(*steady(1, 100 * BIT_PCT))
    watch.put("PCU1_Status1", 0, Throttle=raw)
    assert watch.tick().echo_below.get("PCU1", 0) == run


@pytest.mark.parametrize(("commanded_pct", "run"), [(15.0, 0), (15.000001, 1)])
def test_an_echo_of_nothing_is_too_low_for_more_than_15_percent(commanded_pct, run):
    watch = Watch()
    watch.sent(*steady(1, commanded_pct))
    watch.put("PCU1_Status1", 0, Throttle=0)
    assert watch.tick().echo_below.get("PCU1", 0) == run


def test_how_much_too_low_is_a_setting():
    watch = Watch(echo_below_max_pct=50.0)
    watch.sent(*steady(1, 200 * BIT_PCT))
    watch.put("PCU1_Status1", 0, Throttle=72)
    assert watch.tick().echo_below.get("PCU1", 0) == 0
    watch.put("PCU1_Status1", 1, Throttle=71)
    assert watch.tick().echo_below.get("PCU1", 0) == 1


@pytest.mark.parametrize(("at_ms", "run"), [(-1000, 0), (-1000.001, 1), (0, 0), (0.001, 1)])
def test_the_lowest_command_of_the_second_before_counts(at_ms, run):
    watch = Watch()
    watch.sent((-1500, 90.0), (-500, 90.0), (at_ms, 0.0))
    watch.put("PCU1_Status1", 0, Throttle=0)
    assert watch.tick().echo_below.get("PCU1", 0) == run


def test_without_a_whole_second_of_commands_nothing_is_too_low():
    watch = Watch()
    watch.sent((-999.999, 90.0), (-500, 90.0))
    watch.put("PCU1_Status1", 0, Throttle=0)
    assert watch.tick().echo_below.get("PCU1", 0) == 0
    watch.put("PCU1_Status1", 0.001, Throttle=0)
    assert watch.tick().echo_below.get("PCU1", 0) == 1


def test_without_a_command_in_the_second_before_nothing_is_too_low():
    watch = Watch()
    watch.sent((-1500, 90.0))
    watch.put("PCU1_Status1", 0, Throttle=0)
    assert watch.tick().echo_below.get("PCU1", 0) == 0


def test_frames_in_a_row_are_counted_and_one_that_obeys_ends_the_run():
    watch, seen = Watch(), []
    watch.sent(*steady(3000, 78.0))
    for number, raw in enumerate((0, 0, 200, 0)):
        watch.put("PCU1_Status1", 500 * number, Throttle=raw)
        seen.append(watch.tick().echo_below.get("PCU1", 0))
    assert seen == [1, 2, 0, 1]


def test_a_frame_out_of_order_is_judged_and_ends_nothing():
    watch = Watch()
    watch.sent(*steady(1000, 78.0))
    watch.put("PCU1_Status1", 0, Throttle=0).put("PCU1_Status1", 500, Throttle=0)
    watch.put("PCU1_Status1", 499, Throttle=200)
    assert watch.tick().echo_below == {"PCU1": 2}
    watch.put("PCU1_Status1", 498, Throttle=255)
    observed = watch.tick()
    assert (observed.echo_below, list(observed.echo_above)) == ({"PCU1": 2}, ["PCU1"])
    observed = watch.tick()
    assert (observed.echo_below, observed.echo_above) == ({"PCU1": 2}, {})


def test_of_two_frames_of_one_instant_the_second_is_the_latest():
    watch = Watch()
    watch.sent(*steady(1000, 78.0))
    watch.put("PCU1_Status1", 0, Throttle=0).put("PCU1_Status1", 0, Throttle=200)
    watch.tick()
    assert watch.tick().echo_below == {}


def test_whoever_obeyed_in_its_last_frame_is_told():
    watch = Watch()
    watch.sent(*steady(1000, 78.0))
    watch.put("PCU1_Status1", 0, Throttle=0).put("PCU1_Status1", 1, Throttle=0)
    assert watch.tick().echoes_below == {"PCU1"}
    watch.put("PCU1_Status1", 2, Throttle=0).put("PCU1_Status1", 3, Throttle=200)
    observed = watch.tick()
    assert (observed.echo_below, observed.echoes_below) == ({"PCU1": 3}, frozenset())


def test_a_run_stands_until_the_next_frame_says_otherwise():
    watch = Watch()
    watch.sent(*steady(1000, 78.0))
    watch.put("PCU1_Status1", 0, Throttle=0).put("PCU1_Status1", 500, Throttle=0)
    assert [watch.tick().echo_below.get("PCU1", 0) for _ in range(3)] == [2, 2, 2]


def test_the_longest_run_between_two_ticks_counts_though_a_good_frame_ended_it():
    watch = Watch()
    watch.sent(*steady(1000, 78.0))
    for at_ms, raw in ((0, 0), (1, 0), (2, 200)):
        watch.put("PCU1_Status1", at_ms, Throttle=raw)
    assert watch.tick().echo_below.get("PCU1", 0) == 2
    assert watch.tick().echo_below.get("PCU1", 0) == 0


# Another direction than commanded.


@pytest.mark.parametrize(("age_ms", "run"), [(0, 0), (1100, 0), (1100.001, 1)])
def test_a_direction_commanded_in_the_last_1100_ms_may_be_echoed(age_ms, run):
    watch = Watch()
    watch.sent((-age_ms, 0.0), reverse=True)
    watch.sent((-10, 0.0))
    watch.put("PCU1_Status1", 0, MotorReverse=1)
    assert watch.tick().echo_direction.get("PCU1", 0) == run


def test_the_longest_run_of_a_wrong_direction_counts_though_a_right_one_ended_it():
    watch = Watch()
    watch.sent((-10, 0.0))
    for at_ms, reverse in ((0, 1), (1, 1), (2, 0)):
        watch.put("PCU1_Status1", at_ms, MotorReverse=reverse)
    assert watch.tick().echo_direction.get("PCU1", 0) == 2
    assert watch.tick().echo_direction.get("PCU1", 0) == 0


def test_before_our_first_command_no_direction_is_wrong():
    watch = Watch()
    watch.put("PCU1_Status1", 0, MotorReverse=1)
    assert watch.tick().echo_direction.get("PCU1", 0) == 0


def test_a_command_after_the_frame_excuses_no_direction():
    watch = Watch()
    watch.sent((-10, 0.0))
    watch.sent((0.001, 0.0), reverse=True)
    watch.put("PCU1_Status1", 0, MotorReverse=1)
    assert watch.tick().echo_direction.get("PCU1", 0) == 1


# Motor speed.


def speeds(*values: tuple[float, int], **settings: float) -> list[bool]:
    """Whether the speed of PCU1 is doubted after each frame, a tick each."""
    watch, doubted = Watch(**settings), []
    for at_ms, rpm in values:
        watch.put("PCU1_Status2", at_ms, MotorSpeed=rpm)
        doubted.append("PCU1" in watch.tick().speed_steps_rpm)
    return doubted


@pytest.mark.parametrize(
    ("after", "doubted"), [((50, 2000), False), ((50, 2001), True), ((100, 2001), True)]
)
def test_a_speed_that_changes_by_more_than_2000_rpm_within_100_ms_is_doubted(after, doubted):
    assert speeds((0, 0), after) == [False, doubted]


def test_a_change_over_more_than_100_ms_is_no_step():
    assert speeds((0, 0), (100.001, 6000)) == [False, False]


def test_a_change_between_two_frames_of_one_instant_is_a_step():
    assert speeds((0, 0), (0, 6000)) == [False, True]


def test_a_fall_is_a_step_like_a_rise():
    assert speeds((0, 5000), (50, 2999)) == [False, True]


def test_three_plausible_frames_in_a_row_are_believed_again():
    after = [(100, 5000), (150, 5000), (200, 5000), (250, 5000)]
    assert speeds((0, 0), (50, 5000), *after) == [False, True, True, True, False, False]


def test_another_step_begins_the_three_anew():
    assert speeds((0, 0), (50, 5000), (100, 5000), (150, 0), (200, 0), (250, 0), (300, 0)) == [
        *(False, True, True, True, True, True, False)
    ]


def test_the_step_is_a_setting():
    assert speeds((0, 0), (50, 501), motor_speed_step_max_rpm=500.0) == [False, True]


def test_a_step_between_two_ticks_is_doubted_though_plausible_frames_followed_in_the_same():
    watch = Watch()
    for at_ms, rpm in ((0, 0), (1, 5000), (2, 5000), (3, 5000), (4, 5000)):
        watch.put("PCU1_Status2", at_ms, MotorSpeed=rpm)
    assert watch.tick().speed_steps_rpm == {"PCU1": 5000.0}
    assert watch.tick().speed_steps_rpm == {}


def test_a_doubt_stands_without_a_frame():
    watch = Watch()
    watch.put("PCU2_Status2", 0, MotorSpeed=0).put("PCU2_Status2", 50, MotorSpeed=6000)
    assert [watch.tick().speed_steps_rpm for _ in range(3)] == [{"PCU2": 6000.0}] * 3


def test_a_doubt_stands_without_a_frame_until_the_third_plausible_one():
    watch = Watch()
    for at_ms, rpm in ((0, 0), (50, 5000), (100, 5000), (150, 5000)):
        watch.put("PCU1_Status2", at_ms, MotorSpeed=rpm)
    assert [watch.tick().speed_steps_rpm for _ in range(2)] == [{"PCU1": 5000.0}] * 2
    watch.put("PCU1_Status2", 200, MotorSpeed=5000)
    assert watch.tick().speed_steps_rpm == {}


def test_a_frame_older_than_the_one_before_it_is_no_step():
    watch = Watch()
    watch.put("PCU1_Status2", 50, MotorSpeed=0).put("PCU1_Status2", 0, MotorSpeed=6000)
    watch.put("PCU1_Status2", 100, MotorSpeed=0)
    assert watch.tick().speed_steps_rpm == {}


def test_frames_out_of_order_are_no_plausible_ones():
    watch = Watch()
    watch.put("PCU1_Status2", 0, MotorSpeed=0).put("PCU1_Status2", 50, MotorSpeed=5000)
    watch.tick()
    for at_ms in (10, 20, 30):
        watch.put("PCU1_Status2", at_ms, MotorSpeed=5000)
    assert [watch.tick().speed_steps_rpm for _ in range(2)] == [{"PCU1": 5000.0}] * 2


# Wheels.


@pytest.mark.parametrize("wheel", ["WheelSpeedFL", "WheelSpeedFR"])
def test_a_wheel_that_changes_by_more_than_20_kmh_between_two_frames_is_told_in_that_tick(wheel):
    watch = Watch()
    watch.put(WHEELS, 0, **{wheel: 0}).put(WHEELS, 100, **{wheel: 20_000})
    assert watch.tick().wheel_steps_kmh == {}
    watch.put(WHEELS, 200, **{wheel: 40_001})
    assert watch.tick().wheel_steps_kmh == {wheel: pytest.approx(20.001)}
    assert watch.tick().wheel_steps_kmh == {}


def test_wheels_that_change_together_are_told_though_they_are_not_apart():
    watch = Watch()
    watch.put(WHEELS, 0).put(WHEELS, 100, WheelSpeedFL=30_000, WheelSpeedFR=30_000)
    observed = watch.tick()
    assert observed.wheels_apart_ns is None
    assert observed.wheel_steps_kmh == {one: pytest.approx(30) for one in plausibility.WHEELS}


def test_the_largest_step_between_two_ticks_is_told():
    watch = Watch(wheel_speed_step_max_kmh=5.0)
    for at_ms, raw in ((0, 0), (1, 6000), (2, 36_000), (3, 30_000)):
        watch.put(WHEELS, at_ms, WheelSpeedFL=raw)
    assert watch.tick().wheel_steps_kmh == {"WheelSpeedFL": pytest.approx(30)}


def test_wheels_are_apart_from_the_first_frame_with_more_than_15_kmh_between_them():
    watch = Watch()
    watch.put(WHEELS, 0, WheelSpeedFL=15_000)
    assert watch.tick(0).wheels_apart_ns is None
    for at_ms in (100, 200):
        watch.put(WHEELS, at_ms, WheelSpeedFR=15_001)
        assert watch.tick(250).wheels_apart_ns == 150 * MS
    assert watch.tick(275).wheels_apart_ns == 175 * MS, "also without a frame"
    watch.put(WHEELS, 300, WheelSpeedFR=15_000)
    assert watch.tick(300).wheels_apart_ns is None


def test_wheels_that_were_apart_until_just_before_the_tick_are_told():
    watch = Watch()
    for at_ms in range(0, 1001, 100):
        watch.put(WHEELS, at_ms, WheelSpeedFR=15_001)
    watch.put(WHEELS, 1010, WheelSpeedFR=15_000)
    assert watch.tick(1040).wheels_apart_ns == 1000 * MS
    assert watch.tick(1090).wheels_apart_ns is None


def test_a_frame_out_of_order_says_nothing_of_the_wheels():
    watch = Watch()
    watch.put(WHEELS, 100, WheelSpeedFR=15_001).put(WHEELS, 50)
    assert watch.tick(200).wheels_apart_ns == 100 * MS
    watch.put(WHEELS, 60, WheelSpeedFR=60_000)
    assert watch.tick(250).wheel_steps_kmh == {}


def test_one_frame_of_agreement_between_two_ticks_begins_the_second_anew():
    watch = Watch(wheel_speed_difference_max_kmh=1.0)
    for at_ms, raw in ((0, 2000), (10, 0), (20, 2000)):
        watch.put(WHEELS, at_ms, WheelSpeedFL=raw)
    assert watch.tick(100).wheels_apart_ns == 80 * MS
