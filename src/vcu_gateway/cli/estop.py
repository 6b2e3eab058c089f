"""`vcu-gateway estop`: cut the power now."""

from pathlib import Path

import click

from vcu_gateway.cli.api_options import api_options, connected, show

_NEXT = "power cut; when it is safe again: vcu-gateway reset --level service"


@click.command("estop")
@api_options
def command(socket_path: Path | None, as_json: bool) -> None:
    """Emergency stop: cut the power of both controllers in the next tick.

    Whoever can open the socket may do this. It ends with a reset at service level.
    """
    with connected(socket_path) as client:
        granted = client.estop()
    show(granted, as_json, lambda: _NEXT)
