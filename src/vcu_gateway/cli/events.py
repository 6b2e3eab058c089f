"""`vcu-gateway events`: what happened lately, counted."""

from pathlib import Path

import click

from vcu_gateway.api import results
from vcu_gateway.cli.api_options import age, api_options, connected, show


@click.command("events")
@api_options
@click.option("-n", "--limit", type=click.IntRange(1, 200), default=50, show_default=True)
def command(socket_path: Path | None, as_json: bool, limit: int) -> None:
    """List the latest events, the latest last: when, how often, what."""
    with connected(socket_path) as client:
        events = client.events(limit)
    show(events, as_json, lambda: "\n".join(map(_line, events["events"])) or "no events")


def _line(event: results.EventEntry) -> str:
    fields = "  ".join(f"{name}={value}" for name, value in event["fields"].items())
    often = f"{event['count']} times since {age(event['first_ms'])}" if event["count"] > 1 else ""
    told = f"{event['last_time'][:23]}  {event['severity']:<8} {event['name']}  {fields}"
    return f"{told}  ({often})" if often else told
