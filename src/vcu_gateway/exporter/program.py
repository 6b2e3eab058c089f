"""Metrics of the gateway beside the vehicle: bus, ticks, API, log, configuration and process."""

from collections.abc import Callable, Iterable
from functools import partial
from itertools import accumulate
from typing import Any, cast, get_args

from vcu_gateway.api import results
from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.exporter.family import (
    MS_PER_S,
    PREFIX,
    US_PER_S,
    Family,
    Kind,
    Read,
    Samples,
    by,
    counter,
    gauge,
    of_health,
    of_state,
    one,
    states,
)

# Exposed from the start on, so that the first one counts as an increase.
_USUAL_UNSENT = ("closed", "late", "ENOBUFS")
_ERRORS = tuple(code.name.lower() for code in ErrorCode)

_LINK_STATES = get_args(results.LinkStateName)


def _at(section: str, key: str, by_label: bool = False, known: Iterable[str] = ()) -> Read:
    """The number at a key of a section of `health`, or the numbers by the words of a label."""

    def samples(health: results.Health) -> Samples:
        found = cast(Any, health)[section][key]
        return by(dict.fromkeys(known, 0) | found) if by_label else one(found)

    return of_health(samples)


def _count(
    section: str, key: str, text: str, label: str = "", name: str = "", known: Iterable[str] = ()
) -> Family:
    """Counter at a key of a section of `health`.

    Args:
        section: of `health`.
        key: of the count, or of the counts by `label`.
        text: help.
        label: empty for a single count.
        name: SECTION_KEY, where not given.
        known: words of the label that are exposed before they are counted.
    """
    labels = (label,) if label else ()
    read = _at(section, key, bool(label), known)
    return counter(name or f"{section}_{key}", text, read, *labels)


_frames, _ticks, _api = (partial(_count, section) for section in ("frames", "ticks", "api"))


def _message(
    kind: Callable[..., Family],
    name: str,
    text: str,
    value: Callable[[results.Message], float | None],
) -> Family:
    """A sample for each received message; none where the value is None."""
    read = of_state(lambda state: by({n: value(one) for n, one in state["messages"].items()}))
    return kind(f"message_{name}", text, read, "message")


def _age_s(message: results.Message) -> float | None:
    age_ms = message["age_ms"]
    return None if age_ms is None else age_ms / MS_PER_S


def _lateness(health: results.Health) -> Samples:
    """Cumulative counts, as Prometheus has them; the gateway keeps no sum."""
    bins = health["ticks"]["lateness_histogram"]
    bounds_us = [one_bin["up_to_us"] for one_bin in bins]
    labels = ["+Inf" if bound is None else str(bound / US_PER_S) for bound in bounds_us]
    return by(dict(zip(labels, accumulate(one_bin["ticks"] for one_bin in bins), strict=True)))


def _of(name: str, text: str, value: Callable[[results.Health], float | None]) -> Family:
    return gauge(name, text, of_health(lambda health: one(value(health))))


def _build(health: results.Health) -> Samples:
    versions = health["versions"]
    return {(versions["vcu_gateway"], versions["python"]): 1}


def _process(name: str, text: str, key: str = "", kind: Kind = "gauge") -> Family:
    """Named and described as prometheus_client's own."""
    return Family(f"process_{name}", kind, text, (), _at("process", key or name))


