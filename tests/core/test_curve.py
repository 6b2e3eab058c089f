"""Curves: linear between their points, level beyond, compared at the points of both."""

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.core.curve import Curve

FALLING = Curve(((95.0, 14000.0), (110.0, 6000.0), (125.0, 0.0)))
RISING = Curve(((3.0, 1500.0), (10.0, 5000.0), (25.0, 14000.0)))


# Between these two points the sum of floats is not exactly the second one's.
INEXACT = (
    Curve(((0.0, 86.0), (1.0, 23.2), (2.0, 0.0))),
    Curve(((0.0, 17.3), (1.0, 54.9), (2.0, 60.0))),
)


@pytest.mark.parametrize("curve", [FALLING, RISING, *INEXACT])
def test_a_point_is_hit_exactly(curve):
    assert [curve.at(x) for x, _ in curve.points] == [y for _, y in curve.points]


@pytest.mark.parametrize(
    ("x", "y"), [(-50, 14000), (94.9, 14000), (102.5, 10000), (117.5, 3000), (125.1, 0), (255, 0)]
)
def test_between_its_points_it_is_linear_and_level_beyond(x, y):
    assert FALLING.at(x) == pytest.approx(y, abs=1e-9)


@pytest.mark.parametrize(
    "points",
    [
        ((-7.0, 53.3), (3.0, 10.19)),  # the sum of floats is 10.189999999999998
        ((-36.0, 8.45), (-6.0, 45.4)),  # and 45.400000000000006
    ],
)
def test_just_before_a_point_it_is_not_beyond_it(points):
    curve = Curve(points)
    assert curve.at(math.nextafter(points[1][0], -math.inf)) == points[1][1]


def test_lowest_and_highest_are_those_of_its_points():
    assert (FALLING.lowest, FALLING.highest) == (0, 14000)
    assert (RISING.lowest, RISING.highest) == (1500, 14000)


numbers = st.floats(0, 1000, allow_nan=False)


@st.composite
def curves(draw, rises=None):
    xs = sorted(draw(st.sets(st.integers(0, 255), min_size=2, max_size=16)))
    ys = draw(st.lists(numbers, min_size=len(xs), max_size=len(xs)))
    if rises is not None:
        ys = sorted(ys, reverse=not rises)
    return Curve(tuple((float(x), y) for x, y in zip(xs, ys, strict=True)))


@given(curves(rises=True), numbers, numbers)
def test_a_curve_that_never_falls_gives_more_for_more(curve, one, other):
    assert curve.at(min(one, other)) <= curve.at(max(one, other))


@given(curves(), numbers)
def test_it_never_leaves_the_range_of_its_points(curve, x):
    assert curve.lowest <= curve.at(x) <= curve.highest


@given(curves(), curves())
def test_nowhere_above_is_what_any_x_says(one, other):
    places = [random.Random(0).uniform(-10, 270) for _ in range(200)]
    if one.nowhere_above(other):
        assert all(one.at(x) <= other.at(x) + 1e-9 for x in places)
    else:
        above = [x for x, _ in (*one.points, *other.points) if one.at(x) > other.at(x)]
        assert above


def test_a_curve_is_nowhere_above_itself_and_above_one_that_is_lower_at_one_point():
    lower = Curve((*FALLING.points[:1], (110.0, 5999.0), *FALLING.points[2:]))
    assert FALLING.nowhere_above(FALLING)
    assert lower.nowhere_above(FALLING)
    assert not FALLING.nowhere_above(lower)
