"""docs/pictures/tuning.svg: every curve of config/examples/tuning.yaml, drawn from the file."""

import re
from collections.abc import Iterator
from pathlib import Path

from vcu_gateway import config
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.tuning import DERATINGS, LIMITS, Tuning
from vcu_gateway.export.curve_figure import CurveFigure

_COLUMNS = 3
_WIDTH, _HEIGHT = 380, 190
_STYLE = (
    "text{font:11px sans-serif;fill:#57606a}.title{fill:#1f2328;font-size:12px}"
    "polyline{fill:none;stroke:#0969da;stroke-width:2}rect{fill:#fff}"
)


def svg(example: Path) -> str:
    """The picture, in a grid; modes after curves."""
    figures = list(_figures(config.core_settings(config.load(example)).tuning))
    rows = -(-len(figures) // _COLUMNS)
    width, height = _COLUMNS * _WIDTH, rows * _HEIGHT
    cells = [
        re.sub(
            "^<svg ",
            f"<svg x='{index % _COLUMNS * _WIDTH + 10}' y='{index // _COLUMNS * _HEIGHT + 10}'"
            f" width='{_WIDTH - 20}' height='{_HEIGHT - 20}' ",
            one.svg(),
        )
        for index, one in enumerate(figures)
    ]
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}'>"
        f"<style>{_STYLE}</style><rect width='{width}' height='{height}'/>\n"
        + "\n".join(cells)
        + "\n</svg>\n"
    )


def _figures(tuning: Tuning) -> Iterator[CurveFigure]:
    for name, curve in tuning.curves.items():
        one = DERATINGS[name]
        units = one.input.quantity.unit, LIMITS[one.limit].unit
        yield CurveFigure(name, *units, (), curve.points)
    for name, mode in tuning.modes.items():
        curves: dict[str, tuple[Curve | None, str, str]] = {
            "pedal": (mode.by_pedal, "%", "%"),
            "throttle over speed": (mode.by_speed, "km/h", "%"),
            "rise over speed": (mode.rise_by_speed, "km/h", "%/s"),
        }
        for what, (own, x_unit, y_unit) in curves.items():
            if own is not None:
                yield CurveFigure(f"{name}: {what}", x_unit, y_unit, (), own.points)
