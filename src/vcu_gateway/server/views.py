"""State, commands, `why` and protocol as the API's results."""

import math
from collections.abc import Iterable
from typing import Any, TypeVar, cast, get_args

from vcu_gateway.api import results
from vcu_gateway.core import why as explanation
from vcu_gateway.core.causes import HeldCause
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import RELEASED_PCT, Demand
from vcu_gateway.core.deratings import CurveState
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.core.state import Reading, Snapshot
from vcu_gateway.core.stop import Stop
from vcu_gateway.core.summary import summary
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.tuning import DERATINGS, LIMITS
from vcu_gateway.daemon.loop import LastTick
from vcu_gateway.units import NS_PER_MS

Result = TypeVar("Result")

_CONTROLLERS: tuple[results.ControllerName, ...] = get_args(results.ControllerName)


def result_of(shape: type[Result], source: object, **others: Any) -> Result:
    """Result of this shape: `others`, and what its source has under the names of the rest."""
    names = shape.__annotations__
    values = {name: others[name] if name in others else getattr(source, name) for name in names}
    return cast(Result, values)


def state(
    gateway: Gateway,
    latest: LastTick,
    now_ns: int,
    names: Iterable[str] | None = None,
) -> results.State:
    """Messages and what was sent at this instant; demand, commands and stop of the last tick.

    From any thread. `names` are the messages to report, None all; KeyError for one that the store
    does not keep.
    """
    snapshot = gateway.snapshot(now_ns)
    demand = gateway.requests.arbiter.current
    fresh_demand = demand if latest.reasons.demand_fresh else None
    return {
        "monotonic_ns": snapshot.now_ns,
        "mode": latest.reasons.mode.value,
        "messages": messages(snapshot, names),
        "commands": _commands(gateway, latest, now_ns),
        "demanded": {} if fresh_demand is None else _demanded(fresh_demand),
        "stop": None if latest.stop is None else _stop(latest.stop, now_ns),
    }


def _demanded(demand: Demand) -> dict[results.ControllerName, results.DemandedValues]:
    values = demand.controllers
    return {name: result_of(results.DemandedValues, values[name]) for name in _CONTROLLERS}


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


def _commands(
    gateway: Gateway, latest: LastTick, now_ns: int
) -> dict[results.ControllerName, results.ControllerCommand]:
    """Command to each controller in the last tick, and the last frames that left for it."""
    decided = {one.controller: _candump(one.can_id, one.data) for one in latest.result.frames}
    return {
        name: result_of(
            results.ControllerCommand,
            command := latest.result.commands[name],
            power_mode=command.power_mode.name.lower(),
            decided=decided.get(name),
            sent=_sent(gateway, name, now_ns),
            echoed=_echoed(gateway, name, now_ns),
        )
        for name in _CONTROLLERS
    }


def _sent(gateway: Gateway, controller: str, now_ns: int) -> results.CarriedFrame | None:
    taken = gateway.transmitter.taken.get(controller)
    if taken is None:
        return None
    frame = _candump(taken.frame.can_id, taken.frame.data)
    return {"frame": frame, "age_ms": _since(now_ns, taken.at_ns)}


def _echoed(gateway: Gateway, controller: str, now_ns: int) -> results.CarriedFrame | None:
    echo = gateway.receiver.echoes.get(controller)
    if echo is None:
        return None
    return {"frame": _candump(echo.can_id, echo.data), "age_ms": _since(now_ns, echo.arrival_ns)}


def _candump(can_id: int, data: bytes | bytearray) -> str:
    return f"{can_id:08X}#{data.hex().upper()}"


def _stop(stop: Stop, now_ns: int) -> results.StopState:
    """What is known of a stop; ages are those at this instant."""
    return {
        "latched_ms": _since(now_ns, stop.latched_ns),
        "reason": stop.reason,
        "stage": stop.stage.value,
        "sentence": stop.sentence(),
        "controllers": {name: _controller_stop(stop, name, now_ns) for name in _CONTROLLERS},
    }


def _controller_stop(stop: Stop, controller: str, now_ns: int) -> results.ControllerStopState:
    one = stop.controllers[controller]
    return result_of(
        results.ControllerStopState,
        one,
        sent_ms=_age(now_ns, one.sent_ns),
        echoed_ms=_age(now_ns, one.echoed_ns),
        judged_ms=_age(now_ns, one.judged_ns),
        missing=stop.missing(controller),
    )


