"""Options shared by several verbs."""

import os
from pathlib import Path

import click

from vcu_gateway.errors import MissingInputError, Problem
from vcu_gateway.protocol import packaged

DEFAULT_CONFIG = Path("/etc/vcu-gateway/gateway.yaml")

ANY_PATH = click.Path(path_type=Path, readable=False)
"""A path that is looked at when it is opened: click's own look ends with 2 and the usage."""

config_option = click.option(
    "-c",
    "--config",
    "config_path",
    metavar="FILE",
    type=ANY_PATH,
    help=f"Configuration; default: {DEFAULT_CONFIG}.",
)


def resolve_config(given: Path | None, default: Path = DEFAULT_CONFIG) -> Path:
    """Path of the configuration; MissingInputError where none is given and there is no default."""
    if given is not None:
        return given
    if os.path.lexists(default):
        return default
    remedy = (
        f"give one with -c FILE, or begin with the example:"
        f" sudo install -D -m 644 {packaged('gateway.yaml')} {default}"
    )
    raise MissingInputError(Problem("there is no configuration file", str(default), remedy))


socket_option = click.option(
    "--socket",
    "socket_path",
    metavar="PATH",
    envvar="VCU_GATEWAY_SOCKET",
    show_envvar=True,
    type=ANY_PATH,
    help="The gateway's socket; default: /run/vcu-gateway/control.sock.",
)
