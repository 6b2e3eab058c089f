"""`vcu-gateway check-config`: check a configuration file and show its values."""

import json
from pathlib import Path

import click

from vcu_gateway import config as configuration
from vcu_gateway.cli.options import config_option, resolve_config
from vcu_gateway.config import BenchDemandSection, Config
from vcu_gateway.config.protocol import check_protocol, load_protocol
from vcu_gateway.errors import ConfigError


@click.command("check-config")
@config_option
@click.option("--json", "as_json", is_flag=True, help="Print every value that is in effect.")
def command(config_path: Path | None, as_json: bool) -> None:
    """Check a configuration file without starting anything.

    Prints what matters of a good file and exits with 0. Otherwise every error is a line on
    stderr, with the line of the file and what to do, and the exit code is 78.
    """
    path = resolve_config(config_path)
    config = configuration.load(path)
    protocol = load_protocol(config)
    check_protocol(config, protocol)
    if problems := configuration.check_against(config, protocol):
        raise ConfigError(*problems)
    if as_json:
        click.echo(json.dumps(configuration.effective(config), indent=2, ensure_ascii=False))
        return
    click.echo(f"{path}: valid\n{summary(config)}")


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
