"""`vcu-gateway demand`: throttle and brake from a terminal."""

import getpass
import json
import signal
import time
from pathlib import Path
from typing import Any

import click

from vcu_gateway.api import results
from vcu_gateway.cli.operator import api_options, connected
from vcu_gateway.cli.options import stopped_by_signals
from vcu_gateway.demand_ranges import span

_SET_PERIOD_S, _PRINT_PERIOD_S = 0.1, 0.5


@click.command("demand")
@api_options
@click.option(
    "--throttle",
    "throttle_pct",
    type=float,
    default=0.0,
    help=f"Percent, {span('throttle_pct')}.",
)
@click.option(
    "--throttle-track2",
    "throttle_track2_pct",
    type=float,
    help="The pedal's second track, percent; where demand.second_track_required is set.",
)
@click.option(
    "--brake", "brake_pct", type=float, default=0.0, help=f"Percent, {span('brake_pct')}."
)
@click.option(
    "--mode",
    "power_mode",
    type=click.Choice(["eco", "normal", "turbo"]),
    default="normal",
    show_default=True,
)
@click.option("--reverse", "motor_reverse", is_flag=True, help="Turn the motors in reverse.")
@click.option("--regen", "regen_brake", is_flag=True, help="Recover energy while braking.")
@click.option("--speed-limit", "speed_limit_rpm", type=float, help="rpm; default: as configured.")
@click.option("--power-limit", "power_limit_w", type=float, help="W; default: none of its own.")
@click.option("--source", help="Name of the source; default: your user name.")
@click.option("--ttl-ms", type=int, default=200, show_default=True, help="Time to live.")
@click.option("--for", "for_s", type=click.FloatRange(min=0, min_open=True), metavar="SECONDS")
@click.option("--arm", "arming", is_flag=True, help="Arm before the throttle is demanded.")
def demand(
    socket_path: Path | None,
    as_json: bool,
    source: str | None,
    ttl_ms: int,
    for_s: float | None,
    arming: bool,
    **values: Any,
) -> None:
    """Hold a demand for both controllers until Ctrl-C, or for so many seconds.

    The demand ends with this program, also when it is killed: the gateway ends it with its
    connection, at the latest after its time to live. Mode and reasons are printed as they change.
    """
    name = source or getpass.getuser()
    with (
        stopped_by_signals(signal.SIGHUP) as stop,
        connected(socket_path) as client,
        client.demand(name, ttl_ms=ttl_ms) as owner,
    ):
        if arming:
            client.arm()
        begun_s = next_print_s = time.monotonic()
        printed = ""
        while not stop.is_set() and (for_s is None or time.monotonic() - begun_s < for_s):
            owner.set(**values)
            if time.monotonic() >= next_print_s:
                next_print_s += _PRINT_PERIOD_S
                printed = _print_change(client.why(), printed, as_json)
            stop.wait(_SET_PERIOD_S)


def _print_change(why: results.Why, printed: str, as_json: bool) -> str:
    """Print mode and reasons where they changed; returns what is compared the next time."""
    reasons = [one["subject"] for one in why["blocks"] + why["limits"]]
    now = json.dumps([why["mode"], reasons, why["next_step"]])
    if now != printed:
        click.echo(json.dumps(why) if as_json else why["sentence"])
    return now
