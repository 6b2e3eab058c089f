"""Every row of the causes table, in ACTIVE, by the bytes on the bus."""

import time
from itertools import pairwise
from typing import Any

import pytest

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench
from tests.oracle.recorder import Frame
from tests.oracle.watching import JITTER_S, on_ramp

FULL = {"throttle_pct": 20, "brake_pct": 40, "power_mode": "turbo", "regen_brake": True}
BATTERY, LEFT, RIGHT = "BMS_Status", "PCU1_Status1", "PCU2_Status1"
AT_FULL = wire.Command(
    wire.TURBO, 0, 1, 0, wire.percent(20), wire.percent(40), 12000, 60000, unused=0
)


def drive(bench: Bench) -> None:
    bench.speeds(1000)
    bench.drive(**FULL)
    bench.wait(lambda: bench.command() == AT_FULL, f"{bench.command()}", 3.0)


def tell(bench: Bench, message: str, **values: Any) -> float:
    """Change a signal; the stamp of the first frame that says so."""
    since = time.monotonic()
    bench.vehicle.set(message, **values)
    return bench.frame(message, since).t


STOPS = [
    (BATTERY, "CellUndervoltage", 2, "driver"),
    (BATTERY, "CellUndervoltage", 3, "service"),
    (BATTERY, "DischargeOvercurrent", 2, "service"),
    (BATTERY, "DischargeOvercurrent", 3, "service"),
    (BATTERY, "Overtemperature", 2, "service"),
    (BATTERY, "Overtemperature", 3, "service"),
    (BATTERY, "Undertemperature", 2, "service"),
    (BATTERY, "Undertemperature", 3, "service"),
    (BATTERY, "InternalFault", 1, "service"),
    (LEFT, "TemperatureProtectLevel", 2, "driver"),
    (LEFT, "TemperatureProtectLevel", 3, "driver"),
    (RIGHT, "TemperatureProtectLevel", 2, "driver"),
    (RIGHT, "TemperatureProtectLevel", 3, "driver"),
]


@pytest.mark.parametrize(("message", "signal", "code", "fault_class"), STOPS)
def test_a_stop_or_cut_acts_in_the_first_tick_that_sees_it_and_latches(
    bench, message, signal, code, fault_class
):
    wanted = wire.POWER_CUT if fault_class == "service" else wire.ZERO_TORQUE

    drive(bench)
    told = tell(bench, message, **{signal: code})
    bench.must_be_safe_after(told, wanted)
    why = bench.why()
    assert why["mode"] == "fault"
    assert why["latch"]["fault_class"] == fault_class
    assert any(signal in cause["subject"] for cause in why["blocks"])


def follows(before: Frame, frame: Frame, effects: set[str]) -> bool:
    """The command one tick after another while these effects count on FULL."""
    then, now, gap_s = before.command, frame.command, frame.t - before.t
    mode, regen, steps_down = wire.TURBO, 1, True
    power, brake = 60000, wire.percent(40)
    if "turbo off" in effects:
        mode = wire.NORMAL
    if "power limit" in effects:
        mode, power = wire.ECO, now.power_limit
        steps_down &= on_ramp(then.power_limit, power, 10000, 60000, gap_s)
    if "regen limit" in effects:
        brake = now.brake
        steps_down &= on_ramp(then.brake, brake, wire.percent(20), 100 / 0.39, gap_s)
    if "regen off" in effects:
        regen, brake = 0, 0
    return steps_down and now == wire.Command(
        mode, 0, regen, 0, wire.percent(20), brake, 12000, power, 0
    )


LIMITS = [
    (BATTERY, "CellOvervoltage", 1, {"regen limit"}),
    (BATTERY, "CellOvervoltage", 2, {"regen off"}),
    (BATTERY, "CellUndervoltage", 1, {"power limit"}),
    (BATTERY, "DischargeOvercurrent", 1, {"regen limit", "power limit"}),
    (BATTERY, "Undertemperature", 1, {"regen off"}),
    (LEFT, "TemperatureProtectLevel", 1, {"turbo off"}),
    (RIGHT, "TemperatureProtectLevel", 1, {"turbo off"}),
    (LEFT, "VoltageLevel", 1, {"power limit"}),
    (RIGHT, "VoltageLevel", 1, {"power limit"}),
    (RIGHT, "VoltageLevel", 5, {"regen off"}),
    (LEFT, "VoltageLevel", 5, {"regen off"}),
    (LEFT, "VoltageLevel", 0, {"power limit", "regen off"}),
    (RIGHT, "VoltageLevel", 6, {"power limit", "regen off"}),
    (LEFT, "VoltageLevel", 7, {"power limit", "regen off"}),
]


def as_limited(bench: Bench, told: float, effects: set[str], count: int) -> list[Frame]:
    """Each tick from the one that saw the cause follows the ramps."""
    before, *ticks = bench.ticks(told - 0.1, count + 2)
    # Before the cause's frame its drive may have been on the way to full. A tick that began just
    # before that frame may not know it yet.
    while ticks[0].t < told or (ticks[0].t < told + GRACE_S and ticks[0].command == AT_FULL):
        before, *ticks = ticks
    assert before.command == AT_FULL
    for frame in ticks:
        assert follows(before, frame, effects), (
            f"{(frame.t - told) * 1000:.0f} ms, {effects}: {before.command} {frame.command}"
        )
        before = frame
    return ticks