FAMILIES: tuple[Family, ...] = (
    _frames("received", "Frames that the kernel handed over, own ones that came back included."),
    _frames(
        "rejected", "Received frames not decoded, or no demand of the pedals, by reason.", "reason"
    ),
    _frames(
        "out_of_order",
        "Received frames older than the one of their kind before them; judged, not kept.",
    ),
    _frames("unjudged", "Received frames of which a late tick found more than it could judge."),
    _frames(
        "dropped",
        "Frames dropped by the kernel's receive buffer; absent where that cannot be known.",
    ),
    _frames(
        "receiver_bugs",
        "Exceptions of the receiving code; each cost one frame.",
        name="receiver_bugs",
    ),
    _frames("sent", "Command frames that the kernel took."),
    _frames("unsent", "Command frames not sent, by reason.", "reason", known=_USUAL_UNSENT),
    _frames("confirmed", "Own command frames that came back because they had left.", "controller"),
    _frames(
        "foreign_commands", "Command frames of another sender.", "controller", "frames_foreign"
    ),
    _frames(
        "blocked_by_gate",
        "Command frames that the gate replaced, by the rule that they broke;"
        " absent before the first.",
        "rule",
        "frames_blocked",
    ),
    _message(counter, "frames", "Frames taken of each message.", lambda one: one["frame_count"]),
    _message(
        counter,
        "marked_frames",
        "Frames of each message with a signal out of range or saturated.",
        lambda one: one["marked_count"],
    ),
    _message(
        gauge,
        "age_seconds",
        "Time since the kernel's arrival stamp of the latest frame; absent before the first.",
        _age_s,
    ),
    _message(
        gauge,
        "stale",
        "1 where the message is too old or never came, else 0.",
        lambda one: one["stale"],
    ),
    gauge(
        "link_state",
        "1 for the state that the bus interface is in, 0 for the others.",
        of_health(lambda health: states(_LINK_STATES, [health["link"]["state"]])),
        "state",
    ),
    _of(
        "link_state_seconds",
        "How long the bus interface has been in its state.",
        lambda health: max(0.0, health["link"]["since_ms"] / MS_PER_S),
    ),
    gauge(
        "up",
        "1 where the gateway answered at this reading, else 0; then all others are absent.",
        lambda reading: one(float(reading.health is not None)),
    ),
    _ticks("done", "Ticks done.", name="ticks"),
    _ticks("skipped", "Points of the grid that were missed; never made up."),
    _ticks("silent", "Ticks that sent nothing, listening before talking."),
    _of(
        "tick_period_seconds",
        "Period of the command frames.",
        lambda health: health["ticks"]["period_ms"] / MS_PER_S,
    ),
    Family(
        f"{PREFIX}tick_lateness_seconds",
        "histogram",
        "How late each tick began; no _sum.",
        ("le",),
        of_health(_lateness),
    ),
    _of("api_clients", "Clients connected now.", lambda health: health["api"]["clients"]),
    _api("accepted", "Connections accepted.", name="api_connections"),
    _api(
        "turned_away",
        "Connections beyond the limit on clients.",
        name="api_connections_turned_away",
    ),
    _api(
        "closed",
        "Connections that the gateway ended, by reason; absent before the first.",
        "reason",
        "api_connections_closed",
    ),
    _api(
        "gave_way",
        "Idle connections that the gateway ended because a new one needed their place.",
        name="api_connections_gave_way",
    ),
    _api("requests", "Requests received."),
    _api("errors", "Answers that were errors, by the word of their code.", "code", known=_ERRORS),
    _api(
        "stopped_anyway",
        "Requests of estop and disarm that were wrong in form, and done all the same.",
    ),
    _api("lost_updates", "Notifications that a slow reader did not get."),
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
    _of(
        "start_time_seconds",
        "When the gateway started, seconds since 1970 by the clock as it was then.",
        lambda health: health["start_time_s"],
    ),
    _of(
        "uptime_seconds",
        "How long the gateway has been running, whatever was done to the clock.",
        lambda health: health["uptime_ms"] / MS_PER_S,
    ),
    gauge("build_info", "What is running; always 1.", of_health(_build), "version", "python"),
    gauge(
        "config_info",
        "Configuration and protocol in effect, by digest; always 1.",
        of_health(lambda health: {(health["config_digest"], health["protocol_digest"]): 1}),
        "config_digest",
        "protocol_digest",
    ),
    _process("virtual_memory_bytes", "Virtual memory size in bytes."),
    _process("resident_memory_bytes", "Resident memory size in bytes."),
    Family(
        "process_start_time_seconds",
        "gauge",
        "Start time of the process since unix epoch in seconds.",
        (),
        of_health(lambda health: one(health["start_time_s"])),
    ),
    _process(
        "cpu_seconds_total",
        "Total user and system CPU time spent in seconds.",
        "cpu_time_s",
        "counter",
    ),
    _process("open_fds", "Number of open file descriptors."),
    _process("max_fds", "Maximum number of open file descriptors."),
)
