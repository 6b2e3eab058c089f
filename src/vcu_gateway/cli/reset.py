"""`vcu-gateway reset`: from fault to starting."""

from pathlib import Path
from typing import Literal

import click

from vcu_gateway.cli.api_options import api_options, connected, show


@click.command("reset")
@api_options
@click.option(
    "--level",
    type=click.Choice(["driver", "service"]),
    default="driver",
    show_default=True,
    help="A cut needs service; `vcu-gateway why` says which.",
)
def command(socket_path: Path | None, as_json: bool, level: Literal["driver", "service"]) -> None:
    """Leave a latched fault, unarmed; refused, with the reason, while its cause stands."""
    with connected(socket_path) as client:
        granted = client.reset(level)
    show(granted, as_json, lambda: granted["mode"])
