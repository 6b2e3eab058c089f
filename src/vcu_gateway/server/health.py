"""How the gateway itself fares, in the API's shape."""

import importlib.metadata
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import cast

from vcu_gateway import __version__
from vcu_gateway import config as configuration
from vcu_gateway.api import results
from vcu_gateway.bus.connection import BusSettings
from vcu_gateway.config import Config
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.core.schedule import Schedule, percentile_ns
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.restarts import CountedStart
from vcu_gateway.server import views
from vcu_gateway.units import NS_PER_MS, NS_PER_US

_VERSIONS: results.Versions = {
    "vcu_gateway": __version__,
    "python": platform.python_version(),
    "python_can": importlib.metadata.version("python-can"),
    "kernel": f"{platform.system()} {platform.release()}",
}


@dataclass(slots=True)
class RunFacts:
    """What is known of this run from its start on.

    Attributes:
        start: this start; None where starts are not counted.
        log_lines_dropped: asks the log's writer.
    """

    protocol_digest: str
    start: CountedStart | None
    log_lines_dropped: Callable[[], int]
    started_ns: int = field(default_factory=time.monotonic_ns)


def started(config: Config) -> Event:
    """What a log begins with: which program, with which configuration, on what."""
    fields = {
        "version": __version__,
        "config_file": os.path.abspath(config.source.file),
        "config_digest": configuration.digest(config),
        "interface": config.bus.interface,
        "channel": config.bus.channel,
        "python": _VERSIONS["python"],
        "kernel": _VERSIONS["kernel"],
    }
    return Event("started", Severity.INFO, fields)


def health(
    daemon: TickLoop, bus: BusSettings, config: Config, facts: RunFacts, api: results.ApiCounts
) -> results.Health:
    """Everything at this instant; read from any thread."""
    now_ns = time.monotonic_ns()
    return {
        "pid": os.getpid(),
        "uptime_ms": views.milliseconds(now_ns - facts.started_ns) or 0.0,
        "starts": facts.start and facts.start.number,
        "unexpected_restarts": facts.start and facts.start.unexpected,
        "config_file": config.source.file,
        "config_digest": configuration.digest(config),
        "protocol_digest": facts.protocol_digest,
        "link": _link(daemon, bus, now_ns),
        "ticks": _ticks(daemon.schedule, daemon.silent_ticks),
        "frames": _frames(daemon),
        "api": api,
        "log_lines_dropped": facts.log_lines_dropped(),
        "versions": _VERSIONS,
    }


def _link(daemon: TickLoop, bus: BusSettings, now_ns: int) -> results.Link:
    link = daemon.gateway.link
    return {
        "interface": bus.interface,
        "channel": bus.channel,
        "state": link.state.value,
        "since_ms": (now_ns - link.since_ns) / NS_PER_MS,
        "lost": daemon.door.lost,
    }


def _ticks(schedule: Schedule, silent: int) -> results.Ticks:
    recent_ns = tuple(schedule.recent_lateness_ns)

    def at(share: float) -> float | None:
        value_ns = percentile_ns(recent_ns, share)
        return None if value_ns is None else value_ns / NS_PER_US

    return {
        "period_ms": schedule.period_ns / NS_PER_MS,
        "done": schedule.ticks,
        "skipped": schedule.skipped,
        "silent": silent,
        "lateness_p50_us": at(0.5),
        "lateness_p90_us": at(0.9),
        "lateness_p99_us": at(0.99),
        "lateness_max_us": at(1.0),
        "lateness_ticks": len(recent_ns),
    }


def _frames(daemon: TickLoop) -> results.FrameCounts:
    door = daemon.door
    return cast(
        results.FrameCounts,
        {
            "received": door.counters.received,
            "dropped": door.dropped,
            "sent": door.counters.sent,
            "unsent": dict(door.counters.refused),
            "receiver_bugs": door.counters.receiver_bugs,
            **views.counters(daemon.gateway),
        },
    )
