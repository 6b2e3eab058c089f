"""What the verdict's slip limiter allows, tick by tick (docs/safety.md, Tuning)."""

import math

import pytest

from tests.judge.test_caps_agree import IDS, VEHICLE, settings_of
from tests.replay.drives import MS
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.judge.arrivals import Arrivals
from vcu_gateway.judge.demands import GrantedDemands
from vcu_gateway.judge.limits import JudgedDemand
from vcu_gateway.judge.tuning_rules import TuningRules, TuningTick
from vcu_gateway.protocol import DEFAULT_ALIASES
from vcu_gateway.replay.judged import limits_of

SLIP = """laws: {slip: {
  wait_ms: 150, return_pct_per_s: 50, allowed_pct: 25, allowed_kmh: 5, cut_share_pct: 30,
  lowest_throttle_pct: 20, asymmetry_max_pct: 25}}
"""
FRONT_KMH = 40.0
ALLOWED_KMH = FRONT_KMH * 1.25 + 5
RPM_PER_KMH = 50
SENT_RAW = 200
SENT_PCT = (SENT_RAW + 0.5) * 0.39
BACK_PCT = 50 * 0.05  # in a tick
TICK_NS = 50 * MS
STALE_TICKS = 300 // 50  # of ARD2_SteeringWheel
SLIPS, AT_ITS_LIMIT, GRIPS = 2.0, 0.0, -2.0
SATURATED_KMH = 65.535


class Rollers:
    """A vehicle whose PCU1's wheel slips as a test says, and whose PCU2's has grip."""

    def __init__(self, *, complete: bool = True) -> None:
        self.limits = limits_of(settings_of(SLIP), DEFAULT_ALIASES)
        self.rules = TuningRules(self.limits, complete=complete)
        self.arrivals = Arrivals(self.limits, complete=complete)
        self.now_ns = 10**12
        self.sent_raw = SENT_RAW
        self.throttle_pct, self.expired = 100.0, False
        if complete:
            self.tick(GRIPS, active=False)

    def receive(self, message: str, at: int, *fields: int) -> None:
        data = bytes(at) + b"".join(one.to_bytes(2, "little") for one in fields)
        self.arrivals.receive([Frame(IDS[message], data.ljust(8, b"\0"), self.now_ns)])

    def fronts(self, *speeds_kmh: float) -> None:
        """A frame of the wheels for each: the right one as fast, the left one slower."""
        for one in speeds_kmh:
            code = round(one * 1000)
            self.receive("ARD2_SteeringWheel", 2, max(code - 500, 0), code)

    def spin(self, over_kmh: float, name: str = "PCU1") -> None:
        """A frame of a motor whose wheel is so much above the speed allowed at 40 km/h."""
        self.receive(f"{name}_Status2", 6, round((ALLOWED_KMH + over_kmh) * RPM_PER_KMH))

    def tick(self, over_kmh: float, *fronts_kmh: float, active: bool = True) -> float:
        """Most throttle of PCU1 in a tick; `over_kmh`: its wheel above the speed allowed at 40."""
        self.now_ns += TICK_NS
        self.fronts(*(fronts_kmh or (FRONT_KMH,)))
        return self.decided(over_kmh, active=active)["PCU1"]

    def decided(self, over_kmh: float, *, active: bool = True) -> dict[str, float]:
        self.spin(over_kmh)
        self.spin(GRIPS, "PCU2")
        sent = dict.fromkeys(("PCU1", "PCU2"), self.sent_raw)
        caps = self.rules.tick(
            TuningTick(self.limits, self.arrivals, self.demands(), sent, self.now_ns, 0.05, active)
        )
        self.arrivals.end_tick()
        return dict(caps.throttle_pct)

    def demands(self) -> GrantedDemands:
        one = JudgedDemand(self.throttle_pct, 0.0, 0, False, False, 12_000.0, 14_000.0)
        demands = GrantedDemands({"PCU1": one, "PCU2": one}, known=True)
        if self.expired:
            demands.ended()
        return demands

    def ticks(self, *overs_kmh: float) -> list[float]:
        return [self.tick(one) for one in overs_kmh]


def test_a_wheel_that_slips_has_its_share_cut_from_the_throttle_sent():
    assert Rollers().tick(SLIPS) == pytest.approx(0.7 * SENT_PCT)


def test_the_next_cut_comes_a_wait_later_and_from_what_is_left():
    cut = 0.7 * SENT_PCT
    found = Rollers().ticks(*[SLIPS] * 5)
    assert found == pytest.approx([cut, cut, cut, 0.7 * cut, 0.7 * cut])


def test_no_cut_is_below_the_lowest_throttle():
    rollers = Rollers()
    rollers.sent_raw = 30
    assert rollers.tick(SLIPS) == 20


def test_the_other_controller_keeps_the_cut_one_and_the_asymmetry_at_most():
    rollers = Rollers()
    rollers.now_ns += TICK_NS
    rollers.fronts(FRONT_KMH)
    assert rollers.decided(SLIPS)["PCU2"] == pytest.approx(0.7 * SENT_PCT + 25)


