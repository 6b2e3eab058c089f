"""A gateway with every kind of tuning in its configuration, and its curves by hand."""

import time
from itertools import pairwise
from typing import Any

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench
from tests.oracle.watching import TICK_S, of_pcu1, on_ramp

# By field, as the frame has it: 0.39 % a step of Throttle and Brake.
SLEW_PER_S = {
    "power_limit": 60000,
    "speed_limit": 4000,
    "throttle": 100 / 0.39,
    "brake": 100 / 0.39,
}
RETURN_PER_S = {"power_limit": 30000, "speed_limit": 3000, "brake": 50 / 0.39}
SPEED_FALL_RPM_S = 2000
RPM_MAX, RPM_PER_KMH = 2000, 50
DERATED_W, REGEN_LIMIT_PCT, STALE_S = 10000, 20, 0.7
SLIP_RETURN_PCT_S, ASYMMETRY_PCT = 50, 20
# Each is at its highest at the healthy vehicle's value.
MOTOR_C = [[80, 60000], [100, 20000]]
CONTROLLER_C = [[60, 60000], [80, 6000], [90, 0]]
HOTTEST_PACK_C, COLDEST_PACK_C = [[40, 60000], [60, 20000]], [[-10, 12000], [10, 60000]]
VOLTS, SOC = [[40, 30000], [52, 60000]], [[10, 5000], [40, 60000]]
BRAKE_SOC, SPEED_SOC = [[80, 80], [90, 30], [95, 0]], [[20, 1000], [40, 2000]]
CITY = [[0, 0], [50, 20], [100, 60]]
RAIN, RAIN_RISE = [[0, 30], [40, 60], [65, 90]], [[0, 20], [40, 60], [60, 200]]
CITY_MODE = {
    "throttle_pct": {"by_pedal_pct": CITY}, "power_mode_max": "normal", "power_limit_w": 30000,
    "brake_max_pct": 30, "speed_limit_kmh": 30,
}  # fmt: skip
SECTIONS = {
    "vehicle": {"motor_rpm_per_kmh": RPM_PER_KMH},
    "freshness": {"stale_after_ms": {"BMS_Temperatures": round(STALE_S * 1000)}},
    "limits": {
        "speed_limit_max_rpm": RPM_MAX, "speed_fall_rpm_per_s": SPEED_FALL_RPM_S,
        "power_return_w_per_s": RETURN_PER_S["power_limit"], "brake_return_pct_per_s": 50,
        "speed_return_rpm_per_s": RETURN_PER_S["speed_limit"],
    },
    "curves": {
        "power_limit_w": {
            "by_motor_temperature_c": MOTOR_C, "by_controller_temperature_c": CONTROLLER_C,
            "by_pack_temperature_max_c": HOTTEST_PACK_C, "by_soc_pct": SOC,
            "by_pack_temperature_min_c": COLDEST_PACK_C, "by_battery_voltage_v": VOLTS,
        },
        "brake_pct": {"by_soc_pct": BRAKE_SOC},
        "speed_limit_rpm": {"by_soc_pct": SPEED_SOC},
    },
    "drive_modes": {
        "start": "plain",
        "modes": {
            "plain": {}, "city": CITY_MODE, "pit": {"speed_limit_kmh": 10},
            "rain": {
                "throttle_pct": {"by_speed_kmh": RAIN},
                "throttle_rise_pct_per_s": {"by_speed_kmh": RAIN_RISE},
            },
            "valet": {"left_by_service": True},
        },
    },
    "laws": {
        "slip": {"allowed_pct": 25, "cut_share_pct": 40, "return_pct_per_s": SLIP_RETURN_PCT_S}
    },
}  # fmt: skip


def at(points: list[list[int]], x: float) -> float:
    """A curve: linear between its points, level beyond them."""
    (x0, y0), *others = points
    if x <= x0:
        return y0
    for x1, y1 in others:
        if x <= x1:
            return y0 + (y1 - y0) * (x - x0) / (x1 - x0)
        x0, y0 = x1, y1
    return y0


def tell(bench: Bench, message: str, **values: Any) -> float:
    """Change signals; the stamp of the first frame that says so."""
    since = time.monotonic()
    bench.vehicle.set(message, **values)
    return bench.frame(message, since).t


def ask(bench: Bench, mode: str) -> float:
    """Another drive mode; when it was granted."""
    bench.client.call("drive_mode.set", mode=mode)
    return time.monotonic()


def drive(bench: Bench, mode: str = "plain", **values: Any) -> None:
    """In ACTIVE in that mode, with what it lets through of this; nothing is on its way."""
    bench.drive(power_mode=values.get("power_mode", "eco"))
    granted = ask(bench, mode)
    bench.ticks(granted + GRACE_S, 1)
    bench.demand(**values)
    bench.rest(TICK_S + GRACE_S)

    def settled() -> bool:
        frames = of_pcu1(bench.commands(time.monotonic() - 4 * TICK_S))
        return len(frames) > 2 and len({f.data for f in frames}) == 1

    bench.wait(settled, f"{values} in {mode}", 4.0)


def wheels(bench: Bench, *speeds_kmh: float) -> None:
    """Both front wheels so fast, one speed after the other: a leap would be an alarm."""
    for kmh in speeds_kmh:
        bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFL=kmh, WheelSpeedFR=kmh)
    bench.rest(2 * TICK_S + GRACE_S)


def motors(bench: Bench, *speeds_rpm: int) -> None:
    """The same for both motors."""
    for rpm in speeds_rpm:
        bench.speeds(rpm)
        bench.rest(0.12)


def motor_speed(bench: Bench, message: str, since: float, rpm: int) -> float:
    """The stamp of the first Status2 that says so."""
    return bench.frame(message, since, lambda data: data[6:8] == rpm.to_bytes(2, "little")).t


def must_ramp(
    bench: Bench, told: float, field: str, target: float, per_s: float | None = None
) -> float:
    """Both come to the target, each tick along the ramp, from the first that began after `told`.

    The stamp of the first frame on it; without another rate it is the slew.
    """
    per_s = per_s or SLEW_PER_S[field]
    bench.wait(
        lambda: {getattr(f.command, field) for f in bench.recorder.commands[-2:]} == {target},
        f"{field} {target}", 4.0,
    )  # fmt: skip
    moved = []
    for can_id in wire.COMMANDS:
        sent = [f for f in bench.commands(told - 0.5) if f.can_id == can_id]
        first = sum(f.t < told for f in sent) - 1
        start = getattr(sent[first].command, field)
        for before, after in pairwise(sent[first:]):
            was, now = getattr(before.command, field), getattr(after.command, field)
            if not (after.t < told + GRACE_S and was == now == start):
                moved.append(after.t)
                late = f"{(after.t - told) * 1000:.0f} ms: {was} {now}"
                assert on_ramp(was, now, target, per_s, after.t - before.t), late
    return min(moved)


def stays(bench: Bench, for_s: float = 0.25, **fields: float) -> None:
    since = time.monotonic()
    bench.rest(for_s)
    for frame in bench.commands(since + GRACE_S):
        assert {field: getattr(frame.command, field) for field in fields} == fields
