"""What the gateway knows and does as plain data, in the API's shapes."""

from collections.abc import Iterable
from typing import Any, cast, get_args

from vcu_gateway.api import results
from vcu_gateway.core import why as explanation
from vcu_gateway.core.causes import HeldCause
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.snapshot import Reading
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.daemon.loop import LastTick
from vcu_gateway.units import NS_PER_MS

_CONTROLLERS: tuple[results.ControllerName, ...] = get_args(results.ControllerName)


def state(
    snapshot: Snapshot, latest: LastTick, names: Iterable[str] | None = None
) -> results.State:
    """What is known at the snapshot's instant, and what was commanded in the last tick.

    `names` are the messages to tell, None all; KeyError for one that the store does not keep.
    """
    return {
        "monotonic_ns": snapshot.now_ns,
        "mode": mode_name(latest.why.mode),
        "messages": messages(snapshot, names),
        "commands": commands(latest.result),
    }


def messages(snapshot: Snapshot, names: Iterable[str] | None = None) -> dict[str, results.Message]:
    """Received messages by name, in the protocol's order or in that of `names`."""
    known = [message.name for message in snapshot.messages]
    return {name: _message(snapshot, name) for name in (known if names is None else names)}


def _message(snapshot: Snapshot, name: str) -> results.Message:
    readings, latest = snapshot.readings(name), snapshot.latest(name)
    return {
        "frame_count": latest.frame_count if latest else 0,
        "marked_count": latest.marked_count if latest else 0,
        "age_ms": milliseconds(snapshot.age_ns(name)),
        "period_ms": milliseconds(latest.period_ns if latest else None),
        "stale": snapshot.stale(name),
        "signals": {reading.name: _signal(reading) for reading in readings},
    }


def _signal(reading: Reading) -> results.Signal:
    signal: results.Signal = {
        "value": reading.value,
        "raw": reading.raw,
        "unit": reading.unit,
        "quality": reading.quality.value,
    }
    if reading.code_name is not None:
        signal["name"] = reading.code_name
    return signal


def commands(result: TickResult) -> dict[results.ControllerName, results.SentCommand]:
    """What each controller was told in this tick."""
    frames = {frame.controller: frame for frame in result.frames}
    told: dict[results.ControllerName, results.SentCommand] = {}
    for name in _CONTROLLERS:
        command, frame = result.commands[name], frames.get(name)
        told[name] = {
            "throttle_pct": command.throttle_pct,
            "brake_pct": command.brake_pct,
            "power_mode": cast(results.PowerModeName, command.power_mode.name.lower()),
            "motor_reverse": command.motor_reverse,
            "regen_brake": command.regen_brake,
            "power_cut": command.power_cut,
            "speed_limit_rpm": command.speed_limit_rpm,
            "power_limit_w": command.power_limit_w,
            "frame": f"{frame.can_id:08X}#{frame.data.hex().upper()}" if frame else None,
        }
    return told


def why(answer: explanation.Explanation) -> results.Why:
    """The answer of `why` as data; ages are those at its own instant."""
    now_ns, latch = answer.now_ns, answer.latch
    return {
        "sentence": answer.sentence(),
        "mode": mode_name(answer.mode),
        "latch": None
        if latch is None
        else {
            "fault_class": latch.fault_class.value,
            "reason": latch.reason,
            "since_ms": _since(now_ns, latch.since_ns),
        },
        "blocks": [_cause(held, answer) for held in answer.blocks],
        "limits": [_cause(held, answer) for held in answer.limits],
        "alarms": [_cause(held, answer) for held in answer.alarms],
        "waits": list(answer.waits),
        "demand": None
        if answer.demand_source is None
        else {
            "source": answer.demand_source,
            "age_ms": milliseconds(answer.demand_age_ns),
            "ttl_ms": answer.demand_ttl_ms,
            "fresh": answer.demand_fresh,
        },
        "next_step": answer.next_step,
    }


def _cause(held: HeldCause, answer: explanation.Explanation) -> results.Cause:
    finding = held.finding
    return {
        "cause": finding.cause,
        "subject": finding.subject,
        "detail": finding.detail,
        "effect": finding.effect.value,
        "since_ms": _since(answer.now_ns, held.since_ns),
        "stands": held.stands(answer.judged_ns),
    }


def mode_name(mode: Mode) -> results.ModeName:
    """The API's word for a mode."""
    return mode.value


def milliseconds(duration_ns: int | None) -> float | None:
    """A duration as the API has it, to the microsecond."""
    return None if duration_ns is None else round(duration_ns / NS_PER_MS, 3)


def _since(now_ns: int, since_ns: int) -> float:
    return round((now_ns - since_ns) / NS_PER_MS, 3)


def counters(gateway: Gateway) -> dict[str, Any]:
    """What was received and not decoded, confirmed, sent by somebody else, or blocked."""
    intake = gateway.intake
    return {
        "rejected": {reason.value: count for reason, count in intake.rejected.items()},
        "out_of_order": intake.store.out_of_order,
        "unjudged": intake.store.unjudged,
        "confirmed": dict(intake.confirmed),
        "foreign_commands": dict(intake.foreign_commands),
        "blocked_by_gate": dict(gateway.output.gate.blocked),
    }