def why(explained: explanation.Explanation) -> results.Why:
    """Result of `why`; ages are those at the explanation's instant."""
    now_ns, latch = explained.now_ns, explained.latch
    return {
        "sentence": explained.sentence(),
        "summary": summary(explained),
        "mode": explained.mode.value,
        "latch": None
        if latch is None
        else {
            "fault_class": latch.fault_class.value,
            "reason": latch.reason,
            "since_ms": _since(now_ns, latch.since_ns),
        },
        "blocks": [_cause(held, explained) for held in explained.blocks],
        "limits": [_cause(held, explained) for held in explained.limits],
        "alarms": [_cause(held, explained) for held in explained.alarms],
        "waits": list(explained.waits),
        "demand": None
        if explained.demand_source is None
        else {
            "source": explained.demand_source,
            "age_ms": milliseconds(explained.demand_age_ns),
            "ttl_ms": explained.demand_ttl_ms,
            "fresh": explained.demand_fresh,
        },
        "next_step": explained.next_step,
    }


def _cause(held: HeldCause, explained: explanation.Explanation) -> results.Cause:
    finding = held.finding
    return result_of(
        results.Cause,
        finding,
        effect=finding.effect.value,
        since_ms=_since(explained.now_ns, held.since_ns),
        stands=held.stands(explained.judged_ns),
    )


def tuning(gateway: Gateway, now_ns: int) -> results.TuningNow:
    """Drive mode, curves and slip limiter in the last tick, and the pedals; from any thread."""
    settings = gateway.settings.tuning
    current, requested = gateway.drive_modes
    drive_mode: results.DriveModeNow | None = None
    if current is not None and requested is not None:
        drive_mode = {
            "current": current,
            "requested": requested,
            "modes": list(settings.modes),
            "left_by_service": [n for n, one in settings.modes.items() if one.left_by_service],
        }
    slip_pct = dict(gateway.slip_caps_pct)
    return {
        "drive_mode": drive_mode,
        "curves": [_curve(one, settings.curves[one.name]) for one in gateway.curves],
        "slip_throttle_max_pct": None
        if settings.slip is None
        else {name: slip_pct[name] for name in _CONTROLLERS},
        "pedals": _pedals(gateway, now_ns),
    }


def _pedals(gateway: Gateway, now_ns: int) -> results.PedalsNow | None:
    pedals = gateway.requests.pedal_frames.now(now_ns, gateway.settings.period_ns)
    if pedals is None:
        return None
    return result_of(
        results.PedalsNow,
        pedals,
        throttle_track2_pct=pedals.track2_pct,
        doubts=list(pedals.doubts),
        sentence=pedals.sentence(),
    )


def waits_for_release(gateway: Gateway, now_ns: int) -> bool:
    """Whether the drive mode that was asked for waits, with the demand as it is now."""
    current, requested = gateway.drive_modes
    if current == requested or gateway.mode is not Mode.ACTIVE:
        return False
    demanded = gateway.requests.demanded(now_ns) or {}
    return any(one.throttle_pct >= RELEASED_PCT for one in demanded.values())


def _curve(state: CurveState, curve: Curve) -> results.CurveNow:
    derating = DERATINGS[state.name]
    quantity = derating.input.quantity
    return {
        "key": derating.key,
        "input": quantity.text,
        "input_unit": quantity.unit,
        "cap_unit": LIMITS[derating.limit].unit,
        "points": [list(point) for point in curve.points],
        "x": state.x,
        "cap": state.cap if state.cap is None or math.isfinite(state.cap) else None,
        "limits": state.cap is not None and state.cap < curve.highest,
    }


def milliseconds(duration_ns: int | None) -> float | None:
    """Duration in milliseconds, to the microsecond; None stays None."""
    return None if duration_ns is None else round(duration_ns / NS_PER_MS, 3)


def _since(now_ns: int, since_ns: int) -> float:
    """Age in milliseconds; never below 0, where something came after `now_ns` was read."""
    return round(max(0, now_ns - since_ns) / NS_PER_MS, 3)


def _age(now_ns: int, since_ns: int | None) -> float | None:
    return None if since_ns is None else _since(now_ns, since_ns)


def counters(gateway: Gateway) -> dict[str, Any]:
    """Frames rejected, out of order, unjudged, confirmed, foreign and blocked, by reason."""
    counts = gateway.counters
    rejected = {reason.value: count for reason, count in counts.rejected.items()}
    return counts._asdict() | {"rejected": rejected}


def definition(protocol: ProtocolSpec, digest: str) -> results.Protocol:
    """Result of `protocol.get`: every message and signal."""
    return {
        "digest": digest,
        "messages": [_message_definition(message) for message in protocol.messages],
        "aliases": {f"0x{can_id:08X}": name for can_id, name in protocol.aliases.items()},
    }


def _message_definition(message: MessageSpec) -> results.MessageDefinition:
    return result_of(
        results.MessageDefinition,
        message,
        can_id=f"0x{message.can_id:08X}",
        receivers=list(message.receivers),
        signals=[_signal_definition(signal) for signal in message.signals],
    )


def _signal_definition(signal: SignalSpec) -> results.SignalDefinition:
    names = {str(code): name for code, name in signal.names.items()}
    return result_of(results.SignalDefinition, signal, names=names)
