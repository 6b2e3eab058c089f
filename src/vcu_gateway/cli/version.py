"""`vcu-gateway version`: versions for a bug report."""

import hashlib
import importlib.metadata
import json
import platform

import click

from vcu_gateway import __version__
from vcu_gateway.bus.interface import can_socket_error
from vcu_gateway.protocol import packaged

_LIBRARIES = ("python-can", "cantools")


@click.command("version")
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
def command(as_json: bool) -> None:
    """Print the versions that matter for a bug report.

    "can" tells whether this kernel gives the program a raw CAN socket; it needs no interface.
    """
    error = can_socket_error()
    missing = error and (error.strerror or str(error))
    facts = {
        "vcu-gateway": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in _LIBRARIES},
        "kernel": f"{platform.system()} {platform.release()}",
        "dbc_sha256": hashlib.sha256(packaged("vcu.dbc").read_bytes()).hexdigest(),
    }
    if as_json:
        click.echo(json.dumps({**facts, "can": missing is None, "can_error": missing}))
        return
    for name, value in facts.items():
        click.echo(f"{name} {value}")
    click.echo(f"can {'yes' if missing is None else f'no: {missing}'}")
