"""Tuning in closed loop: core and simulated vehicle in virtual time, and the tables of figures.

usage: python -m tests.simulator.tuning, the tables of docs/tuning.md as Markdown.
"""

import itertools
import statistics
import sys
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from tests.simulator.driving import drive, signals
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.tuning import DriveMode, SlipLimiter, Tuning
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.scenario import Scenario, ScenarioStart
from vcu_gateway.simulator.vehicle import LEFT, RIGHT, Vehicle

RPM_PER_KMH = 85.3
_KMH_PER_M_S = 3.6
_BEGIN_S, _END_S = 6.0, 15.0  # armed long before; 9 s under throttle
_SETTLED_AFTER_S = 4
_NEAR_TOP_KMH = 55.0  # from about here on the motors' own top speed takes the torque away
_TRACK_M = 1.1
BY_VOLTAGE = "power_limit_w.by_battery_voltage_v"
SLOW_W_PER_S, QUICK_W_PER_S = 1_000.0, 60_000.0
"""The default of limits.power_return_w_per_s, and its highest value."""

Roads = Mapping[str, float]
"""Friction below each driven wheel, by its controller."""


class Sample(NamedTuple):
    """One tick, s after the throttle was pressed."""

    at_s: float
    throttles_pct: tuple[float, float]
    power_limit_w: float
    front_kmh: float
    slip_kmh: float
    acceleration_m_s2: float
    voltage_v: float
    yaw_nm: float


def driven(
    tuning: Tuning,
    roads: Roads | None = None,
    *,
    throttle_pct: float = 100.0,
    patch: tuple[float, float, float] | None = None,
    power_return_w_per_s: float = SLOW_W_PER_S,
    ramps: Mapping[str, float] = MappingProxyType({}),
    **start: float,
) -> Sequence[Sample]:
    """Nine seconds under throttle from standstill, tick by tick.

    `patch`: from and until which second both wheels are on this friction instead. `ramps`: other
    settings. `start`: keys of a scenario's start.
    """
    codec, seen = CODEC, []

    def asked(at_s: float) -> ControllerDemand:
        pressed = throttle_pct if at_s >= _BEGIN_S else 0.0
        return ControllerDemand(throttle_pct=pressed, power_mode=PowerMode.TURBO)

    def watch(at_s: float, vehicle: Vehicle) -> None:
        if roads is not None:
            for name, friction in roads.items():
                vehicle.slip_on([name], friction)
        if patch is not None and patch[0] <= at_s - _BEGIN_S < patch[1]:
            vehicle.slip_on([LEFT, RIGHT], patch[2])
        seen.append(_seen(vehicle))

    scenario = Scenario(ScenarioStart(**start), ())
    settings = {"tuning": tuning, "power_return_w_per_s": power_return_w_per_s, **ramps}
    done = drive(codec, scenario, _END_S, asked, watch, **settings)
    samples = []
    for ticked, physical in zip(done.ticks, seen, strict=True):
        commands = [signals(codec, frame) for frame in ticked.frames]
        if len(commands) == 2 and ticked.at_s >= _BEGIN_S:
            first, second = commands
            throttles_pct = first["Throttle"], second["Throttle"]
            at_s = ticked.at_s - _BEGIN_S
            samples.append(Sample(at_s, throttles_pct, first["PowerLimit"], *physical))
    return samples


def _seen(vehicle: Vehicle) -> tuple[float, float, float, float, float]:
    front_m_s = max(vehicle.left_speed_m_s, vehicle.right_speed_m_s)
    turning_m_s = max(
        front_m_s if wheel.friction is None else wheel.speed_m_s
        for wheel in vehicle.wheels.values()
    )
    left_n, right_n = (vehicle.wheels[name].force_n for name in (LEFT, RIGHT))
    return (
        front_m_s * _KMH_PER_M_S,
        (turning_m_s - front_m_s) * _KMH_PER_M_S,
        vehicle.acceleration_m_s2,
        vehicle.battery.voltage_v,
        abs(right_n - left_n) * _TRACK_M / 2,
    )


CODEC = Codec(dbc.load(packaged("vcu.dbc")))


class Spin(NamedTuple):
    """What the throttle did from the third to the eighth second, and how far the wheels spun."""

    throttle_mean_pct: float
    throttle_peak_to_peak_pct: float
    slip_mean_kmh: float
    slip_max_kmh: float
    spun_s: float
    at_20_kmh_s: float | None
    yaw_nm: float
    cut: bool


def spin_of(samples: Sequence[Sample], demanded_pct: float = 100.0) -> Spin:
    settled = [one for one in samples if 3 <= one.at_s < 8]
    throttles_pct = [min(one.throttles_pct) for one in settled]
    return Spin(
        statistics.mean(throttles_pct),
        max(throttles_pct) - min(throttles_pct),
        statistics.mean(one.slip_kmh for one in settled),
        max(one.slip_kmh for one in samples),
        sum(0.05 for one in samples if one.slip_kmh > 10),
        next((one.at_s for one in samples if one.front_kmh >= 20), None),
        statistics.mean(one.yaw_nm for one in settled),
        any(
            after < before
            for pair in itertools.pairwise(samples)
            for before, after in zip(pair[0].throttles_pct, pair[1].throttles_pct, strict=True)
        ),
    )


def slip(cut_share_pct: float = 50, return_pct_per_s: float = 10, apart_pct: float = 20) -> Tuning:
    limiter = SlipLimiter(
        cut_share_pct=cut_share_pct,
        return_pct_per_s=return_pct_per_s,
        asymmetry_max_pct=apart_pct,
    )
    return Tuning(slip=limiter, motor_rpm_per_kmh=RPM_PER_KMH)


