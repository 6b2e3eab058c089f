"""`vcu-gateway run`: the gateway on its bus."""

import json
import os
import time
from pathlib import Path

import click

from vcu_gateway import app
from vcu_gateway import config as configuration
from vcu_gateway.cli.options import config_option, resolve_config
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.daemon import log, realtime, safe_frames
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.restart_state import RestartState, folder_for, other_folders
from vcu_gateway.daemon.systemd import ServiceReporter, SystemdNotifier
from vcu_gateway.errors import ConfigError, GatewayError, Problem, UnavailableError
from vcu_gateway.server import health, views
from vcu_gateway.serving import Serving


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

    A service manager is told over $NOTIFY_SOCKET when it is ready, how it fares and that it
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
    config = configuration.load(resolve_config(config_path))
    protocol = app.load_protocol(config)
    app.check_protocol(config, protocol)
    problems = [
        *configuration.check_against(config, protocol),
        *configuration.check_accounts(config),
    ]
    if problems:
        raise ConfigError(*problems)
    writer = log.configure(config.log.level, config.log.format)
    daemon = app.build(config, protocol)
    daemon.journal.tell(health.started(config))
    runtime = _runtime_folder()
    if runtime is not None:
        safe_frames.forget(runtime)
    daemon.door.claim()
    if lock_memory:
        _lock_memory(daemon)
    folder = folder_for(daemon.door.settings, runtime)
    restart_state = RestartState(
        folder,
        daemon.door.settings,
        daemon.gateway,
        daemon.journal,
        other_folders(daemon.door.settings, folder),
    )
    restart_state.begin()
    service = ServiceReporter(manager, runtime, daemon)
    service.begin()
    serving = Serving(config, protocol, daemon, lambda: writer.dropped, service.start)
    daemon.handle_signals(on_hangup=serving.reloader.on_hangup)
    daemon.observe_with(restart_state.observe)
    daemon.observe_with(serving.observe)
    daemon.observe_with(service.observe)
    serving.open()
    try:
        daemon.run(duration_s)
        service.end()
    finally:
        serving.close()
        writer.drain()
    if state_path is not None:
        _write_state(state_path, daemon)


def _lock_memory(daemon: TickLoop) -> None:
    try:
        realtime.lock()
    except UnavailableError as error:
        reason = str(error)
        daemon.journal.tell(Event("memory_not_locked", Severity.WARNING, {"reason": reason}))


def _runtime_folder() -> Path | None:
    """The first of systemd's RuntimeDirectory=."""
    first = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    return Path(first) if first else None


def _write_state(path: Path, daemon: TickLoop) -> None:
    try:
        path.write_text(json.dumps(_last_state(daemon), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        what = f"cannot be written: {error.strerror}"
        raise UnavailableError(Problem(what, str(path))) from error


def _last_state(daemon: TickLoop) -> dict[str, object]:
    snapshot = daemon.gateway.intake.store.snapshot(time.monotonic_ns())
    return {
        "messages": views.messages(snapshot),
        "counters": views.counters(daemon.gateway),
        "bus": daemon.door.report(),
        "ticks": {
            "done": daemon.schedule.ticks,
            "skipped": daemon.schedule.skipped,
            "silent": daemon.silent_ticks,
        },
    }
