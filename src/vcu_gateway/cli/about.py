"""`vcu-gateway version` and `completion`: versions for a bug report, a shell's completion."""

import hashlib
import importlib.metadata
import json
import platform

import click
from click.shell_completion import get_completion_class

from vcu_gateway import __version__
from vcu_gateway.bus.interface import can_socket_error
from vcu_gateway.cli.options import json_option
from vcu_gateway.protocol import packaged


@click.command("version")
@json_option
def version(as_json: bool) -> None:
    """Print the versions that matter for a bug report.

    "can" tells whether this kernel gives the program a raw CAN socket; it needs no interface.
    """
    error = can_socket_error()
    missing = error and (error.strerror or str(error))
    facts = {
        "vcu-gateway": __version__,
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in ("python-can", "cantools")},
        "kernel": f"{platform.system()} {platform.release()}",
        "dbc_sha256": hashlib.sha256(packaged("vcu.dbc").read_bytes()).hexdigest(),
    }
    if as_json:
        click.echo(json.dumps({**facts, "can": missing is None, "can_error": missing}))
        return
    for name, value in facts.items():
        click.echo(f"{name} {value}")
    click.echo(f"can {'yes' if missing is None else f'no: {missing}'}")


@click.command("completion")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print the completion script of a shell.

    \b
    For one user:   vcu-gateway completion bash >> ~/.bashrc
    For everybody:  vcu-gateway completion bash | sudo tee /etc/bash_completion.d/vcu-gateway
    """  # noqa: D301 - click knows \\b as a character
    kind = get_completion_class(shell)
    if kind is None:
        raise click.UsageError(f"{shell} is not supported by this version of click")
    program = context.find_root().command
    click.echo(kind(program, {}, "vcu-gateway", "_VCU_GATEWAY_COMPLETE").source())
