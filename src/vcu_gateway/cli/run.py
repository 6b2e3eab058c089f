"""`vcu-gateway run`: the gateway on its bus."""

import json
import time
from pathlib import Path

import click

from vcu_gateway import config as configuration
from vcu_gateway import log, report, wiring
from vcu_gateway.cli.options import config_option, resolve_config
from vcu_gateway.daemon import Daemon
from vcu_gateway.errors import ConfigError, Problem, UnavailableError
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
def command(config_path: Path | None, duration_s: float | None, state_path: Path | None) -> None:
    """Run the gateway: decode what the bus says, command both controllers every 50 ms.

    Runs until SIGTERM or Ctrl-C; SIGHUP reloads the configuration. The log goes to stderr, as
    JSON lines unless stderr is a terminal. A missing interface is waited for: the gateway opens
    it when it appears.
    """
    config = configuration.load(resolve_config(config_path))
    protocol = wiring.load_protocol(config)
    wiring.check_protocol(config, protocol)
    if problems := configuration.check_against(config, protocol):
        raise ConfigError(*problems)
    writer = log.configure(config.log.level, config.log.format)
    daemon = wiring.build(config, protocol)
    daemon.door.claim()
    serving = Serving(config, protocol, daemon, lambda: writer.dropped)
    daemon.handle_signals(on_hangup=serving.reloader.on_hangup)
    daemon.observe_with(serving.observe)
    serving.open()
    try:
        daemon.run(duration_s)
    finally:
        serving.close()
    writer.drain()
    if state_path is not None:
        _write_state(state_path, daemon)


def _write_state(path: Path, daemon: Daemon) -> None:
    try:
        path.write_text(json.dumps(_last_state(daemon), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        what = f"cannot be written: {error.strerror}"
        raise UnavailableError(Problem(what, str(path))) from error


def _last_state(daemon: Daemon) -> dict[str, object]:
    snapshot = daemon.gateway.intake.store.snapshot(time.monotonic_ns())
    return {
        "messages": report.messages(snapshot),
        "counters": report.counters(daemon.gateway),
        "bus": daemon.door.report(),
        "ticks": {
            "done": daemon.schedule.ticks,
            "skipped": daemon.schedule.skipped,
            "silent": daemon.silent_ticks,
        },
    }
