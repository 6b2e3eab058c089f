"""`vcu-gateway simulate`: the vehicle's other nodes, on a bus."""

import logging
import time
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path

import click

from vcu_gateway import simulator
from vcu_gateway.cli.options import (
    config_file_option,
    duration_option,
    file_option,
    stopped_by_signals,
)
from vcu_gateway.config import core_settings, of_values
from vcu_gateway.config import load as load_config
from vcu_gateway.config.checks import load_protocol
from vcu_gateway.core.codec import Codec
from vcu_gateway.python_can import can
from vcu_gateway.simulator.play import Played, open_bus, play
from vcu_gateway.simulator.scenario import Scenario, ScenarioStart
from vcu_gateway.simulator.scenario import load as load_scenario

_note = partial(click.echo, err=True)
_HELP = """Play the vehicle: BMS, IMU, ARD2 and both motor controllers.

Sends every cyclic message at its period and answers each command frame with the controller's
Status2. The vehicle obeys the commands: it accelerates, brakes, recovers energy, drains its
battery and warms up. A controller that hears no command for 500 ms goes to zero torque.
A scenario breaks it: docs/simulator.md lists the faults, config/scenarios/ holds ready ones.

Meant for a bench or a virtual bus; on a bus with the real nodes both would send the same
identifiers.

\b
A virtual CAN bus:       ip link add dev vcan0 type vcan && ip link set vcan0 up
Without CAN in the kernel: --interface udp_multicast --channel 239.74.163.2
"""


@click.command("simulate", help=_HELP)
@click.option("--interface", default="socketcan", show_default=True, help="python-can's name.")
@click.option("--channel", default="vcan0", show_default=True, help="Which bus of it.")
@config_file_option("The gateway's configuration, for its protocol and its pedals on CAN.")
@duration_option("Stop by itself; otherwise Ctrl-C or SIGTERM.")
@file_option(
    "--scenario",
    "scenario_path",
    help="Faults and their times; each step is reported on stderr.",
)
@click.option(
    "--soc",
    "soc_pct",
    type=click.FloatRange(0, 100),
    show_default="the scenario's, else 80",
    help="State of charge to begin with, %.",
)
@click.option(
    "--battery-speedup",
    type=click.FloatRange(0, 10_000),
    show_default="the scenario's, else 1",
    help="Factor of the battery's charge and discharge; 1 is real time.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the sensors' noise.")
@file_option(
    "--log",
    "log_path",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    help="Write what is sent and received as a candump log; an old FILE is replaced.",
)
def simulate(
    interface: str,
    channel: str,
    config_path: Path | None,
    duration_s: float | None,
    scenario_path: Path | None,
    soc_pct: float | None,
    battery_speedup: float | None,
    seed: int,
    log_path: Path | None,
) -> None:
    # What python-can logs of a failure comes as our error as well.
    logging.getLogger("can").addHandler(logging.NullHandler())
    config = of_values({}, "simulate") if config_path is None else load_config(config_path)
    codec, pedals = Codec(load_protocol(config)), core_settings(config).pedals
    scenario = Scenario(ScenarioStart(), ())
    if scenario_path is not None:
        scenario = load_scenario(scenario_path, codec.protocol)
        scenario.check_pedals(pedals is not None, str(scenario_path))
    start_ns, given = time.monotonic_ns(), {"soc_pct": soc_pct, "battery_speedup": battery_speedup}
    start = scenario.start.model_dump() | {name: n for name, n in given.items() if n is not None}
    nodes = simulator.build(
        codec,
        start_ns,
        **start,
        seed=seed,
        faults=scenario.faults(codec, start_ns, _note),
        pedals=pedals,
        foot=scenario.foot,
    )
    with (
        stopped_by_signals() as stop,
        open_bus(interface, channel, nodes.command_ids) as bus,
        _log(log_path, channel) as log,
    ):
        _note(
            f"playing BMS, IMU, ARD2, PCU1 and PCU2 on {interface} {channel}:"
            f" {len(nodes.cyclic_messages)} cyclic messages, Status2 answers each command;"
            " Ctrl-C ends it"
        )
        played = play(bus, nodes, stop=stop, duration_s=duration_s, log=log, note=_note)
    _note(summary(played))


def summary(played: Played) -> str:
    parts = [f"played {played.duration_s:.1f} s", f"sent {_counted(played.sent)}"]
    parts.append(f"received {_counted(played.received)}")
    if played.lost:
        parts.append(f"not taken by the bus {_counted(played.lost)}")
    return "; ".join(parts)


def _counted(counts: dict[str, int]) -> str:
    each = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
    return f"{sum(counts.values())} ({each})" if counts else "0"


def _log(path: Path | None, channel: str) -> AbstractContextManager[can.Listener | None]:
    if path is None:
        return nullcontext()
    try:
        return can.CanutilsLogWriter(path, channel=channel)
    except OSError as error:
        raise click.BadParameter(f"cannot write it: {error}", param_hint="--log") from error
