"""`vcu-gateway arm`: from standby to active."""

from pathlib import Path

import click

from vcu_gateway.cli.api_options import api_options, connected, show


@click.command("arm")
@api_options
def command(socket_path: Path | None, as_json: bool) -> None:
    """Let the vehicle move: from standby to active.

    Refused, with the reason, unless nothing speaks against it; a fresh demand without throttle
    is needed, such as `vcu-gateway demand` in another terminal holds.
    """
    with connected(socket_path) as client:
        granted = client.arm()
    show(granted, as_json, lambda: granted["mode"])
