"""`vcu-gateway run`: the gateway on its bus."""

import json
import os
import time
from pathlib import Path

import click

from vcu_gateway import lean_imports  # noqa: F401 - before whatever imports asyncio or hashlib

# isort: split
from vcu_gateway.app import Application
from vcu_gateway.cli.options import config_option, resolve_config
from vcu_gateway.config.checks import startable
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.daemon import log, realtime, systemd
from vcu_gateway.daemon.events import EventLog
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.reload import report_effect
from vcu_gateway.daemon.systemd import SystemdNotifier
from vcu_gateway.errors import GatewayError, Problem, UnavailableError
from vcu_gateway.server import queries, views


@click.command("run")
@config_option
@click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(min=0, min_open=True),
    metavar="SECONDS",
    help="Stop by itself after so long; for measurements.",
)
@click.option(
    "--state-out",
    "state_path",
    type=click.Path(dir_okay=False, writable=True, path_type=Path),
    metavar="FILE",
    help="Write the last state and all counters as JSON when it stops.",
)
@click.option(
    "--lock-memory",
    is_flag=True,
    help="Keep the program in memory, so that no tick waits for the disk.",
)
def command(
    config_path: Path | None,
    duration_s: float | None,
    state_path: Path | None,
    lock_memory: bool,
) -> None:
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
    manager = SystemdNotifier.of_this_process()
    try:
        _run(manager, config_path, duration_s, state_path, lock_memory)
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
    loop, runtime = application.loop, _runtime_folder()
    loop.event_log.emit(queries.started(config))
    report_effect(config, loop.event_log)
    if runtime is not None:
        systemd.forget(runtime)
    loop.connection.acquire_lock()
    if lock_memory:
        _lock_memory(loop.event_log)
    application.begin_service(manager, runtime)
    loop.handle_signals(on_hangup=application.api.reloader.on_hangup)
    try:
        with application.api:
            application.run(duration_s)
    finally:
        writer.drain()
    if state_path is not None:
        _write_state(state_path, loop)


def _lock_memory(event_log: EventLog) -> None:
    try:
        realtime.lock_memory()
    except UnavailableError as error:
        reason = str(error)
        event_log.emit(Event("memory_not_locked", Severity.WARNING, {"reason": reason}))


def _runtime_folder() -> Path | None:
    """The first of systemd's RuntimeDirectory=."""
    first = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    return Path(first) if first else None


def _write_state(path: Path, loop: TickLoop) -> None:
    try:
        path.write_text(json.dumps(_last_state(loop), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        what = f"cannot be written: {error.strerror}"
        raise UnavailableError(Problem(what, str(path))) from error


def _last_state(loop: TickLoop) -> dict[str, object]:
    snapshot = loop.gateway.snapshot(time.monotonic_ns())
    return {
        "messages": views.messages(snapshot),
        "counters": views.counters(loop.gateway),
        "bus": loop.connection.report(),
        "ticks": {
            "done": loop.schedule.ticks,
            "skipped": loop.schedule.skipped,
            "silent": loop.silent_ticks,
        },
    }
