"""The slip limiter and a curve over voltage in closed loop, with a simulated vehicle."""

import pytest

from tests.simulator.tuning import (
    QUICK_W_PER_S,
    SLOW_W_PER_S,
    Sag,
    driven,
    mapped,
    sag_of,
    slip,
    spin_of,
    voltage,
)
from vcu_gateway.core.tuning import Tuning
from vcu_gateway.simulator.vehicle import LEFT, RIGHT

WET, DRY = dict.fromkeys((LEFT, RIGHT), 0.3), dict.fromkeys((LEFT, RIGHT), 0.9)
SPLIT = {LEFT: 0.9, RIGHT: 0.15}
STEEPEST = [(60.0, 0.0), (64.8, 12_000.0)]  # 2500 W for each V


def test_the_slip_limiter_ends_a_long_spin_on_a_wet_road_and_does_not_hunt() -> None:
    off, on = spin_of(driven(Tuning(), WET)), spin_of(driven(slip(), WET))
    assert off.spun_s > 8
    assert on.spun_s <= 1.0
    assert on.throttle_peak_to_peak_pct <= 25


def test_a_pedal_map_prevents_the_spin_that_the_limiter_ends() -> None:
    limited, flat = spin_of(driven(slip(), WET)), spin_of(driven(mapped(30), WET))
    assert flat.spun_s == 0 < limited.spun_s
    assert flat.at_20_kmh_s is not None
    assert limited.at_20_kmh_s is not None
    assert flat.at_20_kmh_s < limited.at_20_kmh_s


def test_on_a_dry_road_the_slip_limiter_never_cuts() -> None:
    samples = driven(slip(), DRY)
    assert not spin_of(samples).cut
    assert samples == driven(Tuning(), DRY)


@pytest.mark.parametrize(("apart_pct", "share"), [(0, 0.2), (20, 0.65)])
def test_on_two_roads_the_slip_limiter_turns_the_vehicle_less_than_none(
    apart_pct: float, share: float
) -> None:
    off = spin_of(driven(Tuning(), SPLIT, throttle_pct=60))
    on = spin_of(driven(slip(apart_pct=apart_pct), SPLIT, throttle_pct=60))
    assert on.yaw_nm <= share * off.yaw_nm
    assert on.throttle_mean_pct > 10, "the gate stops a vehicle whose throttles drift apart"


def sag_of_a_weak_pack(soc_pct: float, power_return_w_per_s: float = SLOW_W_PER_S) -> Sag:
    return sag_of(
        driven(
            voltage(STEEPEST),
            DRY,
            power_return_w_per_s=power_return_w_per_s,
            soc_pct=soc_pct,
            battery_resistance_ohm=0.05,
        )
    )


@pytest.mark.parametrize("soc_pct", [30, 40])
def test_the_steepest_curve_over_voltage_settles_on_a_weak_pack(soc_pct: float) -> None:
    one = sag_of_a_weak_pack(soc_pct)
    assert one.settled_m_s2 <= 0.15
    assert one.lowest_v > 55


def test_power_over_voltage_hunts_where_it_returns_quickly_and_not_as_it_is_shipped() -> None:
    slow, quick = sag_of_a_weak_pack(30), sag_of_a_weak_pack(30, QUICK_W_PER_S)
    assert quick.power_peak_to_peak_w > 5_000 > 1_000 > slow.power_peak_to_peak_w
