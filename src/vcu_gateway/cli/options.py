"""Options shared by several verbs."""

import os
from pathlib import Path

import click

from vcu_gateway.errors import MissingInputError, Problem
from vcu_gateway.protocol import packaged
from vcu_gateway.time_window import Moment, moment

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


def moment_of(written: str | None, option: str, hint: str = "") -> Moment | None:
    """A moment as it was written for this option; BadParameter, with a hint, for what is none."""
    try:
        return None if written is None else moment(written)
    except ValueError:
        what = f"{written!r} is no time such as 90.5, 12:03:14.150 or 2026-11-23T12:03:14. {hint}"
        raise click.BadParameter(what.strip(), param_hint=f"'{option}'") from None


socket_option = click.option(
    "--socket",
    "socket_path",
    metavar="PATH",
    envvar="VCU_GATEWAY_SOCKET",
    show_envvar=True,
    type=ANY_PATH,
    help="The gateway's socket; default: /run/vcu-gateway/control.sock.",
)
