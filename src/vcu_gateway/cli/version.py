"""`vcu-gateway version`: what a bug report needs to say."""

import hashlib
import importlib.metadata
import json
import platform
import socket

import click

from vcu_gateway import __version__
from vcu_gateway.protocol import packaged

_LIBRARIES = ("python-can", "cantools")


@click.command("version")
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
def command(as_json: bool) -> None:
    """Print the versions that matter for a bug report.

    "can" tells whether this kernel gives the program a raw CAN socket; it needs no interface.
    """
    missing = _kernel_can_missing()
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


def _kernel_can_missing() -> str | None:
    """Why there is no raw CAN socket here, or None where there is."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except AttributeError:
        return "this Python was built without CAN"
    except OSError as error:
        return error.strerror or str(error)
    return None
