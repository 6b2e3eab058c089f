"""Options, signals and extras that several verbs share."""

import contextlib
import os
import signal
import threading
from _thread import start_new_thread
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click

from vcu_gateway.errors import MissingInputError, Problem, extra_needed
from vcu_gateway.protocol import packaged
from vcu_gateway.time_window import Moment, moment

DEFAULT_CONFIG = Path("/etc/vcu-gateway/gateway.yaml")

ANY_PATH = click.Path(path_type=Path, readable=False)
"""A path that is looked at when it is opened: click's own look ends with 2 and the usage."""

Option = Callable[[Callable[..., Any]], Callable[..., Any]]
"""Decorator of a verb's function."""


def file_option(*names: str, **attributes: Any) -> Option:
    """Option for a file; click itself ends with 2 where one is there and cannot be read."""
    usual: dict[str, Any] = {"metavar": "FILE", "type": click.Path(path_type=Path)}
    return click.option(*names, **usual | attributes)


def config_file_option(text: str, **attributes: Any) -> Option:
    return file_option("-c", "--config", "config_path", help=text, **attributes)


config_option = config_file_option(f"Configuration; default: {DEFAULT_CONFIG}.", type=ANY_PATH)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object.")


def duration_option(text: str) -> Option:
    seconds = click.FloatRange(min=0, min_open=True)
    return click.option("--duration", "duration_s", metavar="SECONDS", type=seconds, help=text)


def level_option(text: str) -> Option:
    levels = click.Choice(["driver", "service"])
    return click.option("--level", type=levels, default="driver", show_default=True, help=text)


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


_MAX_PORT = 65_535


class ListenAddress(NamedTuple):
    """Address and TCP port to listen on; port 0 is any that is free."""

    address: str
    port: int


def listen_option(default: str, help_text: str) -> Option:
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


@contextlib.contextmanager
def stopped_by_signals(*also: signal.Signals) -> Iterator[threading.Event]:
    """An event that SIGINT, SIGTERM and `also` set; the old handlers come back afterwards."""
    stop, numbers = threading.Event(), (signal.SIGINT, signal.SIGTERM, *also)
    # In another thread: the one that is interrupted may hold the event's lock.
    before = {one: signal.signal(one, lambda *_: start_new_thread(stop.set, ())) for one in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


tui_needed = partial(extra_needed, "the live view needs", "tui", "textual", "rich")
web_needed = partial(extra_needed, "the page needs", "web", "starlette", "uvicorn", "h11", "anyio")
