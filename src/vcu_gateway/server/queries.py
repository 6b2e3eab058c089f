"""Queries: what the API answers without asking the ticking thread, health among it."""

import contextlib
import os
import platform
import resource
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, cast

from vcu_gateway import __version__
from vcu_gateway import config as configuration
from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.config import Config
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.schedule import LATENESS_BOUNDS_NS, Schedule, percentile_ns
from vcu_gateway.daemon.loop import LastTick, TickLoop
from vcu_gateway.daemon.reload import Reloader
from vcu_gateway.daemon.restart_state import CountedStart
from vcu_gateway.daemon.tap_socket import RecorderTap
from vcu_gateway.python_can import VERSION
from vcu_gateway.server import views
from vcu_gateway.units import NS_PER_MS, NS_PER_US

_PROC = Path("/proc/self")
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def process_usage() -> results.ProcessUsage:
    """Usage now; None where /proc has no such figure, and where there is no limit."""
    virtual_bytes, resident_bytes = _memory_bytes()
    max_fds, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return {
        "cpu_time_s": time.process_time(),
        "resident_memory_bytes": resident_bytes,
        "virtual_memory_bytes": virtual_bytes,
        "open_fds": _open_fds(),
        "max_fds": None if max_fds == resource.RLIM_INFINITY else max_fds,
    }


def _memory_bytes() -> tuple[int | None, int | None]:
    """Virtual and resident memory."""
    with contextlib.suppress(OSError, ValueError):
        virtual_pages, resident_pages, *_ = (_PROC / "statm").read_text().split()
        return int(virtual_pages) * _PAGE_BYTES, int(resident_pages) * _PAGE_BYTES
    return None, None


def _open_fds() -> int | None:
    with contextlib.suppress(OSError):
        return len(os.listdir(_PROC / "fd"))
    return None


_VERSIONS: results.Versions = {
    "vcu_gateway": __version__,
    "python": platform.python_version(),
    "python_can": VERSION,
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
    start_time_s: float = field(default_factory=time.time)
    tap: RecorderTap | None = None


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
        "link": _link(loop, now_ns),
        "ticks": _ticks(loop.schedule, loop.silent_ticks),
        "frames": _frames(loop),
        "api": api,
        "recorder": _recorder(facts.tap),
        "log_lines_dropped": facts.log_lines_dropped(),
        "process": process_usage(),
        "versions": _VERSIONS,
    }


def _recorder(tap: RecorderTap | None) -> results.RecorderCounts | None:
    return None if tap is None else views.result_of(results.RecorderCounts, tap)


def _link(loop: TickLoop, now_ns: int) -> results.Link:
    link, bus = loop.gateway.link, loop.connection.settings
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


class ServerContext(NamedTuple):
    """Parts of the running program, put together by `app`.

    Attributes:
        api_counts: counters of the API.
    """

    loop: TickLoop
    reloader: Reloader
    facts: RunFacts
    protocol: results.Protocol
    api_counts: Callable[[], results.ApiCounts]

    def latest(self) -> LastTick:
        """Last tick; RequestError before the first."""
        latest = self.loop.latest
        if latest is None:
            raise RequestError(ErrorCode.NOT_READY, "the gateway has not ticked yet; try again")
        return latest


def state(context: ServerContext, messages: list[str] | None) -> results.State:
    """Current state; RequestError for a message that the gateway does not receive."""
    latest = context.latest()
    gateway, now_ns = context.loop.gateway, time.monotonic_ns()
    known = [message.name for message in gateway.snapshot(now_ns).messages] if messages else []
    for name in messages or ():
        if name not in known:
            sentence = f"the gateway receives no message {name[:64]}; it knows {', '.join(known)}"
            raise RequestError(ErrorCode.INVALID_PARAMS, sentence)
    return views.state(gateway, latest, now_ns, messages)


def _health(context: ServerContext, _: methods.Nothing) -> results.Health:
    config = context.reloader.config
    api, now_ns = context.api_counts(), time.monotonic_ns()
    return health(context.loop, config, context.facts, api, now_ns)


def _config(context: ServerContext, _: methods.Nothing) -> results.ConfigInEffect:
    config = context.reloader.config
    return {
        "file": config.source.file,
        "digest": configuration.digest(config),
        "values": configuration.effective(config),
    }


QUERIES: Mapping[str, Callable[[ServerContext, Any], Any]] = {
    "state.get": lambda context, params: state(context, params.messages),
    "why": lambda context, _: views.why(context.latest().why),
    "health": _health,
    "tuning.get": lambda context, _: views.tuning(context.loop.gateway, time.monotonic_ns()),
    "config.get": _config,
    "protocol.get": lambda context, _: context.protocol,
}
"""Handlers by method."""