def mapped(most_pct: float) -> Tuning:
    by_pedal = Curve(((0.0, 0.0), (100.0, most_pct)))
    return Tuning(start="wet", modes={"wet": DriveMode(by_pedal=by_pedal)})


def voltage(points: Sequence[tuple[float, float]]) -> Tuning:
    return Tuning(curves={BY_VOLTAGE: Curve(tuple(points))})


class Sag(NamedTuple):
    """A pack under full throttle; changes are the largest of acceleration in a tick.

    Attributes:
        bites_m_s2: until the fourth second, in which the throttle rises and the curve bites.
        settled_m_s2, power_peak_to_peak_w: from then on, below the top speed.
    """

    bites_m_s2: float
    settled_m_s2: float
    power_peak_to_peak_w: float
    lowest_v: float


def sag_of(samples: Sequence[Sample]) -> Sag:
    below_top = itertools.takewhile(lambda one: one.front_kmh < _NEAR_TOP_KMH, samples)
    settled = [one for one in below_top if one.at_s >= _SETTLED_AFTER_S]
    powers_w = [one.power_limit_w for one in settled]
    return Sag(
        _jerk_m_s2([one for one in samples if one.at_s < _SETTLED_AFTER_S]),
        _jerk_m_s2(settled),
        max(powers_w) - min(powers_w),
        min(one.voltage_v for one in samples),
    )


def _jerk_m_s2(samples: Sequence[Sample]) -> float:
    return max(
        abs(after.acceleration_m_s2 - before.acceleration_m_s2)
        for before, after in itertools.pairwise(samples)
    )


def _spin_row(name: str, samples: Sequence[Sample]) -> str:
    one = spin_of(samples)
    at_20_s = "-" if one.at_20_kmh_s is None else f"{one.at_20_kmh_s:.2f} s"
    return (
        f"| {name} | {one.throttle_mean_pct:.0f} % | {one.throttle_peak_to_peak_pct:.0f} % "
        f"| {one.slip_mean_kmh:.1f} / {one.slip_max_kmh:.0f} | {one.spun_s:.1f} s | {at_20_s} "
        f"| {one.yaw_nm:.0f} Nm |"
    )


def _sag_row(
    ohm: float,
    soc_pct: float,
    w_per_v: float,
    return_w_per_s: float,
    ramps: Mapping[str, float] = MappingProxyType({}),
) -> str:
    one = sag_of(
        driven(
            voltage([(60, 0), (60 + 12_000 / w_per_v, 12_000)]),
            _DRY,
            power_return_w_per_s=return_w_per_s,
            ramps=ramps,
            soc_pct=soc_pct,
            battery_resistance_ohm=ohm,
        )
    )
    other = "".join(f", `{name}: {value}`" for name, value in ramps.items())
    return (
        f"| {ohm} Ω, {soc_pct} % | {w_per_v} W/V, {return_w_per_s / 1000:.0f} kW/s{other} "
        f"| {one.bites_m_s2:.2f} m/s² | {one.settled_m_s2:.2f} m/s² "
        f"| ± {one.power_peak_to_peak_w / 2000:.1f} kW | {one.lowest_v:.0f} V |"
    )


_LAWS: Mapping[str, Tuning] = {
    "off": Tuning(),
    "cut 50 %, wait 250 ms, return 20": slip(return_pct_per_s=20),
    "cut 50 %, wait 250 ms, return 10": slip(),
    "no law, map of 30 %": mapped(30),
}
_SPLIT = {LEFT: 0.9, RIGHT: 0.15}
_DRY = dict.fromkeys((LEFT, RIGHT), 0.9)


def tables() -> Sequence[str]:
    """Lines of both tables, as docs/tuning.md has them."""
    lines = [
        (
            "| road, throttle, law | throttle mean | peak to peak | slip mean / max, km/h "
            "| spin > 10 km/h | 20 km/h after | yaw moment |"
        ),
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for friction in (0.3, 0.15, 0.9):
        road = dict.fromkeys((LEFT, RIGHT), friction)
        for name, law in _LAWS.items():
            lines.append(_spin_row(f"friction {friction}, full, {name}", driven(law, road)))
    for name, law in {
        "off": Tuning(),
        **{f"asymmetry {apart} %": slip(apart_pct=apart) for apart in (0, 20, 100)},
    }.items():
        samples = driven(law, _SPLIT, throttle_pct=60)
        lines.append(_spin_row(f"left 0.9, right 0.15, 60 %, {name}", samples))
    for name, law in list(_LAWS.items())[:3]:
        samples = driven(law, _DRY, patch=(2.0, 3.5, 0.1))
        lines.append(_spin_row(f"ice for 1.5 s, full, {name}", samples))
    lines += [
        "",
        "| pack, charge | curve, return | tick in which it bites | settled | PowerLimit | lowest |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for ohm, soc_pct in ((0.02, 30), (0.05, 16), (0.05, 30), (0.05, 40), (0.08, 30)):
        for w_per_v in (2000, 2500, 4000, 12_000):
            lines.append(_sag_row(ohm, soc_pct, w_per_v, SLOW_W_PER_S))
    lines += [_sag_row(ohm, 30, 2000, QUICK_W_PER_S) for ohm in (0.02, 0.05)]
    for ramps in ({"power_slew_w_per_s": 6000}, {"throttle_slew_pct_per_s": 20}):
        lines.append(_sag_row(0.05, 30, 2500, SLOW_W_PER_S, ramps))
    return lines


if __name__ == "__main__":
    sys.stdout.write("\n".join(tables()) + "\n")
