"""Metrics of the bus: frames, messages and the link."""

from collections.abc import Callable, Mapping
from typing import get_args

from vcu_gateway.api import results
from vcu_gateway.exporter.family import (
    MS_PER_S,
    Family,
    LabelT,
    Samples,
    by,
    counter,
    gauge,
    of_health,
    of_state,
    one,
    states,
)

_USUAL_UNSENT = ("closed", "late", "ENOBUFS")
"""Exposed before the first of them, so that the first one counts as an increase."""

_LINK_STATES = get_args(results.LinkStateName)


def _frames(name: str, text: str, value: Callable[[results.FrameCounts], float | None]) -> Family:
    """A count without labels."""
    return counter(name, text, of_health(lambda health: one(value(health["frames"]))))


def _frames_by(
    label: str,
    name: str,
    text: str,
    values: Callable[[results.FrameCounts], Mapping[LabelT, float]],
) -> Family:
    """A count for each value of a label."""
    return counter(name, text, of_health(lambda health: by(values(health["frames"]))), label)


def _by_message(state: results.State, value: Callable[[results.Message], float | None]) -> Samples:
    """A sample for each received message; none where the value is None."""
    values = {name: value(message) for name, message in state["messages"].items()}
    return by({name: found for name, found in values.items() if found is not None})


def _age_s(message: results.Message) -> float | None:
    age_ms = message["age_ms"]
    return None if age_ms is None else age_ms / MS_PER_S


FAMILIES: tuple[Family, ...] = (
    _frames(
        "frames_received",
        "Frames that the kernel handed over, own ones that came back included.",
        lambda frames: frames["received"],
    ),
    _frames_by(
        "reason",
        "frames_rejected",
        "Received frames not decoded, by reason.",
        lambda frames: frames["rejected"],
    ),
    _frames(
        "frames_out_of_order",
        "Received frames older than the one of their kind before them; judged, not kept.",
        lambda frames: frames["out_of_order"],
    ),
    _frames(
        "frames_unjudged",
        "Received frames of which a late tick found more than it could judge.",
        lambda frames: frames["unjudged"],
    ),
    _frames(
        "frames_dropped",
        "Frames dropped by the kernel's receive buffer; absent where that cannot be known.",
        lambda frames: frames["dropped"],
    ),
    _frames(
        "receiver_bugs",
        "Exceptions of the receiving code; each cost one frame.",
        lambda frames: frames["receiver_bugs"],
    ),
    _frames("frames_sent", "Command frames that the kernel took.", lambda frames: frames["sent"]),
    _frames_by(
        "reason",
        "frames_unsent",
        "Command frames not sent, by reason.",
        lambda frames: dict.fromkeys(_USUAL_UNSENT, 0) | frames["unsent"],
    ),
    _frames_by(
        "controller",
        "frames_confirmed",
        "Own command frames that came back because they had left.",
        lambda frames: frames["confirmed"],
    ),
    _frames_by(
        "controller",
        "frames_foreign",
        "Command frames of another sender.",
        lambda frames: frames["foreign_commands"],
    ),
    _frames_by(
        "rule",
        "frames_blocked",
        "Command frames that the gate replaced, by the rule that they broke;"
        " absent before the first.",
        lambda frames: frames["blocked_by_gate"],
    ),
    counter(
        "message_frames",
        "Frames taken of each message.",
        of_state(lambda state: _by_message(state, lambda message: message["frame_count"])),
        "message",
    ),
    counter(
        "message_marked_frames",
        "Frames of each message with a signal out of range or saturated.",
        of_state(lambda state: _by_message(state, lambda message: message["marked_count"])),
        "message",
    ),
    gauge(
        "message_age_seconds",
        "Time since the kernel's arrival stamp of the latest frame; absent before the first.",
        of_state(lambda state: _by_message(state, _age_s)),
        "message",
    ),
    gauge(
        "message_stale",
        "1 where the message is too old or never came, else 0.",
        of_state(lambda state: _by_message(state, lambda message: message["stale"])),
        "message",
    ),
    gauge(
        "link_state",
        "1 for the state that the bus interface is in, 0 for the others.",
        of_health(lambda health: states(_LINK_STATES, [health["link"]["state"]])),
        "state",
    ),
    gauge(
        "link_state_seconds",
        "How long the bus interface has been in its state.",
        of_health(lambda health: one(max(0.0, health["link"]["since_ms"] / MS_PER_S))),
    ),
)
"""In the order of the text."""
