"""`vcu-gateway reload`: the configuration file again, all of it or nothing."""

from pathlib import Path

import click

from vcu_gateway.api import results
from vcu_gateway.cli.api_options import api_options, connected, show


@click.command("reload")
@api_options
def command(socket_path: Path | None, as_json: bool) -> None:
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
