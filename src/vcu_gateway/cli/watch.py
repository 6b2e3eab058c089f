"""`vcu-gateway watch`: live view of the running gateway, on a full terminal."""

from pathlib import Path

import click

from vcu_gateway.cli.extras import tui_needed
from vcu_gateway.cli.options import socket_option
from vcu_gateway.errors import Problem, UnavailableError


@click.command("watch")
@socket_option
def command(socket_path: Path | None) -> None:
    """Show the running gateway live: mode and why, commanded beside reported, every signal.

    It only reads; E (after e) is the emergency stop and D (after d) disarms. ? lists the keys.
    A gateway that goes away is waited for. NO_COLOR is respected.
    """
    with tui_needed():
        from vcu_gateway.watch import terminal
        from vcu_gateway.watch.source import GatewaySource
    if not terminal.is_full():
        remedy = "`vcu-gateway status` prints the same once, as text or JSON"
        what = "the live view needs a terminal for input, output and errors"
        raise UnavailableError(Problem(what, remedy=remedy))
    with GatewaySource(socket_path) as source:
        terminal.watch(source, "vcu-gateway")
