"""How the gateway itself fares: ticks, API, log, and what is running."""

from itertools import accumulate

from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.core.schedule import LATENESS_BOUNDS_NS
from vcu_gateway.exporter.family import (
    NS_PER_S,
    PREFIX,
    Family,
    Instant,
    Samples,
    by,
    counter,
    gauge,
    one,
)

_BOUNDS_S = (*(str(bound_ns / NS_PER_S) for bound_ns in LATENESS_BOUNDS_NS), "+Inf")


def _lateness(at: Instant) -> Samples:
    """Cumulative, as Prometheus counts; there is no sum of all latenesses to expose."""
    counts = tuple(at.daemon.schedule.lateness_counts)
    return by(dict(zip(_BOUNDS_S, accumulate(counts), strict=True)))


def _errors(at: Instant) -> Samples:
    """Every code from the start on, so that the first error counts as an increase."""
    return by(dict.fromkeys((code.name.lower() for code in ErrorCode), 0) | at.api["errors"])


def _config(at: Instant) -> Samples:
    return {(at.facts.config_digest(), at.facts.protocol_digest): 1}


FAMILIES: tuple[Family, ...] = (
    counter("ticks", "Ticks done.", lambda at: one(at.daemon.schedule.ticks)),
    counter(
        "ticks_skipped",
        "Points of the grid that were missed; never made up.",
        lambda at: one(at.daemon.schedule.skipped),
    ),
    counter(
        "ticks_silent",
        "Ticks that sent nothing, listening before talking.",
        lambda at: one(at.daemon.silent_ticks),
    ),
    gauge(
        "tick_period_seconds",
        "Period of the command frames.",
        lambda at: one(at.daemon.schedule.period_ns / NS_PER_S),
    ),
    Family(
        f"{PREFIX}tick_lateness_seconds",
        "histogram",
        "How late each tick began; no _sum.",
        ("le",),
        _lateness,
    ),
    gauge("api_clients", "Clients connected now.", lambda at: one(at.api["clients"])),
    counter("api_connections", "Connections accepted.", lambda at: one(at.api["accepted"])),
    counter(
        "api_connections_turned_away",
        "Connections beyond the limit on clients.",
        lambda at: one(at.api["turned_away"]),
    ),
    counter(
        "api_connections_closed",
        "Connections that the gateway ended, by reason; absent before the first.",
        lambda at: by(at.api["closed"]),
        "reason",
    ),
    counter(
        "api_connections_gave_way",
        "Idle connections that the gateway ended because a new one needed their place.",
        lambda at: one(at.api["gave_way"]),
    ),
    counter("api_requests", "Requests received.", lambda at: one(at.api["requests"])),
    counter(
        "api_errors",
        "Answers that were errors, by the word of their code.",
        _errors,
        "code",
    ),
    counter(
        "api_stopped_anyway",
        "Requests of estop and disarm that were wrong in form, and done all the same.",
        lambda at: one(at.api["stopped_anyway"]),
    ),
    counter(
        "api_lost_updates",
        "Notifications that a slow reader did not get.",
        lambda at: one(at.api["lost_updates"]),
    ),
    counter(
        "log_lines_dropped",
        "Log lines lost because nobody took them.",
        lambda at: one(at.facts.log_lines_dropped()),
    ),
    counter(
        "starts",
        "Starts since the machine booted, this one included; absent where they are not counted.",
        lambda at: one(at.facts.starts),
    ),
    gauge(
        "start_time_seconds",
        "When the gateway started, seconds since 1970 by the clock as it was then.",
        lambda at: one(at.facts.started_s),
    ),
    gauge(
        "uptime_seconds",
        "How long the gateway has been running, whatever was done to the clock.",
        lambda at: one(at.since_s(at.facts.started_ns)),
    ),
    gauge(
        "build_info",
        "What is running; always 1.",
        lambda at: {(at.facts.version, at.facts.python): 1},
        "version",
        "python",
    ),
    gauge(
        "config_info",
        "Configuration and protocol in effect, by digest; always 1.",
        _config,
        "config_digest",
        "protocol_digest",
    ),
)
"""Everything that tells of the program."""
