"""Regeneration by speed, at its limits and one bit beyond."""

import math

import pytest

from vcu_gateway.core.regeneration import RegenerationInterlock


def possible(*speeds_rpm, min_rpm=100.0):
    regeneration = RegenerationInterlock()
    return [regeneration.possible(speeds, min_rpm) for speeds in speeds_rpm]


@pytest.mark.parametrize("other", [150.0, 6000.0])
def test_it_begins_50_rpm_above_and_ends_below_the_least_speed(other):
    speeds = (149.999, 150.0, 100.0, math.nextafter(100, 0), 149.999, 150.0)
    expected = [False, True, True, False, False, True]
    assert possible(*((speed, other) for speed in speeds)) == expected
    assert possible(*((other, speed) for speed in speeds)) == expected


@pytest.mark.parametrize("unknown", [(None, 200.0), (200.0, None), (None, None)])
def test_a_speed_that_is_not_known_ends_it(unknown):
    assert possible(unknown, (200.0, 200.0), unknown, (120.0, 120.0)) == [False, True, False, False]


def test_a_least_speed_of_zero_switches_it_off():
    assert possible((None, None), (0.0, 0.0), min_rpm=0) == [True, True]
