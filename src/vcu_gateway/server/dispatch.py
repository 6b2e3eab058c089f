"""Dispatcher of requests: queries on the API's thread, commands on the ticking thread.

`methods.METHODS` has an entry for every method in `QUERIES`, `COMMANDS`, for the reload and for
the subscriptions, and no others; a test says so.

Handlers of the methods that change something: run on the ticking thread, between its ticks.

Request that any number of connections make at once, and that is carried out once for all.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, cast

from vcu_gateway import config as configuration
from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.core import calls
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.demand import (
    CONTROLLERS,
    ControllerDemand,
    Demand,
    PowerMode,
    Refusal,
    RequestResult,
    refused,
)
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.daemon.events import LoggedEvent
from vcu_gateway.daemon.reload import ReloadOutcome
from vcu_gateway.rate_limit import LogRateLimit
from vcu_gateway.server import queries, views
from vcu_gateway.server.jsonrpc import STOPS
from vcu_gateway.server.queries import ServerContext
from vcu_gateway.server.service import Caller, Reply
from vcu_gateway.units import NS_PER_MS


class CommandHandlers:
    """Handlers of commands; used by the ticking thread alone, but for `owns_demand`.

    The name of a source belongs to the connection that first made a demand in it, until it ends.
    """

    def __init__(self, context: ServerContext) -> None:
        self._context = context
        self._gateway = context.loop.gateway
        self._owners: dict[str, int] = {}

    def execute(self, method: str, params: Any, caller: Caller) -> Reply:
        """Result of the command, or why it is refused."""
        try:
            return cast(Reply, COMMANDS[method](self, params, caller))
        except RequestError as failure:
            return failure

    def owns_demand(self, caller: Caller) -> bool:
        """True while a fresh demand of this connection counts; from any thread."""
        arbiter = self._gateway.requests.arbiter
        demand = arbiter.current
        if demand is None or not arbiter.fresh(time.monotonic_ns()):
            return False
        return self._owners.get(demand.source) == caller.connection

    def end_demands_of(self, caller: Caller) -> None:
        for source in [name for name, one in self._owners.items() if one == caller.connection]:
            del self._owners[source]
            self._gateway.apply(calls.EndDemand(source, time.monotonic_ns()))

    def set_demand(self, params: methods.DemandParams, caller: Caller) -> results.Granted:
        if self._owners.get(params.source, caller.connection) != caller.connection:
            sentence = f"another connection is source {params.source}; use a name of your own"
            raise _refused(Refusal.OTHER_OWNER, sentence)
        demand = demand_of(params, self._gateway.settings)
        now_ns = time.monotonic_ns()
        answer = self._gateway.apply(calls.Offer(demand, now_ns))
        if answer.refusal is Refusal.EXPIRED:
            answer = refused(Refusal.EXPIRED, _too_late(demand, now_ns))
        if answer.granted:
            self._owners[params.source] = caller.connection
        return self._granted(answer)

    def release(self, params: methods.ReleaseParams, caller: Caller) -> results.Granted:
        if self._owners.get(params.source) != caller.connection:
            sentence = f"this connection is not source {params.source}"
            raise _refused(Refusal.OTHER_OWNER, sentence)
        call = calls.EndDemand(params.source, time.monotonic_ns())
        return self._granted(self._gateway.apply(call))

    def arm(self, _: methods.Nothing, caller: Caller) -> results.Granted:
        return self._logged("arm", caller, self._gateway.apply(calls.Arm(time.monotonic_ns())))

    def disarm(self, _: methods.Nothing, caller: Caller) -> results.Granted:
        answer = self._gateway.apply(calls.Disarm(time.monotonic_ns()))
        return self._logged("disarm", caller, answer)

    def estop(self, _: methods.Nothing, caller: Caller) -> results.Granted:
        return self._logged("estop", caller, self._context.loop.emergency_stop())

    def reset(self, params: methods.ResetParams, caller: Caller) -> results.Granted:
        call = calls.Reset(FaultClass(params.level), time.monotonic_ns())
        return self._logged("reset", caller, self._gateway.apply(call))

    def set_drive_mode(self, params: methods.DriveModeParams, caller: Caller) -> results.Granted:
        level = FaultClass(params.level)
        call = calls.SetDriveMode(params.mode, level, now_ns := time.monotonic_ns())
        answer = self._logged("drive_mode.set", caller, self._gateway.apply(call))
        answer["waits_for_release"] = views.waits_for_release(self._gateway, now_ns)
        return answer

    def _logged(self, what: str, caller: Caller, answer: RequestResult) -> results.Granted:
        """Result as `_granted` makes it, with the peer in the event log."""
        peer = {"uid": caller.peer.uid, "pid": caller.peer.pid}
        fields = {"request": what, "granted": answer.granted, **peer}
        self._context.loop.event_log.emit(Event("api_request", Severity.INFO, fields))
        return self._granted(answer)

    def _granted(self, answer: RequestResult) -> results.Granted:
        self._context.loop.refresh_why()
        if answer.refusal is not None:
            raise _refused(answer.refusal, answer.sentence)
        return {"granted": True, "mode": self._gateway.supervisor.mode.value}

    def events(self, params: methods.EventsParams, _: Caller) -> results.Events:
        now_ns, event_log = time.monotonic_ns(), self._context.loop.event_log
        entries = [_entry(entry, now_ns) for entry in event_log.latest(params.limit)]
        return {"events": entries, "forgotten": event_log.forgotten}


COMMANDS: Mapping[str, Callable[[CommandHandlers, Any, Caller], Any]] = {
    "demand.set": CommandHandlers.set_demand,
    "demand.release": CommandHandlers.release,
    "arm": CommandHandlers.arm,
    "disarm": CommandHandlers.disarm,
    "reset": CommandHandlers.reset,
    "estop": CommandHandlers.estop,
    "drive_mode.set": CommandHandlers.set_drive_mode,
    "events": CommandHandlers.events,
}
"""Handlers by method."""


def demand_of(params: methods.DemandParams, settings: Settings) -> Demand:
    """Demand from its parameters; RequestError unless one of `values`, `controllers` is given."""
    if (params.values is None) is (params.controllers is None):
        sentence = "give either values, for both controllers, or controllers, one for each"
        raise RequestError(ErrorCode.INVALID_PARAMS, sentence)
    if params.values is not None:
        both = _controller_demand(params.values, settings)
        controllers = dict.fromkeys(CONTROLLERS, both)
    else:
        given = cast(Mapping[str, methods.ControllerParams], params.controllers)
        controllers = {name: _controller_demand(one, settings) for name, one in given.items()}
    return Demand(
        source=params.source,
        sequence=params.sequence,
        ttl_ms=settings.ttl_default_ms if params.ttl_ms is None else params.ttl_ms,
        controllers=controllers,
        made_ns=params.made_ns,
    )


def _controller_demand(values: methods.ControllerParams, settings: Settings) -> ControllerDemand:
    given = {
        "speed_limit_rpm": settings.speed_limit_max_rpm,
        **values.model_dump(exclude_none=True),
    }
    return ControllerDemand(**given | {"power_mode": PowerMode[values.power_mode.upper()]})


def _too_late(demand: Demand, now_ns: int) -> str:
    made_ns = now_ns if demand.made_ns is None else demand.made_ns
    age_ms = -((made_ns - now_ns) // NS_PER_MS)  # rounded up: more than its time to live
    valid = f"it is valid for {demand.ttl_ms} ms (ttl_ms)"
    return f"the demand came {age_ms} ms after it was made (made_ns), and {valid}"


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


class SharedRequest:
    """Request without parameters, merged over those who wait: a flood of it is one at a time.

    Each is carried out after it was asked for, and named in the log as the first one's. `ask` is
    the API thread's, `execute` runs on the ticking thread, where `post` brings it.
    """

    def __init__(
        self, execute: Callable[[Caller], Reply], post: Callable[[Callable[[], None]], None]
    ) -> None:
        self._execute = execute
        self._post = post
        self._asked: deque[tuple[Caller, Callable[[Reply], None]]] = deque()
        self._is_posted = False

    def ask(self, caller: Caller, reply: Callable[[Reply], None]) -> None:
        """Ask; `reply` is called later, from the ticking thread."""
        self._asked.append((caller, reply))
        if not self._is_posted:
            self._is_posted = True
            self._post(self._run)

    def _run(self) -> None:
        self._is_posted = False  # before the next line: what is asked from now on posts again
        asked = [self._asked.popleft() for _ in range(len(self._asked))]
        if asked:
            outcome = self._execute(asked[0][0])
            for _, reply in asked:
                reply(outcome)


RELOAD = "config.reload"


class Dispatcher:
    """Implementation of `service.RequestService`."""

    def __init__(self, context: ServerContext) -> None:
        self._context = context
        self._work_queue = context.loop.work_queue
        self._commands = CommandHandlers(context)
        self._log_limit = LogRateLimit()
        self._drivers: set[int] = set()
        self._stops = {method: self._shared_stop(method) for method in STOPS}

    def handle(
        self, method: str, params: methods.Params, caller: Caller, reply: Callable[[Reply], None]
    ) -> None:
        """Handle a permitted request; `reply` is called at once, or from the ticking thread."""
        try:
            if method in queries.QUERIES:
                reply(queries.QUERIES[method](self._context, params))
            elif method == RELOAD:
                self._reload(reply)
            elif method in STOPS:
                self._stops[method].ask(caller, reply)
            else:
                self._queue(lambda: reply(self._commands.execute(method, params, caller)))
                if method == "demand.set":
                    self._drivers.add(caller.connection)
        except RequestError as failure:
            reply(failure)

    def _shared_stop(self, method: str) -> SharedRequest:
        return SharedRequest(
            lambda caller: self._commands.execute(method, methods.Nothing(), caller),
            self._work_queue.post,
        )

    def _queue(self, work: Callable[[], None]) -> None:
        """Have the ticking thread do it; RequestError before its first tick or where much waits."""
        self._context.latest()
        if not self._work_queue.offer(work):
            raise RequestError(
                ErrorCode.NOT_READY, "too many requests wait for the next tick; try again"
            )

    def _reload(self, reply: Callable[[Reply], None]) -> None:
        self._context.latest()
        self._context.reloader.begin(lambda outcome: reply(self._reload_result(outcome)))

    def _reload_result(self, outcome: ReloadOutcome) -> Reply:
        if not outcome.taken:
            sentence = f"the configuration stays as it was: {outcome.problems[0]}"
            return RequestError(ErrorCode.CONFIG_REFUSED, sentence, problems=outcome.problems)
        digest = configuration.digest(self._context.reloader.config)
        return {"changed": list(outcome.changed), "digest": digest}

    def state(self, messages: list[str] | None) -> results.State:
        return queries.state(self._context, messages)

    def owns_demand(self, caller: Caller) -> bool:
        return self._commands.owns_demand(caller)

    def log_refused(self, method: str, caller: Caller, sentence: str) -> None:
        self._log("api_refused", caller, {"method": method, "sentence": sentence})

    def log_closed(self, caller: Caller, reason: str) -> None:
        self._log("api_client_closed", caller, {"reason": reason})

    def _log(self, name: str, caller: Caller, fields: Mapping[str, object]) -> None:
        kind = (name, caller.peer.uid, *fields.values())
        suppressed = self._log_limit.admit(kind, time.monotonic_ns())
        if suppressed is None:
            return
        peer = {"uid": caller.peer.uid, "pid": caller.peer.pid, "suppressed": suppressed}
        event = Event(name, Severity.WARNING, {**fields, **peer})
        self._work_queue.post(lambda: self._context.loop.event_log.emit(event))

    def end_demands(self, caller: Caller) -> None:
        """End the demands of a connection that has ended; of most there was none."""
        if caller.connection in self._drivers:
            self._drivers.remove(caller.connection)
            self._work_queue.post(lambda: self._commands.end_demands_of(caller))
