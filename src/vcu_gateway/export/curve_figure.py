"""Figure of a curve: its line, another one beside it, and how long a drive was at each place."""

import html
from collections.abc import Sequence
from typing import NamedTuple

Points = Sequence[tuple[float, float]]

_WIDTH, _HEIGHT = 360, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 8, 8, 18, 34


class CurveFigure(NamedTuple):
    """What a figure shows.

    Attributes:
        x_unit, y_unit: units of both axes.
        before, after: points of both curves; empty where there is none, alike where one is shown.
        seconds_at: seconds at each value of x; empty without a drive.
    """

    title: str
    x_unit: str
    y_unit: str
    before: Points
    after: Points
    seconds_at: Points = ()

    def svg(self) -> str:
        """SVG with the classes before, after and used, for a style sheet to colour."""
        scale = _Scale.of(self)
        lines = []
        if self.before and list(self.before) != list(self.after):
            lines.append(scale.line(self.before, "before"))
        if self.after:
            lines.append(scale.line(self.after, "after"))
        labels = [
            _label(_LEFT, 12, self.title, "title"),
            _label(_LEFT, _HEIGHT - 4, f"{scale.first:g} {self.x_unit}"),
            _label(_WIDTH - _RIGHT, _HEIGHT - 4, f"{scale.last:g} {self.x_unit}", "end"),
            _label(_WIDTH - _RIGHT, 12, f"{scale.top:g} {self.y_unit}", "end"),
        ]
        used = scale.bars(self.seconds_at)
        return (
            f"<svg class='curve' viewBox='0 0 {_WIDTH} {_HEIGHT}' role='img'"
            f" aria-label='{html.escape(self.title)}'>{used}{''.join(lines)}{''.join(labels)}</svg>"
        )


class _Scale(NamedTuple):
    """Lowest and highest x that is shown, and the highest y; the lowest is 0."""

    first: float
    last: float
    top: float

    @property
    def margin(self) -> float:
        """Width in x of the level ends on both sides."""
        return (self.last - self.first) / 20 or 1.0

    @classmethod
    def of(cls, figure: CurveFigure) -> "_Scale":
        points = [*figure.before, *figure.after]
        xs = [x for x, _ in (*points, *figure.seconds_at)] or [0.0]
        return cls(min(xs), max(xs), max((y for _, y in points), default=1.0) or 1.0)

    def at(self, x: float, y: float) -> str:
        share = (x - self.first + self.margin) / (self.last - self.first + 2 * self.margin)
        across = share * (_WIDTH - _LEFT - _RIGHT) + _LEFT
        up = _HEIGHT - _BOTTOM - y / self.top * (_HEIGHT - _TOP - _BOTTOM)
        return f"{across:.1f},{up:.1f}"

    def line(self, points: Points, kind: str) -> str:
        """Level beyond its ends, as the curve is."""
        left, right = self.first - self.margin, self.last + self.margin
        ends = (left, points[0][1]), *points, (right, points[-1][1])
        places = " ".join(self.at(x, y) for x, y in ends)
        return f"<polyline class='{kind}' points='{places}'/>"

    def bars(self, seconds_at: Points) -> str:
        """A bar below the axis for each place, darker where the drive was longer."""
        longest_s = max((seconds for _, seconds in seconds_at), default=0.0)
        drawn = []
        for x, seconds in seconds_at if longest_s else ():
            across, _ = self.at(x, 0).split(",")
            share = max(0.1, seconds / longest_s)
            drawn.append(
                f"<rect class='used' x='{float(across) - 1.5:.1f}' y='{_HEIGHT - _BOTTOM + 3}'"
                f" width='3' height='12' opacity='{share:.2f}'>"
                f"<title>{x:g}: {seconds:.1f} s</title></rect>"
            )
        return "".join(drawn)


def _label(x: float, y: float, text: str, kind: str = "") -> str:
    anchor = " text-anchor='end'" if kind == "end" else ""
    return f"<text class='label {kind}' x='{x}' y='{y}'{anchor}>{html.escape(text)}</text>"
