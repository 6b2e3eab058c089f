"""Requests of an operator: arm, disarm, reset, reload, why, events."""

from pathlib import Path
from typing import Literal

import click

from vcu_gateway.api import results
from vcu_gateway.cli.api_options import api_options, connected, show
from vcu_gateway.text import duration


@click.command("arm")
@api_options
def arm(socket_path: Path | None, as_json: bool) -> None:
    """Let the vehicle move: from standby to active.

    Refused, with the reason, while anything blocks it; a fresh demand without throttle is needed,
    such as `vcu-gateway demand` in another terminal makes.
    """
    with connected(socket_path) as client:
        granted = client.arm()
    show(granted, as_json, lambda: granted["mode"])


@click.command("disarm")
@api_options
def disarm(socket_path: Path | None, as_json: bool) -> None:
    """End the drive: from active to standby, zero torque at once."""
    with connected(socket_path) as client:
        granted = client.disarm()
    show(granted, as_json, lambda: granted["mode"])


@click.command("reset")
@api_options
@click.option(
    "--level",
    type=click.Choice(["driver", "service"]),
    default="driver",
    show_default=True,
    help="A cut needs service; `vcu-gateway why` says which.",
)
def reset(socket_path: Path | None, as_json: bool, level: Literal["driver", "service"]) -> None:
    """Leave a latched fault, unarmed; refused, with the reason, while its cause is there."""
    with connected(socket_path) as client:
        granted = client.reset(level)
    show(granted, as_json, lambda: granted["mode"])


@click.command("reload")
@api_options
def reload(socket_path: Path | None, as_json: bool) -> None:
    """Read the configuration file again: all of it is taken, or nothing.

    While active only changes that make limits stricter are taken. Keys that need a restart are
    named. Without any error nothing else on the bus changes.
    """
    with connected(socket_path) as client:
        reloaded = client.reload()
    show(reloaded, as_json, lambda: _text(reloaded))


def _text(reloaded: results.Reloaded) -> str:
    changed = ", ".join(reloaded["changed"]) or "nothing"
    return f"changed: {changed} ({reloaded['digest']})"


@click.command("why")
@api_options
def why(socket_path: Path | None, as_json: bool) -> None:
    """Print in one line why the vehicle does or does not move, and the next step."""
    with connected(socket_path) as client:
        why = client.why()
    show(why, as_json, lambda: why["sentence"])


@click.command("events")
@api_options
@click.option("-n", "--limit", type=click.IntRange(1, 200), default=50, show_default=True)
def events(socket_path: Path | None, as_json: bool, limit: int) -> None:
    """List the latest events, the latest last: when, how often, what."""
    with connected(socket_path) as client:
        events = client.events(limit)
    show(events, as_json, lambda: "\n".join(map(_line, events["events"])) or "no events")


def _line(event: results.EventEntry) -> str:
    fields = "  ".join(f"{name}={value}" for name, value in event["fields"].items())
    count = event["count"]
    repeats = f"{count} times in {duration(event['first_ms'])}" if count > 1 else ""
    entry = f"{event['last_time'][:23]}  {event['severity']:<8} {event['name']}  {fields}"
    return f"{entry}  ({repeats})" if repeats else entry
