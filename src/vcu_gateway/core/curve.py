"""Curves: a limit over one quantity, linear between its points and level beyond them."""

import math
from bisect import bisect_right
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Curve:
    """Points (x, y) in order of x, two at least.

    The configuration has checked them; units are those of the curve's key.
    """

    points: tuple[tuple[float, float], ...]

    def at(self, x: float) -> float:
        """The limit at x: a point's own y exactly, and never beyond the y of its neighbours."""
        points = self.points
        after = bisect_right(points, (x, math.inf))
        if after == 0:
            return points[0][1]
        if after == len(points):
            return points[-1][1]
        (left, y), (next_x, next_y) = points[after - 1 : after + 1]
        between = y + (next_y - y) * ((x - left) / (next_x - left))
        lowest, highest = (y, next_y) if y < next_y else (next_y, y)
        return lowest if between < lowest else min(between, highest)

    @property
    def lowest(self) -> float:
        """The smallest limit that it gives."""
        return min(y for _, y in self.points)

    @property
    def highest(self) -> float:
        """The largest limit that it gives."""
        return max(y for _, y in self.points)

    def nowhere_above(self, other: "Curve") -> bool:
        """True where it limits at every x at least as much as another one.

        Both are linear between their points, so the points of both decide.
        """
        places = [x for x, _ in (*self.points, *other.points)]
        return all(self.at(x) <= other.at(x) for x in places)
