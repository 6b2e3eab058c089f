"""Option `--listen ADDRESS:PORT` of the verbs that serve something over HTTP."""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import click

_MAX_PORT = 65_535

_Command = TypeVar("_Command", bound=Callable[..., Any])


class ListenAddress(NamedTuple):
    """Address and TCP port to listen on; port 0 is any that is free."""

    address: str
    port: int


def listen_option(default: str, help_text: str) -> Callable[[_Command], _Command]:
    """Decorator for the option; an IPv6 address stands in brackets."""
    return click.option(
        "--listen",
        metavar="ADDRESS:PORT",
        default=default,
        show_default=True,
        callback=_listen_address,
        help=help_text,
    )


def _listen_address(context: click.Context, parameter: click.Parameter, text: str) -> ListenAddress:
    del context, parameter
    address, colon, port = text.rpartition(":")
    address = address.removeprefix("[").removesuffix("]")
    if not (address and colon and port.isascii() and port.isdecimal() and int(port) <= _MAX_PORT):
        raise click.BadParameter(f"{text!r} is not ADDRESS:PORT, such as 127.0.0.1:9464")
    return ListenAddress(address, int(port))
