"""Dispatcher of requests: queries on the API's thread, commands on the ticking thread.

`methods.METHODS` has an entry for every method in `QUERIES`, `COMMANDS`, for the reload and for
the subscriptions, and no others; a test says so.
"""

import time
from collections.abc import Callable, Mapping

from vcu_gateway import config as configuration
from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.daemon.reload import ReloadOutcome
from vcu_gateway.rate_limit import LogRateLimit
from vcu_gateway.server import queries
from vcu_gateway.server.commands import CommandHandlers
from vcu_gateway.server.context import ServerContext
from vcu_gateway.server.service import Caller, Reply
from vcu_gateway.server.shared_request import SharedRequest
from vcu_gateway.server.stop_requests import STOPS

RELOAD = "config.reload"
DEMAND = "demand.set"


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
        self,
        method: str,
        params: methods.Params,
        caller: Caller,
        reply: Callable[[Reply], None],
    ) -> None:
        """Handle a permitted request; `reply` is called at once, or from the ticking thread."""
        try:
            if method in queries.QUERIES:
                reply(queries.QUERIES[method](self._context, params))
            elif method == RELOAD:
                self._reload(reply)
            else:
                self._enqueue(method, params, caller, reply)
        except RequestError as failure:
            reply(failure)

    def _enqueue(
        self,
        method: str,
        params: methods.Params,
        caller: Caller,
        reply: Callable[[Reply], None],
    ) -> None:
        if method in STOPS:
            self._stops[method].ask(caller, reply)
            return
        self._check_capacity()
        if method == DEMAND:
            self._drivers.add(caller.connection)

        def execute() -> None:
            try:
                reply(self._commands.execute(method, params, caller))
            except RequestError as failure:
                reply(failure)

        self._work_queue.post(execute)

    def _shared_stop(self, method: str) -> SharedRequest:
        def execute(caller: Caller) -> Reply:
            try:
                return self._commands.execute(method, methods.Nothing(), caller)
            except RequestError as failure:
                return failure

        return SharedRequest(execute, self._work_queue.post)

    def _check_capacity(self) -> None:
        self._context.latest()
        if self._work_queue.full:
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
        digest = configuration.digest(self._context.in_effect.config)
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
