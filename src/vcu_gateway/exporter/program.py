"""Metrics of the gateway itself: reachability, ticks, API, log, versions and configuration."""

from collections.abc import Callable, Mapping
from itertools import accumulate

from vcu_gateway.api import results
from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.exporter.family import (
    MS_PER_S,
    PREFIX,
    US_PER_S,
    Family,
    Samples,
    by,
    counter,
    gauge,
    of_health,
    one,
)


def _lateness(health: results.Health) -> Samples:
    """Cumulative counts, as Prometheus has them; the gateway keeps no sum."""
    bins = health["ticks"]["lateness_histogram"]
    bounds_us = [one_bin["up_to_us"] for one_bin in bins]
    labels = ["+Inf" if bound is None else str(bound / US_PER_S) for bound in bounds_us]
    return by(dict(zip(labels, accumulate(one_bin["ticks"] for one_bin in bins), strict=True)))


def _errors(api: results.ApiCounts) -> Mapping[str, float]:
    """Every code from the start on, so that the first error counts as an increase."""
    return dict.fromkeys((code.name.lower() for code in ErrorCode), 0) | api["errors"]


def _build(health: results.Health) -> Samples:
    versions = health["versions"]
    return {(versions["vcu_gateway"], versions["python"]): 1}


def _ticks(name: str, text: str, value: Callable[[results.Ticks], float]) -> Family:
    return counter(name, text, of_health(lambda health: one(value(health["ticks"]))))


def _api(name: str, text: str, value: Callable[[results.ApiCounts], float]) -> Family:
    return counter(f"api_{name}", text, of_health(lambda health: one(value(health["api"]))))


def _api_by(
    label: str, name: str, text: str, values: Callable[[results.ApiCounts], Mapping[str, float]]
) -> Family:
    return counter(f"api_{name}", text, of_health(lambda health: by(values(health["api"]))), label)


FAMILIES: tuple[Family, ...] = (
    gauge(
        "up",
        "1 where the gateway answered at this reading, else 0; then all others are absent.",
        lambda reading: one(float(reading.health is not None)),
    ),
    _ticks("ticks", "Ticks done.", lambda ticks: ticks["done"]),
    _ticks(
        "ticks_skipped",
        "Points of the grid that were missed; never made up.",
        lambda ticks: ticks["skipped"],
    ),
    _ticks(
        "ticks_silent",
        "Ticks that sent nothing, listening before talking.",
        lambda ticks: ticks["silent"],
    ),
    gauge(
        "tick_period_seconds",
        "Period of the command frames.",
        of_health(lambda health: one(health["ticks"]["period_ms"] / MS_PER_S)),
    ),
    Family(
        f"{PREFIX}tick_lateness_seconds",
        "histogram",
        "How late each tick began; no _sum.",
        ("le",),
        of_health(_lateness),
    ),
    gauge(
        "api_clients",
        "Clients connected now.",
        of_health(lambda health: one(health["api"]["clients"])),
    ),
    _api("connections", "Connections accepted.", lambda api: api["accepted"]),
    _api(
        "connections_turned_away",
        "Connections beyond the limit on clients.",
        lambda api: api["turned_away"],
    ),
    _api_by(
        "reason",
        "connections_closed",
        "Connections that the gateway ended, by reason; absent before the first.",
        lambda api: api["closed"],
    ),
    _api(
        "connections_gave_way",
        "Idle connections that the gateway ended because a new one needed their place.",
        lambda api: api["gave_way"],
    ),
    _api("requests", "Requests received.", lambda api: api["requests"]),
    _api_by("code", "errors", "Answers that were errors, by the word of their code.", _errors),
    _api(
        "stopped_anyway",
        "Requests of estop and disarm that were wrong in form, and done all the same.",
        lambda api: api["stopped_anyway"],
    ),
    _api(
        "lost_updates",
        "Notifications that a slow reader did not get.",
        lambda api: api["lost_updates"],
    ),
    counter(
        "log_lines_dropped",
        "Log lines lost because nobody took them.",
        of_health(lambda health: one(health["log_lines_dropped"])),
    ),
    counter(
        "starts",
        "Starts since the machine booted, this one included; absent where they are not counted.",
        of_health(lambda health: one(health["starts"])),
    ),
    gauge(
        "start_time_seconds",
        "When the gateway started, seconds since 1970 by the clock as it was then.",
        of_health(lambda health: one(health["start_time_s"])),
    ),
    gauge(
        "uptime_seconds",
        "How long the gateway has been running, whatever was done to the clock.",
        of_health(lambda health: one(health["uptime_ms"] / MS_PER_S)),
    ),
    gauge("build_info", "What is running; always 1.", of_health(_build), "version", "python"),
    gauge(
        "config_info",
        "Configuration and protocol in effect, by digest; always 1.",
        of_health(lambda health: {(health["config_digest"], health["protocol_digest"]): 1}),
        "config_digest",
        "protocol_digest",
    ),
)
"""In the order of the text."""
