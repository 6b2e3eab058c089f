"""Deadlines derive from the protocol's periods (docs/safety.md, Causes)."""

import dataclasses

import pytest

from vcu_gateway.core.state import Deadlines, deadlines

MS = 1_000_000


@pytest.mark.parametrize(
    ("message", "late_ms", "stale_ms"),
    [
        ("BMS_Status", 1100, 1600),
        ("BMS_Temperatures", 1100, 1600),
        ("PCU1_Status1", 1100, 1600),
        ("PCU2_Status1", 1100, 1600),
        ("PCU1_Status2", 110, 200),
        ("PCU2_Status2", 110, 200),
        ("IMU_Acceleration", 22, 100),
        ("IMU_AngularRate", 22, 100),
        ("IMU_Attitude", 22, 100),
        ("ARD2_SteeringWheel", 220, 300),
    ],
)
def test_each_message_is_stale_after_what_the_safety_page_says(
    protocol, message, late_ms, stale_ms
):
    found = deadlines(protocol.message(message), {}, {})
    assert found == Deadlines(late_ms * MS, stale_ms * MS)


@pytest.mark.parametrize(("period_ms", "stale_ms"), [(499, 1497), (99, 396), (49, 490), (1, 10)])
def test_a_period_just_below_one_of_the_table_has_the_next_rows_deadline(
    protocol, period_ms, stale_ms
):
    message = dataclasses.replace(protocol.message("BMS_Status"), period_ms=period_ms)
    assert deadlines(message, {}, {}).stale_after_ns == stale_ms * MS


def test_the_configuration_overrides_by_name(protocol):
    message = protocol.message("BMS_Status")
    assert deadlines(message, {"BMS_Status": 900}, {"BMS_Status": 1200}) == Deadlines(
        900 * MS, 1200 * MS
    )
    assert deadlines(message, {"IMU_Attitude": 1}, {"IMU_Attitude": 1}) == Deadlines(
        1100 * MS, 1600 * MS
    )


def test_a_message_is_never_late_after_it_is_stale(protocol):
    message = protocol.message("BMS_Status")
    assert deadlines(message, {}, {"BMS_Status": 300}).late_after_ns == 300 * MS


def test_a_message_without_a_period_never_goes_stale(protocol):
    message = dataclasses.replace(protocol.message("BMS_Status"), period_ms=None)
    assert deadlines(message, {}, {}).stale_after_ns > 100 * 365 * 86400 * 1000 * MS
