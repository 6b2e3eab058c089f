"""`vcu-gateway estop`: emergency stop, and whether the controllers confirm it."""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import click

from vcu_gateway.api import results
from vcu_gateway.cli.api_options import api_options, connected, show
from vcu_gateway.client import Client

_ASK_EVERY_S = 0.05
_GRANTED = "Stop granted; it ends with: vcu-gateway reset --level service"
_NOT_TOLD = "Stop granted; this gateway is older and does not tell whether the controllers confirm"
_NONE_LATCHED = "Stop granted; none is latched now"

Say = Callable[[str], None]


@click.command("estop", epilog="Exit code: 0 power is cut, 1 not obeyed, 75 not confirmed in time.")
@api_options
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(0, 3600),
    default=3.0,
    show_default=True,
    metavar="SECONDS",
    help="How long at most to wait for the controllers to confirm.",
)
@click.option("--no-wait", is_flag=True, help="Ask only; exit code 0 says that it was granted.")
def command(socket_path: Path | None, as_json: bool, wait_s: float, no_wait: bool) -> None:
    """Emergency stop: cut the power of both controllers, and say whether they have.

    Every user who can open the socket may do this. It says how far the stop has come, on the bus
    and at the controllers, and waits until both confirm. Ctrl-C ends the waiting, not the stop,
    which ends with a reset at service level.
    """
    say: Say = (lambda _: None) if as_json else click.echo
    with connected(socket_path) as client:
        granted = client.estop()
        say(_GRANTED)
        stop = None if no_wait else _awaited(client, wait_s, say)
    if as_json:
        show({**granted, "stop": stop}, as_json, str)
    if not no_wait:
        sys.exit(_exit_code(stop))


def _awaited(client: Client, wait_s: float, say: Say) -> results.StopState | None:
    """The stop once both controllers have cut, or when the time is over; each change is said."""
    end_s, said = time.monotonic() + wait_s, ""
    while True:
        state = client.state(())
        if "stop" not in state:
            say(_NOT_TOLD)
            return None
        stop, is_over = state["stop"], time.monotonic() >= end_s
        sentence = stop["sentence"] if stop else _NONE_LATCHED if is_over else ""
        if sentence not in ("", said):  # until its tick a granted stop is not latched
            say(sentence)
            said = sentence
        if is_over or (stop and stop["stage"] == "cut"):
            return stop
        time.sleep(_ASK_EVERY_S)  # each tick brings another state at most


def _exit_code(stop: results.StopState | None) -> int:
    if stop is None or stop["stage"] not in ("cut", "not obeyed"):
        return os.EX_TEMPFAIL
    return 0 if stop["stage"] == "cut" else 1