@pytest.mark.parametrize(("message", "signal", "code", "effects"), LIMITS)
def test_a_limit_begins_in_the_first_tick_and_follows_its_ramp(
    bench, message, signal, code, effects
):
    drive(bench)
    told = tell(bench, message, **{signal: code})
    as_limited(bench, told, effects, 7)
    one, other = bench.last_pair()
    assert one.command == other.command
    why = bench.why()
    assert why["mode"] == "active"
    assert {c["effect"] for c in why["limits"] if signal in c["subject"]} == effects


def test_a_power_limit_ends_at_the_derated_power_and_returns_along_the_same_slew(bench):
    drive(bench)
    told = tell(bench, BATTERY, DischargeOvercurrent=1)
    as_limited(bench, told, {"regen limit", "power limit"}, 22)
    assert bench.command().power_limit == 10000
    since = time.monotonic()
    bench.vehicle.set(BATTERY, DischargeOvercurrent=0)
    well = bench.frame(BATTERY, since, lambda data: data[5] == 0).t
    bench.until(well + 2.1)
    ticks = [f for f in bench.commands(well) if f.can_id == wire.PCU1_COMMAND]
    earliest = next(f.t for f in ticks if f.t > well + 0.001)
    latest = next(f.t for f in ticks if f.t > well + GRACE_S)
    limited = [f for f in ticks if f.command.power_limit == 10000]
    back = [f for f in ticks if f.t > limited[-1].t]
    held_ms = (back[0].t - earliest) * 1000
    assert back[0].t - earliest >= 1.0 - JITTER_S, f"held {held_ms:.0f} ms"
    assert back[0].t - latest <= 1.050 + JITTER_S, f"held {held_ms:.0f} ms"
    powers = [f.command.power_limit for f in back]
    for before, after in pairwise([10000, *powers]):
        assert before < after <= before + 3001 or before == after == 60000, powers
    assert powers.index(60000) <= 20
    brakes = [f.command.brake for f in [*limited[-1:], *back]]
    for before, after in pairwise(brakes):
        assert before < after <= before + 14 or before == after == wire.percent(40), brakes
    assert brakes[8] == wire.percent(40)


def test_alarms_are_told_and_change_nothing(bench):
    drive(bench)
    before = bench.command()
    for signal, code in (
        ("TemperatureImbalance", 1), ("TemperatureImbalance", 2), ("TemperatureImbalance", 3),
        ("VoltageImbalance", 1), ("Overtemperature", 1),
    ):  # fmt: skip
        told = tell(bench, BATTERY, **{signal: code})
        bench.ticks(told + GRACE_S, 2)
        assert any(signal in c["subject"] for c in bench.why()["alarms"]), (signal, code)
        bench.vehicle.set(BATTERY, **{signal: 0})
    assert bench.command() == before


def test_without_tuning_heat_charge_voltage_and_a_spinning_wheel_change_nothing(bench):
    drive(bench)
    before = bench.command()
    since = time.monotonic()
    for message, values in (
        (LEFT, {"MotorTemperature": 255}), (RIGHT, {"ControllerTemperature": 151}),
        (BATTERY, {"SOC": 99}), (BATTERY, {"SOC": 1}), ("PCU2_Status2", {"BatteryVoltage": 1.0}),
        ("BMS_Temperatures", {"PackTemperature1": 90, "PackTemperature2": -40}),
        ("ARD2_SteeringWheel", {"WheelSpeedFL": 1.0, "WheelSpeedFR": 1.0}),
    ):  # fmt: skip
        bench.vehicle.set(message, **values)
        bench.rest(0.06)
    bench.speeds(2500, 1000)
    bench.rest(0.2)
    refused = bench.client.refusal("drive_mode.set", mode="sport")
    assert refused is not None
    assert refused.refusal == "no_such_mode"
    assert {f.command for f in bench.commands(since)} == {before}
    assert not bench.why()["limits"]


def test_a_message_at_its_bounds_of_silence_limits_then_stops(bench):
    drive(bench)
    bench.wait(lambda: time.monotonic() - bench.recorder.of(BATTERY)[-1].t < 0.1, "a frame")
    bench.vehicle.silence(BATTERY)
    bench.pump()
    last = bench.recorder.of(BATTERY)[-1].t
    bench.until(last + 1.75)
    ticks = bench.commands(last)
    unlimited = [f for f in ticks if f.command.power_limit == 60000]
    limited = [f for f in ticks if f not in unlimited and not bench.is_safe(f.command)]
    stopped = [f for f in ticks if bench.is_safe(f.command)]
    assert limited[0].t > last + 1.1 - 0.001
    assert unlimited[-1].t < last + 1.1 + GRACE_S
    before = next(f for f in reversed(unlimited) if f.can_id == limited[0].can_id)
    assert follows(before, limited[0], {"regen limit", "power limit"})
    assert stopped[0].t > last + 1.6 - 0.001
    assert limited[-1].t < last + 1.6 + GRACE_S
    assert {f.data for f in stopped} == {wire.ZERO_TORQUE}
    assert bench.why()["latch"]["fault_class"] == "driver"
