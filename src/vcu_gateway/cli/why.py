"""`vcu-gateway why`: what blocks, what limits, what to do next."""

from pathlib import Path

import click

from vcu_gateway.cli.api_options import api_options, connected, show


@click.command("why")
@api_options
def command(socket_path: Path | None, as_json: bool) -> None:
    """Say in one line why the vehicle does or does not move, and what to do next."""
    with connected(socket_path) as client:
        why = client.why()
    show(why, as_json, lambda: why["sentence"])
