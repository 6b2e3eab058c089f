"""Tuning as values: by whole keys and back, what differs, and which change is the stricter one."""

import dataclasses

import pytest

from vcu_gateway.core import tuning
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.core.tuning import DERATINGS, INPUTS, DriveMode, SlipLimiter, Tuning

CHARGE = "power_limit_w.by_soc_pct"
LOW, HIGH = Curve(((5, 100), (20, 5000))), Curve(((5, 100), (20, 6000)))
ECO = DriveMode(
    by_pedal=Curve(((0, 0), (100, 80))), power_mode_max=PowerMode.NORMAL, power_limit_w=8000
)
WHOLE = Tuning({CHARGE: LOW}, "eco", {"eco": ECO, "sport": DriveMode()}, SlipLimiter(), 85.3)


def test_the_values_by_whole_keys_give_it_again():
    values = tuning.values(WHOLE)
    assert values["curves.power_limit_w.by_soc_pct"] == LOW
    assert values["drive_modes.modes.eco.throttle_pct.by_pedal_pct"] == ECO.by_pedal
    assert values["laws.slip.wait_ms"] == 250
    assert tuning.of_values(values) == WHOLE
    assert tuning.of_values({}) == Tuning()


def test_lists_of_points_and_names_of_power_modes_are_taken():
    given = {
        "curves.power_limit_w.by_soc_pct": [[5, 100], [20, 5000]],
        "drive_modes.start": "eco",
        "drive_modes.modes.eco.power_mode_max": "normal",
        "drive_modes.modes.eco.throttle_pct.by_pedal_pct": [[0, 0], [100, 80]],
        "drive_modes.modes.eco.power_limit_w": 8000,
        "drive_modes.modes.eco.speed_limit_kmh": None,
    }
    assert tuning.of_values(given) == Tuning({CHARGE: LOW}, "eco", {"eco": ECO})


@pytest.mark.parametrize("key", ["curves.power_limit_w.by_luck", "laws.yaw.gain", "limits.x"])
def test_a_key_that_there_is_not_is_refused(key):
    with pytest.raises(KeyError):
        tuning.of_values({key: 1})


def test_what_differs_has_its_whole_key():
    assert tuning.changed(WHOLE, WHOLE) == ()
    other = dataclasses.replace(
        WHOLE,
        curves={},
        start="sport",
        modes=dict(WHOLE.modes, eco=dataclasses.replace(ECO, brake_max_pct=30)),
        slip=None,
    )
    assert set(tuning.changed(WHOLE, other)) == {
        "curves.power_limit_w.by_soc_pct",
        "drive_modes.start",
        "drive_modes.modes.eco.brake_max_pct",
        *(f"laws.slip.{one.name}" for one in dataclasses.fields(SlipLimiter)),
    }


@pytest.mark.parametrize(
    ("before", "after", "stricter"),
    [
        ({}, {CHARGE: LOW}, True),
        ({CHARGE: HIGH}, {CHARGE: LOW}, True),
        ({CHARGE: LOW}, {CHARGE: HIGH}, False),
        ({CHARGE: LOW}, {}, False),
    ],
)
def test_a_curve_that_is_new_or_nowhere_above_is_the_stricter_one(before, after, stricter):
    key = DERATINGS[CHARGE].key
    assert tuning.is_stricter(key, Tuning(before), Tuning(after)) is stricter
    assert not tuning.is_stricter("drive_modes.modes.eco.power_limit_w", Tuning(), WHOLE)


@pytest.mark.parametrize(
    ("one", "acts"),
    [
        (Tuning(), False),
        (Tuning(motor_rpm_per_kmh=85), False),
        (Tuning({CHARGE: LOW}), True),
        (Tuning(start="eco", modes={"eco": ECO}), True),
        (Tuning(slip=SlipLimiter()), True),
    ],
)
def test_it_acts_where_a_curve_a_mode_or_the_slip_limiter_is_configured(one, acts):
    assert one.acts is acts


def test_throttles_may_differ_for_the_slip_limiter_alone():
    assert WHOLE.asymmetry_max_pct == 20
    assert Tuning().asymmetry_max_pct == 0


def test_every_input_has_curves_and_every_example_its_direction():
    assert {one.input.quantity.key for one in DERATINGS.values()} == set(INPUTS)
    for one in DERATINGS.values():
        ys = [y for _, y in one.example]
        assert ys == sorted(ys, reverse=not one.rises), one.key
