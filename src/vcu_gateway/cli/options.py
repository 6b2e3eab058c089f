"""Options shared by several verbs."""

import os
from pathlib import Path

import click

from vcu_gateway.errors import ConfigError, Problem
from vcu_gateway.protocol import packaged

DEFAULT_CONFIG = Path("/etc/vcu-gateway/gateway.yaml")

config_option = click.option(
    "-c",
    "--config",
    "config_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help=f"Configuration; default: {DEFAULT_CONFIG}.",
)


def resolve_config(given: Path | None, default: Path = DEFAULT_CONFIG) -> Path:
    """Path of the configuration; ConfigError where none is given and the default is missing."""
    if given is not None:
        return given
    if os.path.lexists(default):
        return default
    remedy = (
        f"give one with -c FILE, or begin with the example:"
        f" sudo install -D -m 644 {packaged('gateway.yaml')} {default}"
    )
    raise ConfigError(Problem("there is no configuration file", str(default), remedy))


socket_option = click.option(
    "--socket",
    "socket_path",
    metavar="PATH",
    envvar="VCU_GATEWAY_SOCKET",
    show_envvar=True,
    type=click.Path(path_type=Path),
    help="The gateway's socket; default: /run/vcu-gateway/control.sock.",
)
