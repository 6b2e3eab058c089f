"""`vcu-gateway disarm`: from active to standby."""

from pathlib import Path

import click

from vcu_gateway.cli.api_options import api_options, connected, show


@click.command("disarm")
@api_options
def command(socket_path: Path | None, as_json: bool) -> None:
    """End the drive: from active to standby, zero torque at once."""
    with connected(socket_path) as client:
        granted = client.disarm()
    show(granted, as_json, lambda: granted["mode"])
