"""Verbs of the tuning: the drive mode, and where the vehicle is on each curve."""

from collections.abc import Iterator
from pathlib import Path

import click

from vcu_gateway.api import results
from vcu_gateway.cli.operator import api_options, connected, show
from vcu_gateway.cli.options import level_option
from vcu_gateway.text import table

_NONE = "no curve, drive mode, slip limiter or pedal is configured; docs/tuning.md says how"


@click.command("tuning")
@api_options
def tuning(socket_path: Path | None, as_json: bool) -> None:
    """Show the drive mode and each curve: its input now, its limit now, whether that limits.

    A limit returns slowly while active, so it may be below what the curve says at its input.
    """
    with connected(socket_path) as client:
        found = client.tuning()
    show(found, as_json, lambda: "\n".join(_lines(found)))


def _lines(found: results.TuningNow) -> Iterator[str]:
    mode, slip_pct = found["drive_mode"], found["slip_throttle_max_pct"]
    pedals = found.get("pedals")
    if mode is None and slip_pct is None and pedals is None and not found["curves"]:
        yield _NONE
    if mode is not None:
        yield f"drive mode {_mode(mode)}"
    if found["curves"]:
        heading = ("curve", "input", "limit", "")
        yield from table([heading, *map(_row, found["curves"])], right=(1, 2))
    if slip_pct is not None:
        caps = ", ".join(f"{name} {pct:.0f} %" for name, pct in slip_pct.items())
        yield f"slip: throttle at most {caps}"
    if pedals is not None:
        yield f"pedals ({pedals['message']}): {pedals['sentence']}"


def _mode(mode: results.DriveModeNow) -> str:
    others = ", ".join(name for name in mode["modes"] if name != mode["current"])
    waits = ""
    if mode["requested"] != mode["current"]:
        waits = (
            f"; {mode['requested']} waits for the pedal's release, and until then of both modes'"
            " limits the lower ones count"
        )
    return f"{mode['current']}{waits} (others: {others or 'none'})"


def _row(curve: results.CurveNow) -> tuple[str, str, str, str]:
    x = "not known" if curve["x"] is None else f"{curve['x']:.4g} {curve['input_unit']}"
    cap = "none" if curve["cap"] is None else f"{curve['cap']:.0f} {curve['cap_unit']}"
    return curve["key"].removeprefix("curves."), x, cap, "limits" if curve["limits"] else ""


@click.command("drive-mode")
@api_options
@level_option("A mode with left_by_service is left at service level.")
@click.argument("mode", required=False)
def drive_mode(
    socket_path: Path | None, as_json: bool, level: results.FaultClassName, mode: str | None
) -> None:
    """Take another drive mode; without MODE, show which there are.

    While active it waits for the pedal's release where it would make a step; its limits of power,
    brake and speed count at once.
    """
    with connected(socket_path) as client:
        waits = mode is not None and client.set_drive_mode(mode, level)["waits_for_release"]
        found = client.tuning()["drive_mode"]
    if found is not None and mode is not None and not waits:
        found["current"] = mode  # from the next tick on
    if found is None:
        show(found, as_json, lambda: "no drive mode is configured; docs/tuning.md says how")
    else:
        show(found, as_json, lambda: _mode(found))
