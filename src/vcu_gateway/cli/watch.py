"""`vcu-gateway watch`: the running gateway, live, filling the terminal."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import click

from vcu_gateway.cli.options import socket_option
from vcu_gateway.errors import Problem, UnavailableError

_PARTS = ("textual", "rich")


@click.command("watch")
@socket_option
def command(socket_path: Path | None) -> None:
    """Show the running gateway live: mode and why, commanded beside actual, every signal.

    It only looks; E (after e) is the emergency stop and D (after d) disarms. ? lists the keys.
    A gateway that goes away is waited for. NO_COLOR is respected.
    """
    with extra_needed():
        from vcu_gateway.watch import terminal
        from vcu_gateway.watch.poller import GatewaySource
        from vcu_gateway.watch.run import watch
    if not terminal.is_full():
        remedy = "`vcu-gateway status` tells the same once, as text or JSON"
        what = "the live view needs a terminal for input, output and errors"
        raise UnavailableError(Problem(what, remedy=remedy))
    with GatewaySource(socket_path) as source:
        watch(source, "vcu-gateway")


@contextlib.contextmanager
def extra_needed() -> Iterator[None]:
    """UnavailableError where the libraries of the live view are not installed."""
    try:
        yield
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in _PARTS:
            raise
        remedy = "install the extra: pip install 'vcu-gateway[tui]'"
        raise UnavailableError(Problem(f"the live view needs {error.name}", "", remedy)) from error
