"""`vcu-gateway run` and `check-config`: the gateway on its bus; its configuration checked."""

import contextlib
import json
import os
import time
from pathlib import Path
from typing import Any

import click

from vcu_gateway import lean_imports  # noqa: F401 - before whatever imports hashlib

# isort: split
from vcu_gateway import config as configuration
from vcu_gateway.app import Application, bus_settings
from vcu_gateway.bus.interface import Interfaces, unfit
from vcu_gateway.cli.options import config_option, duration_option, file_option, resolve_config
from vcu_gateway.config import BenchDemandSection, Config
from vcu_gateway.config.checks import startable
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.daemon import log, systemd, ticking_thread
from vcu_gateway.daemon.events import EventLog
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.reload import report_effect
from vcu_gateway.daemon.systemd import SystemdNotifier
from vcu_gateway.errors import GatewayError, Problem, UnavailableError
from vcu_gateway.server import queries, views
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
def check_config(config_path: Path | None, as_json: bool, other_machine: bool) -> None:
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


@click.command("run")
@config_option
@duration_option("Stop by itself after so long; for measurements.")
@file_option(
    "--state-out",
    "state_path",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    help="Write the last state and all counters as JSON when it stops.",
)
@click.option(
    "--lock-memory",
    is_flag=True,
    help="Keep the program in memory, so that no tick waits for the disk.",
)
def run(**options: Any) -> None:
    """Run the gateway: decode what the bus says, command both controllers every 50 ms.

    Runs until SIGTERM or Ctrl-C; SIGHUP reloads the configuration. The log goes to stderr, as
    JSON lines unless stderr is a terminal. A missing interface is waited for: the gateway opens
    it when it appears.

    A service manager is notified over $NOTIFY_SOCKET when it is ready, of its status and that it
    lives. Starts are counted, and the safe frames are kept for `safe_stop`, in
    $RUNTIME_DIRECTORY where that is set. A latched CUT and the directions are kept there for the
    next start in this boot; without it in /run/vcu-gateway, $XDG_RUNTIME_DIR/vcu-gateway or
    /tmp/vcu-gateway-UID, the first that can be written; a CUT is looked for in all of them.
    """
    manager = SystemdNotifier(os.environ, os.getpid())
    try:
        _run(manager, **options)
    except GatewayError as error:
        manager.status(f"error: {error.problems[0]}")
        raise


def _run(
    manager: SystemdNotifier,
    config_path: Path | None,
    duration_s: float | None,
    state_path: Path | None,
    lock_memory: bool,
) -> None:
    config, protocol = startable(resolve_config(config_path))
    writer = log.configure(config.log.level, config.log.format)
    application = Application(config, protocol, lambda: writer.dropped)
    loop, first = application.loop, os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    runtime = Path(first) if first else None  # of systemd's RuntimeDirectory=
    loop.event_log.emit(queries.started(config))
    report_effect(config, loop.event_log)
    if runtime is not None:
        systemd.forget(runtime)
    loop.connection.acquire_lock()
    if lock_memory:
        _lock_memory(loop.event_log)
    application.begin_service(manager, runtime)
    loop.handle_signals(on_hangup=application.api.reloader.begin)
    try:
        with application.api:
            application.run(duration_s)
    finally:
        writer.drain()
    if state_path is not None:
        _write_state(state_path, loop)


def _lock_memory(event_log: EventLog) -> None:
    try:
        ticking_thread.lock_memory()
    except UnavailableError as error:
        reason = str(error)
        event_log.emit(Event("memory_not_locked", Severity.WARNING, {"reason": reason}))


def _write_state(path: Path, loop: TickLoop) -> None:
    snapshot = loop.gateway.snapshot(time.monotonic_ns())
    state = {
        "messages": views.messages(snapshot),
        "counters": views.counters(loop.gateway),
        "bus": loop.connection.report(),
        "ticks": {
            "done": loop.schedule.ticks,
            "skipped": loop.schedule.skipped,
            "silent": loop.silent_ticks,
        },
    }
    try:
        path.write_text(json.dumps(state, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        what = f"cannot be written: {error.strerror}"
        raise UnavailableError(Problem(what, str(path))) from error
