"""Core lines that must be on the disk at once, and those that are the reason of an incident."""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from vcu_gateway.recording.datagram import may_be_urgent

FAULT_LATCHED = "fault_latched"
EMERGENCY_STOP = "emergency_stop"
RESTARTED_UNEXPECTEDLY = "restarted_unexpectedly"

_BEFORE_THIS_START = "before this start: "
"""Begin of the reason of a fault that the gateway before had latched (daemon.restart_state)."""
_LONGEST_KIND = 40
_LONGEST_REASON = 200


class Trigger(NamedTuple):
    """Reason of an incident.

    Attributes:
        reason: one of the three words above, or `layout.REQUESTED`.
        kind: word for like ones, plain and short: the cause of a latched fault, else the reason.
        what: sentence for people.
    """

    reason: str
    kind: str
    what: str


class Noticed(NamedTuple):
    """What core lines ask of the recorder: `urgent` ones are written and synced at once."""

    urgent: bool
    triggers: tuple[Trigger, ...]


def noticed(lines: bytes) -> Noticed:
    """Reasons among these core lines; damaged lines are none."""
    found = [_noticed(values) for line in lines.splitlines() if (values := _values(line))]
    triggers = tuple(trigger for one in found for trigger in one.triggers)
    return Noticed(any(one.urgent for one in found), triggers)


def _values(line: bytes) -> Mapping[str, Any] | None:
    if not may_be_urgent(line) or line.startswith(b'{"checkpoint":'):
        return None
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None


def _noticed(values: Mapping[str, Any]) -> Noticed:
    if "estop" in values:
        return Noticed(True, (Trigger(EMERGENCY_STOP, EMERGENCY_STOP, "emergency stop"),))
    if restarts := values.get("restarted"):
        count = str(restarts)[:20]
        what = f"the gateway restarted unexpectedly, {count} times in this drive"
        return Noticed(True, (Trigger(RESTARTED_UNEXPECTEDLY, RESTARTED_UNEXPECTEDLY, what),))
    triggers = tuple(_latched(values.get("events")))
    return Noticed("mode" in values or bool(triggers), triggers)


def _latched(events: Any) -> Iterator[Trigger]:
    """A trigger for each fault that was latched; named by the cause that stopped the vehicle."""
    events = events if isinstance(events, list) else []
    described = [
        one
        for one in events
        if isinstance(one, list) and len(one) == 3 and isinstance(one[2], dict)
    ]
    for name, _, fields in described:
        if name == FAULT_LATCHED:
            reason = str(fields.get("reason", ""))[:_LONGEST_REASON]
            reason = "".join(one if one.isprintable() else "?" for one in reason)
            yield Trigger(FAULT_LATCHED, _cause(described, reason), f"fault latched: {reason}")


def _cause(events: list[list[Any]], reason: str) -> str:
    is_kept = reason.startswith(_BEFORE_THIS_START)
    for name, _, fields in events:
        stops = name == "cause_began" and str(fields.get("effect")) in ("stop", "cut")
        if stops and not is_kept:  # what began now is not why the gateway before had latched
            cause, subject = str(fields.get("cause")), str(fields.get("subject") or "")
            # A code that a signal has is told by the signal.
            return _word(subject.rpartition(".")[2] if cause == "code" and subject else cause)
    first = reason.removeprefix(_BEFORE_THIS_START).partition(":")[0]
    words = "_".join(re.findall(r"[a-z]+", first.lower())[:5])
    return EMERGENCY_STOP if words.startswith(EMERGENCY_STOP) else _word(words)


def _word(text: str) -> str:
    """A kind that can be in the name of a folder."""
    return re.sub(r"[^0-9A-Za-z_-]", "_", text)[:_LONGEST_KIND] or FAULT_LATCHED
