"""The state as plain data, for files and other programs."""

from typing import Any

from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.state import Reading, Snapshot

_NS_PER_MS = 1_000_000


def state(snapshot: Snapshot) -> dict[str, Any]:
    """Every message by name: frame_count, age_ms, period_ms, stale, and its signals."""
    return {message.name: _message(snapshot, message.name) for message in snapshot.messages}


def _message(snapshot: Snapshot, name: str) -> dict[str, Any]:
    latest = snapshot.latest(name)
    return {
        "frame_count": latest.frame_count if latest else 0,
        "marked_count": latest.marked_count if latest else 0,
        "age_ms": _milliseconds(snapshot.age_ns(name)),
        "period_ms": _milliseconds(latest.period_ns if latest else None),
        "stale": snapshot.stale(name),
        "signals": {reading.name: _signal(reading) for reading in snapshot.readings(name)},
    }


def _signal(reading: Reading) -> dict[str, Any]:
    signal: dict[str, Any] = {
        "value": reading.value,
        "unit": reading.unit,
        "raw": reading.raw,
        "quality": reading.quality.value,
    }
    if reading.code_name is not None:
        signal["name"] = reading.code_name
    return signal


def _milliseconds(duration_ns: int | None) -> float | None:
    return None if duration_ns is None else duration_ns / _NS_PER_MS


def counters(gateway: Gateway) -> dict[str, Any]:
    """What was received and not decoded, confirmed, sent by somebody else, or blocked."""
    intake = gateway.intake
    return {
        "rejected": {reason.value: count for reason, count in intake.rejected.items()},
        "out_of_order": intake.store.out_of_order,
        "confirmed": dict(intake.confirmed),
        "foreign_commands": dict(intake.foreign_commands),
        "blocked_by_gate": dict(gateway.output.gate.blocked),
    }