def test_with_grip_it_returns_to_all_of_the_throttle():
    rollers = Rollers()
    cut = rollers.tick(SLIPS)
    assert rollers.ticks(GRIPS, GRIPS) == pytest.approx([cut + BACK_PCT, cut + 2 * BACK_PCT])
    assert rollers.ticks(*[GRIPS] * 20)[-1] == 100


def test_outside_active_nothing_is_cut():
    rollers = Rollers()
    rollers.tick(SLIPS)
    assert rollers.tick(SLIPS, active=False) == 100
    assert rollers.tick(SLIPS) == pytest.approx(0.7 * SENT_PCT), "and no wait is left"


@pytest.mark.parametrize("fronts_kmh", [(FRONT_KMH, FRONT_KMH + 8), (FRONT_KMH + 8, FRONT_KMH)])
def test_of_several_frames_the_lowest_front_speed_counts(fronts_kmh):
    assert Rollers().tick(SLIPS, *fronts_kmh) == pytest.approx(0.7 * SENT_PCT)


def test_a_saturated_front_wheel_cuts_nothing_and_lets_it_return():
    rollers = Rollers()
    cut = rollers.tick(SLIPS)
    assert rollers.tick(SLIPS, SATURATED_KMH, FRONT_KMH) == pytest.approx(cut + BACK_PCT)


@pytest.mark.parametrize(("throttle_pct", "back_pct"), [(5.0, 0.0), (4.9, BACK_PCT)])
def test_without_a_front_speed_it_returns_while_the_pedal_is_released_alone(throttle_pct, back_pct):
    rollers = Rollers()
    cut = rollers.tick(SLIPS)
    rollers.now_ns += (STALE_TICKS + 1) * TICK_NS
    rollers.throttle_pct = throttle_pct
    assert rollers.decided(SLIPS)["PCU1"] == pytest.approx(cut + back_pct)


def test_without_a_front_speed_it_returns_where_nothing_is_demanded_any_more():
    rollers = Rollers()
    cut = rollers.tick(SLIPS)
    rollers.now_ns += (STALE_TICKS + 1) * TICK_NS
    rollers.expired = True
    assert rollers.decided(SLIPS)["PCU1"] == pytest.approx(cut + BACK_PCT)


@pytest.mark.parametrize("before", [SLIPS, GRIPS])
def test_of_several_frames_the_highest_speed_of_a_motor_counts(before):
    rollers = Rollers()
    rollers.spin(before)
    assert rollers.tick(SLIPS if before is GRIPS else GRIPS) == pytest.approx(0.7 * SENT_PCT)


def test_a_motor_that_is_not_believed_changes_nothing():
    rollers = Rollers()
    cut = rollers.tick(SLIPS)
    assert rollers.ticks(GRIPS - 50, GRIPS - 50) == pytest.approx([cut, cut])


# What the verdict cannot know: a wheel at its limit slips or not by the order of the arithmetic.


def test_a_wheel_at_its_limit_is_capped_no_more():
    rollers = Rollers()
    rollers.tick(SLIPS)
    assert rollers.tick(AT_ITS_LIMIT) == 100


@pytest.mark.parametrize(("grips", "is_cut"), [(1, False), (2, True)])
def test_after_a_wheel_at_its_limit_a_cut_is_certain_when_the_wait_is_over(grips, is_cut):
    """It may have been cut: then the next cut comes a wait later."""
    *_, found = Rollers().ticks(AT_ITS_LIMIT, *[GRIPS] * grips, SLIPS)
    assert found == pytest.approx(0.7 * SENT_PCT if is_cut else 100)


@pytest.mark.parametrize("second", [SLIPS, AT_ITS_LIMIT])
def test_begun_in_the_middle_a_cut_is_certain_when_the_old_speed_and_the_wait_are_over(second):
    """The core may know a front speed from before, until it is stale, and cut by it."""
    rollers = Rollers(complete=False)
    assert rollers.ticks(SLIPS, second, GRIPS, GRIPS, GRIPS, SLIPS) == [100] * 6
    left = STALE_TICKS + 3 - 5
    *grips, found = rollers.ticks(*[GRIPS] * (left - 1), SLIPS)
    assert grips == [100] * (left - 1)
    assert found == pytest.approx(0.7 * SENT_PCT)


def test_where_the_throttle_sent_is_not_known_all_of_it_may_have_been_sent():
    rollers = Rollers()
    rollers.sent_raw = 255
    assert rollers.tick(SLIPS) == pytest.approx(70)


def test_the_speeds_of_this_test_are_exact():
    """So a wheel is at its limit to the last bit, as the test says."""
    assert math.isclose(round(ALLOWED_KMH * RPM_PER_KMH) / RPM_PER_KMH, ALLOWED_KMH, abs_tol=1e-12)
    assert f"motor_rpm_per_kmh: {RPM_PER_KMH}" in VEHICLE
