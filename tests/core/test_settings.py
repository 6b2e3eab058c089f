"""Settings: the defaults of docs/safety.md, and which change is the stricter one."""

import dataclasses
from typing import Any

import pytest

from vcu_gateway.core.can_pedals import CanPedals, PedalTrack
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.settings import REQUIRED_MESSAGES, RESTART_ONLY, Settings, changed, loosened

STRICTER_AND_LOOSER = {
    "speed_limit_max_rpm": (11_999, 12_001),
    "power_limit_max_w": (59_999, 60_001),
    "derated_power_w": (9_999, 10_001),
    "regen_limit_pct": (19.9, 20.1),
    "throttle_slew_pct_per_s": (99.9, 100.1),
    "direction_change_rpm": (49.9, 50.1),
    "ttl_max_ms": (999, 1001),
    "ttl_default_ms": (50, 500),
    "clear_hold_ms": (1001, 999),
    "regen_min_rpm": (101, 0),
}

OTHER_VALUES = {
    "late_after_ms": {"BMS_Status": 1000},
    "stale_after_ms": {"BMS_Status": 1000},
    "transmit_priority": 3,
    "required_messages": [*REQUIRED_MESSAGES, "IMU_Attitude"],
    "period_ns": 20_000_000,
    "listen_before_talk_ms": 2000,
    "qualify_frames": 4,
    "echo_below_max_pct": 14.9,
    "motor_speed_step_max_rpm": 1_999.0,
    "wheel_speed_step_max_kmh": 19.9,
    "wheel_speed_difference_max_kmh": 14.9,
    "power_slew_w_per_s": 50_000.0,
    "regen_slew_pct_per_s": 50.0,
    "speed_slew_rpm_per_s": 3_000.0,
    "power_return_w_per_s": 500.0,
    "brake_return_pct_per_s": 10.0,
    "speed_fall_rpm_per_s": 400.0,
    "speed_return_rpm_per_s": 500.0,
    "independent_directions": True,
    "second_track_required": True,
    "priorities": {"driver": 1},
    "bench_demand": ControllerDemand(),
    "auto_arm": True,
    "pedals": CanPedals(message="Pedals", throttle=PedalTrack("Throttle", 0, 1)),
}


def test_the_defaults_are_safety_mds():
    assert dataclasses.asdict(Settings()) == {
        "late_after_ms": {},
        "stale_after_ms": {},
        "transmit_priority": 0,
        "required_messages": ("BMS_Status", "PCU1_Status2", "PCU2_Status2"),
        "period_ns": 50_000_000,
        "listen_before_talk_ms": 1000,
        "qualify_frames": 3,
        "clear_hold_ms": 1000,
        "speed_limit_max_rpm": 12_000.0,
        "power_limit_max_w": 60_000.0,
        "derated_power_w": 10_000.0,
        "regen_limit_pct": 20.0,
        "throttle_slew_pct_per_s": 100.0,
        "power_slew_w_per_s": 60_000.0,
        "regen_slew_pct_per_s": 100.0,
        "speed_slew_rpm_per_s": 4_000.0,
        "power_return_w_per_s": 1_000.0,
        "brake_return_pct_per_s": 20.0,
        "speed_fall_rpm_per_s": 500.0,
        "speed_return_rpm_per_s": 1_000.0,
        "tuning": {
            "curves": {},
            "start": None,
            "modes": {},
            "slip": None,
            "motor_rpm_per_kmh": None,
            "mode_limits": {},
        },
        "pedals": None,
        "direction_change_rpm": 50.0,
        "regen_min_rpm": 100.0,
        "echo_below_max_pct": 15.0,
        "motor_speed_step_max_rpm": 2_000.0,
        "wheel_speed_step_max_kmh": 20.0,
        "wheel_speed_difference_max_kmh": 15.0,
        "ttl_max_ms": 1000,
        "ttl_default_ms": 200,
        "priorities": {},
        "independent_directions": False,
        "second_track_required": False,
        "bench_demand": None,
        "auto_arm": False,
    }


def test_every_setting_is_judged_here():
    names = {field.name for field in dataclasses.fields(Settings)}
    assert names == {*STRICTER_AND_LOOSER, *OTHER_VALUES, "tuning"}


def with_setting(settings: Settings, name: str, value: Any) -> Settings:
    return dataclasses.replace(settings, **{name: value})


@pytest.mark.parametrize("name", STRICTER_AND_LOOSER)
def test_a_limit_changes_freely_towards_the_stricter_side_only(name):
    stricter, looser = STRICTER_AND_LOOSER[name]
    before = Settings()
    assert loosened(before, with_setting(before, name, stricter)) == ()
    assert loosened(before, with_setting(before, name, looser)) == (name,)


@pytest.mark.parametrize("name", OTHER_VALUES)
def test_whatever_has_no_stricter_side_must_stay(name):
    before = Settings()
    assert loosened(before, with_setting(before, name, OTHER_VALUES[name])) == (name,)


def test_nothing_changed_is_nothing_loosened():
    assert changed(Settings(), Settings()) == ()
    assert loosened(Settings(), Settings()) == ()


def test_changed_names_what_differs_in_the_order_of_the_settings():
    after = dataclasses.replace(Settings(), auto_arm=True, clear_hold_ms=1001, required_messages=())
    assert changed(Settings(), after) == ("required_messages", "clear_hold_ms", "auto_arm")


def test_every_name_that_is_loosened_is_told():
    after = dataclasses.replace(Settings(), clear_hold_ms=1, power_limit_max_w=1, ttl_max_ms=2000)
    assert loosened(Settings(), after) == ("clear_hold_ms", "ttl_max_ms")


def test_what_is_read_once_at_the_start_needs_a_restart():
    assert set(RESTART_ONLY) == {
        "late_after_ms",
        "stale_after_ms",
        "transmit_priority",
        "period_ns",
        "listen_before_talk_ms",
        "echo_below_max_pct",
        "motor_speed_step_max_rpm",
        "wheel_speed_step_max_kmh",
        "wheel_speed_difference_max_kmh",
        "bench_demand",
        "auto_arm",
        "pedals",
        "drive_modes.start",
    }
