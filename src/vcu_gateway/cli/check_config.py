"""`vcu-gateway check-config`: check a configuration file and show its values."""

import contextlib
import json
import os
from pathlib import Path

import click

from vcu_gateway import config as configuration
from vcu_gateway.app import bus_settings
from vcu_gateway.bus.interface import Interfaces, unfit
from vcu_gateway.cli.options import config_option, resolve_config
from vcu_gateway.config import BenchDemandSection, Config
from vcu_gateway.config.checks import startable
from vcu_gateway.server.acceptor import obstacle

_NOT_ALL = "valid; the gateway starts, and goes on without what is not there now:"
_ELSEWHERE = "valid, as far as this machine can tell: users, groups and bus were not looked at"
_RUNTIME = Path("/run")


@click.command("check-config")
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print every value that is in effect.")
@click.option(
    "--other-machine",
    is_flag=True,
    help="The file is for another machine: do not look for its users, groups, bus and folders.",
)
def command(config_path: Path | None, as_json: bool, other_machine: bool) -> None:
    """Check a configuration file without starting anything, as `run` checks it at its start.

    Prints what matters of a good file and exits with 0. Otherwise every error is a line on
    stderr, with the line of the file and what to do, and the exit code is that of `run`: 78, 66
    where a file cannot be read, 65 where a DBC is wrong. A value without effect is a warning.
    """
    path = resolve_config(config_path)
    config, _ = startable(path, on_this_machine=not other_machine)
    for problem in configuration.check_effect(config):
        click.echo(f"warning: {problem}", err=True)
    if as_json:
        click.echo(json.dumps(configuration.effective(config), indent=2, ensure_ascii=False))
        return
    missing = [] if other_machine else not_there(config)
    verdict = _ELSEWHERE if other_machine else _NOT_ALL if missing else "valid"
    click.echo("\n".join([f"{path}: {verdict}", *missing, summary(config)]))


def not_there(config: Config) -> list[str]:
    """What a start would not find now, and does not need: the bus, a place for the API's socket."""
    found = []
    if config.bus.interface == "socketcan":
        with contextlib.closing(Interfaces()) as interfaces:
            there = interfaces.look(config.bus.channel)
        found.append(unfit(there, bus_settings(config), None))
    folder = Path(config.api.socket_path).parent
    made_at_the_start = folder.parent == _RUNTIME and not os.path.lexists(folder)
    if config.api.enabled and not made_at_the_start:  # by systemd, for RuntimeDirectory=
        found.append(obstacle(config.api.socket_path))
    return [f"  missing {problem}" for problem in found if problem is not None]


def summary(config: Config) -> str:
    """Settings that matter before driving, a line each."""
    bus, demand = config.bus, config.bench.demand
    return "\n".join(
        (
            f"  bus     {bus.interface} {bus.channel}, expected at {bus.bit_rate_bit_s} bit/s",
            f"  bench   {'no static demand' if demand is None else _in_capitals(config, demand)}",
            f"  digest  {configuration.digest(config)}",
        )
    )


def _in_capitals(config: Config, demand: BenchDemandSection) -> str:
    power_w = min(demand.power_limit_w, config.limits.power_limit_max_w)
    direction = "reverse" if demand.motor_reverse else "forward"
    return (
        f"STATIC DEMAND, WHEELS OFF THE GROUND: throttle {demand.throttle_pct:g} %,"
        f" brake {demand.brake_pct:g} %, {demand.power_mode}, {direction},"
        f" at most {demand.speed_limit_rpm} rpm and {power_w} W"
    )
