"""Methods that ask for something: carried out on the ticking thread, between its ticks."""

import time
from collections.abc import Callable, Mapping
from typing import Any, cast

from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.core.demand import (
    CONTROLLERS,
    ControllerDemand,
    Demand,
    PowerMode,
    Refusal,
    RequestResult,
)
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.daemon.event_log import LoggedEvent
from vcu_gateway.server import views
from vcu_gateway.server.context import ServerContext
from vcu_gateway.server.service import Caller
from vcu_gateway.server.sources import Sources
from vcu_gateway.units import NS_PER_MS


class CommandHandlers:
    """Carries requests out; belongs to the ticking thread."""

    def __init__(self, program: ServerContext) -> None:
        self._program = program
        self._requests = program.daemon.gateway.requests
        self._sources = Sources()

    def carry_out(self, method: str, params: Any, caller: Caller) -> Mapping[str, Any]:
        """The result; Failure where the request is refused."""
        result: Mapping[str, Any] = _ASKING[method](self, params, caller)
        return result

    def owns_demand(self, caller: Caller) -> bool:
        """True while a fresh demand of this connection counts; from any thread."""
        desk = self._requests.desk
        demand = desk.current
        if demand is None or not desk.fresh(time.monotonic_ns()):
            return False
        return self._sources.owner_of(demand.source) == caller.connection

    def end_demands_of(self, caller: Caller) -> None:
        """The connection has ended, and its demand with it."""
        for source in self._sources.forget(caller.connection):
            self._requests.end_demand(source, time.monotonic_ns())

    def set_demand(self, params: methods.DemandParams, caller: Caller) -> results.Granted:
        """Take a demand."""
        owner = self._sources.owner_of(params.source)
        if owner is not None and owner != caller.connection:
            sentence = f"another connection is source {params.source}; use a name of your own"
            raise _refused(Refusal.OTHER_OWNER, sentence)
        demand = demand_of(params, self._program.daemon.gateway.settings)
        answer = self._requests.offer(demand, time.monotonic_ns())
        if answer.granted:
            self._sources.note(params.source, caller.connection)
        return self._granted(answer)

    def release(self, params: methods.ReleaseParams, caller: Caller) -> results.Granted:
        """End one's own demand."""
        if self._sources.owner_of(params.source) != caller.connection:
            sentence = f"this connection is not source {params.source}"
            raise _refused(Refusal.OTHER_OWNER, sentence)
        return self._granted(self._requests.end_demand(params.source, time.monotonic_ns()))

    def arm(self, _: methods.Nothing, caller: Caller) -> results.Granted:
        """From standby to active."""
        return self._told("arm", caller, self._requests.arm(time.monotonic_ns()))

    def disarm(self, _: methods.Nothing, caller: Caller) -> results.Granted:
        """From active to standby."""
        return self._told("disarm", caller, self._requests.disarm(time.monotonic_ns()))

    def estop(self, _: methods.Nothing, caller: Caller) -> results.Granted:
        """Cut the power."""
        return self._told("estop", caller, self._requests.emergency_stop())

    def reset(self, params: methods.ResetParams, caller: Caller) -> results.Granted:
        """From fault to starting."""
        level = FaultClass(params.level)
        return self._told("reset", caller, self._requests.reset(level, time.monotonic_ns()))

    def _told(self, what: str, caller: Caller, answer: RequestResult) -> results.Granted:
        """As `_granted`, with who asked in the journal."""
        peer = {"uid": caller.peer.uid, "pid": caller.peer.pid}
        fields = {"request": what, "granted": answer.granted, **peer}
        self._program.daemon.journal.tell(Event("api_request", Severity.INFO, fields))
        return self._granted(answer)

    def _granted(self, answer: RequestResult) -> results.Granted:
        self._program.daemon.explain_anew()
        if answer.refusal is not None:
            raise _refused(answer.refusal, answer.sentence)
        mode = self._program.daemon.gateway.supervisor.mode
        return {"granted": True, "mode": views.mode_name(mode)}

    def events(self, params: methods.EventsParams, _: Caller) -> results.Events:
        """The latest of the journal."""
        now_ns, journal = time.monotonic_ns(), self._program.daemon.journal
        entries = [_entry(entry, now_ns) for entry in journal.latest(params.limit)]
        return {"events": entries, "forgotten": journal.forgotten}


_ASKING: Mapping[str, Callable[[CommandHandlers, Any, Caller], Any]] = {
    "demand.set": CommandHandlers.set_demand,
    "demand.release": CommandHandlers.release,
    "arm": CommandHandlers.arm,
    "disarm": CommandHandlers.disarm,
    "reset": CommandHandlers.reset,
    "estop": CommandHandlers.estop,
    "events": CommandHandlers.events,
}

COMMANDS = frozenset(_ASKING)
"""The methods of this kind."""


def demand_of(params: methods.DemandParams, settings: Settings) -> Demand:
    """The demand that is meant; Failure where it says both `values` and `controllers`, or none."""
    if (params.values is None) is (params.controllers is None):
        sentence = "give either values, for both controllers, or controllers, one for each"
        raise RequestError(ErrorCode.INVALID_PARAMS, sentence)
    if params.values is not None:
        both = _controller_demand(params.values, settings)
        controllers = dict.fromkeys(CONTROLLERS, both)
    else:
        given = cast(Mapping[str, methods.Values], params.controllers)
        controllers = {name: _controller_demand(one, settings) for name, one in given.items()}
    return Demand(
        source=params.source,
        sequence=params.sequence,
        ttl_ms=settings.ttl_default_ms if params.ttl_ms is None else params.ttl_ms,
        controllers=controllers,
        made_ns=params.made_ns,
    )


def _controller_demand(values: methods.Values, settings: Settings) -> ControllerDemand:
    speed_rpm, power_w = values.speed_limit_rpm, values.power_limit_w
    return ControllerDemand(
        throttle_pct=values.throttle_pct,
        throttle_track2_pct=values.throttle_track2_pct,
        brake_pct=values.brake_pct,
        power_mode=PowerMode[values.power_mode.upper()],
        motor_reverse=values.motor_reverse,
        regen_brake=values.regen_brake,
        speed_limit_rpm=settings.speed_limit_max_rpm if speed_rpm is None else speed_rpm,
        power_limit_w=settings.power_limit_max_w if power_w is None else power_w,
    )


def _refused(refusal: Refusal, sentence: str) -> RequestError:
    return RequestError(ErrorCode.REFUSED, sentence, refusal=refusal.value)


def _entry(entry: LoggedEvent, now_ns: int) -> results.EventEntry:
    severity = cast(Any, entry.event.severity.name.lower())
    return {
        "name": entry.event.name,
        "severity": severity,
        "fields": dict(entry.event.fields),
        "count": entry.count,
        "first_ms": (now_ns - entry.first_ns) / NS_PER_MS,
        "last_ms": (now_ns - entry.last_ns) / NS_PER_MS,
        "last_time": entry.last_time(),
    }
