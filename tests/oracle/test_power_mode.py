"""PowerMode and PowerLimit where they change while somebody drives: never in a jump."""

import time
from itertools import pairwise

import pytest

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench
from tests.oracle.recorder import Frame

RELEASED_RAW = 12  # the largest throttle below 5 %
HELD_PCT, JUST_PCT = 13 * 0.39, 12 * 0.39
POWER_STEP_W = 3000  # power_slew_w_per_s, one tick
Tick = tuple[Frame, Frame]


def ticks(bench: Bench, since: float) -> list[Tick]:
    """Both frames of each tick, PCU1's first."""
    frames = bench.commands(since)
    pairs = [two for two in pairwise(frames) if two[1].t - two[0].t < 0.020]
    return [two for two in pairs if tuple(f.can_id for f in two) == wire.COMMANDS]


def modes(bench: Bench, since: float) -> set[int]:
    return {f.command.power_mode for f in bench.commands(since)}


def rank(frame: Frame) -> int:
    """Safety is the lowest of the four."""
    return (frame.command.power_mode + 1) % 4


def must_rise_released_and_together(bench: Bench, since: float) -> int:
    """How often PowerMode rose; each time for both, after frames without throttle."""
    rises = 0
    for before, after in pairwise(ticks(bench, since - 0.060)):  # the tick before, too
        rose = [rank(new) > rank(old) for old, new in zip(before, after, strict=True)]
        if any(rose):
            rises += 1
            assert all(rose), "for one controller alone"
            throttles = [f.command.throttle for f in before]
            assert max(throttles) <= RELEASED_RAW, f"at throttle {throttles}"
    return rises


def driven(bench: Bench, throttle_pct: float, power_mode: str) -> None:
    """In ACTIVE so; PowerMode's rise from the safe frames is past."""
    bench.drive(throttle_pct=throttle_pct, power_mode=power_mode)
    bench.rest(0.15)


def stays(bench: Bench, mode: int, for_s: float = 0.4) -> None:
    since = time.monotonic()
    bench.rest(for_s)
    assert modes(bench, since + GRACE_S) == {mode}


def waits(bench: Bench) -> bool:
    """Whether `why` names it among what it waits for."""
    why = bench.why()
    return any("power mode" in str(one).lower() for one in why["waits"])


def becomes(bench: Bench, mode: int) -> None:
    bench.wait(
        lambda: {f.command.power_mode for f in bench.last_pair()} == {mode}, "PowerMode", 1.0
    )


@pytest.mark.parametrize("throttle_pct", [100, HELD_PCT])
def test_a_demand_for_more_power_waits_for_the_throttles_release(bench, throttle_pct):
    driven(bench, throttle_pct, "eco")
    since = time.monotonic()
    bench.demand(throttle_pct=throttle_pct, power_mode="turbo")
    stays(bench, wire.ECO)
    assert waits(bench), bench.why()["sentence"]
    bench.demand(throttle_pct=0, power_mode="turbo")
    becomes(bench, wire.TURBO)
    assert not waits(bench)
    assert must_rise_released_and_together(bench, since) == 1


def test_below_5_percent_it_rises_at_once(bench):
    driven(bench, JUST_PCT, "eco")
    since = time.monotonic()
    bench.demand(throttle_pct=JUST_PCT, power_mode="normal")
    becomes(bench, wire.NORMAL)
    assert must_rise_released_and_together(bench, since) == 1


@pytest.mark.parametrize("which", ["PCU1", "PCU2"])
def test_one_controllers_throttle_holds_both(bench, which):
    both = {pcu: {"throttle_pct": JUST_PCT, "power_mode": "eco"} for pcu in ("PCU1", "PCU2")}
    both[which]["throttle_pct"] = HELD_PCT
    bench.drive(throttle_pct=0, power_mode="eco")
    bench.demand(controllers=both)
    bench.rest(0.3)
    since = time.monotonic()
    more = {pcu: {**one, "power_mode": "turbo"} for pcu, one in both.items()}
    bench.demand(controllers=more)
    stays(bench, wire.ECO)
    more[which]["throttle_pct"] = JUST_PCT
    bench.demand(controllers=more)
    becomes(bench, wire.TURBO)
    assert must_rise_released_and_together(bench, since) == 1


@pytest.mark.parametrize(
    ("message", "limit", "limited"),
    [
        ("BMS_Status", {"CellUndervoltage": 1}, wire.ECO),
        ("PCU1_Status1", {"TemperatureProtectLevel": 1}, wire.NORMAL),
    ],
    ids=["power limit", "turbo off"],
)
def test_a_limit_that_ends_under_full_throttle_gives_the_mode_back_at_the_release(
    bench, message, limit, limited
):
    driven(bench, 100, "turbo")
    since = time.monotonic()
    bench.vehicle.set(message, **limit)
    arrived = bench.frame(message, since).t
    bench.rest(0.3)
    assert modes(bench, arrived + 0.050 + GRACE_S) == {limited}
    bench.vehicle.set(message, **dict.fromkeys(limit, 0))
    bench.wait(lambda: not bench.why()["limits"], "the limit's end", 3.0)
    stays(bench, limited, 1.2)
    assert waits(bench), bench.why()["sentence"]
    bench.demand(throttle_pct=0, power_mode="turbo")
    becomes(bench, wire.TURBO)
    assert must_rise_released_and_together(bench, since) == 1


def test_from_safe_frames_it_rises_with_arming(bench):
    since = time.monotonic()
    bench.demand(throttle_pct=0, power_mode="turbo")
    bench.arm()
    becomes(bench, wire.TURBO)
    assert must_rise_released_and_together(bench, since) == 1


def test_a_stricter_maximum_is_a_ramp_where_the_demand_names_no_power(bench, reloaded):
    bench.drive(throttle_pct=60)
    assert bench.command().power_limit == 60000
    since = time.monotonic()
    reloaded(limits={"power_limit_max_w": 30000})
    bench.wait(lambda: bench.command().power_limit == 30000, "the maximum", 2.0)
    for pcu in wire.COMMANDS:
        sent = [f.command.power_limit for f in bench.commands(since - 0.1) if f.can_id == pcu]
        falls = [before - after for before, after in pairwise(sent)]
        assert sent[0] == 60000
        assert max(falls) <= POWER_STEP_W, falls
        assert min(falls) >= 0, falls


def test_a_demand_without_a_power_limit_asks_for_60000_w_whatever_the_maximum(own_bench):
    """From a maximum that is lower: nothing was asked that would come down at once."""
    bench = own_bench
    bench.run({"limits": {"power_limit_max_w": 50000}}, fresh=True)
    bench.drive(throttle_pct=60)
    assert bench.command().power_limit == 50000
    since = time.monotonic()
    bench.gateway.configure({"limits": {"power_limit_max_w": 30000}})
    bench.client.call("config.reload")
    bench.wait(lambda: bench.command().power_limit == 30000, "the maximum", 2.0)
    sent = [f.command.power_limit for f in bench.commands(since - 0.1) if f.can_id == 0x0008A7D0]
    falls = [before - after for before, after in pairwise(sent)]
    assert max(falls) <= POWER_STEP_W, falls
