"""State of the gateway itself, as the API reports it."""

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
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.schedule import LATENESS_BOUNDS_NS, Schedule, percentile_ns
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.restarts import CountedStart
from vcu_gateway.daemon.tap_socket import RecorderTap
from vcu_gateway.server import views
from vcu_gateway.server.process_usage import process_usage
from vcu_gateway.units import NS_PER_MS, NS_PER_S, NS_PER_US

_VERSIONS: results.Versions = {
    "vcu_gateway": __version__,
    "python": platform.python_version(),
    "python_can": importlib.metadata.version("python-can"),
    "kernel": f"{platform.system()} {platform.release()}",
}


@dataclass(slots=True)
class RunFacts:
    """Facts about this run, known from its start on.

    Attributes:
        start: this start; None where starts are not counted.
        log_lines_dropped: number of lines that the log's writer dropped.
        started_ns: CLOCK_MONOTONIC; start_time_s: the same, seconds since 1970.
        tap: what is handed to the recorder; None where the configuration has no tap.
    """

    protocol_digest: str
    start: CountedStart | None
    log_lines_dropped: Callable[[], int]
    started_ns: int = field(default_factory=time.monotonic_ns)
    start_time_s: float = field(init=False)
    tap: RecorderTap | None = None

    def __post_init__(self) -> None:
        age_s = (time.monotonic_ns() - self.started_ns) / NS_PER_S
        self.start_time_s = time.time() - age_s


def started(config: Config) -> Event:
    """First event of a log: versions, configuration, interface."""
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
    loop: TickLoop,
    bus: BusSettings,
    config: Config,
    facts: RunFacts,
    api: results.ApiCounts,
    now_ns: int,
) -> results.Health:
    """Result of `health` at this instant; from any thread."""
    return {
        "pid": os.getpid(),
        "uptime_ms": views.milliseconds(now_ns - facts.started_ns) or 0.0,
        "start_time_s": facts.start_time_s,
        "starts": facts.start and facts.start.number,
        "unexpected_restarts": facts.start and facts.start.unexpected,
        "config_file": config.source.file,
        "config_digest": configuration.digest(config),
        "protocol_digest": facts.protocol_digest,
        "link": _link(loop, bus, now_ns),
        "ticks": _ticks(loop.schedule, loop.silent_ticks),
        "frames": _frames(loop),
        "api": api,
        "recorder": _recorder(facts.tap),
        "log_lines_dropped": facts.log_lines_dropped(),
        "process": process_usage(),
        "versions": _VERSIONS,
    }


def _recorder(tap: RecorderTap | None) -> results.RecorderCounts | None:
    return None if tap is None else views.result_of(results.RecorderCounts, tap.counts)


def _link(loop: TickLoop, bus: BusSettings, now_ns: int) -> results.Link:
    link = loop.gateway.link
    return {
        "interface": bus.interface,
        "channel": bus.channel,
        "state": link.state.value,
        "since_ms": (now_ns - link.since_ns) / NS_PER_MS,
        "lost": loop.connection.lost,
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
        "lateness_histogram": _lateness_histogram(schedule),
    }


def _lateness_histogram(schedule: Schedule) -> list[results.LatenessBin]:
    bounds_us = [*(bound_ns / NS_PER_US for bound_ns in LATENESS_BOUNDS_NS), None]
    counts = tuple(schedule.lateness_counts)  # copied at once: the ticking thread writes it
    return [
        {"up_to_us": bound_us, "ticks": ticks}
        for bound_us, ticks in zip(bounds_us, counts, strict=True)
    ]


def _frames(loop: TickLoop) -> results.FrameCounts:
    connection = loop.connection
    return cast(
        results.FrameCounts,
        {
            "received": connection.counters.received,
            "dropped": connection.dropped,
            "sent": connection.counters.sent,
            "unsent": dict(connection.counters.refused),
            "receiver_bugs": connection.counters.receiver_bugs,
            **views.counters(loop.gateway),
        },
    )
