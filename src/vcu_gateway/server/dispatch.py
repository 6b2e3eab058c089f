"""The service behind the server: each method's answer, on the thread that may give it.

`methods.METHODS` on one side and `READING`, `ASKING`, the reload here and the server's
subscriptions on the other name the same methods; a test says so.
"""

import time
from collections.abc import Callable, Mapping

from vcu_gateway import config as configuration
from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.daemon.reload import ReloadOutcome
from vcu_gateway.server import queries
from vcu_gateway.server.commands import CommandHandlers
from vcu_gateway.server.context import ServerContext
from vcu_gateway.server.rate_limit import LogRateLimit
from vcu_gateway.server.service import Caller, Reply
from vcu_gateway.server.stop_requests import STOPS

RELOAD = "config.reload"


class Dispatcher:
    """Implements `service.Service`."""

    def __init__(self, program: ServerContext) -> None:
        self._program = program
        self._inbox = program.daemon.inbox
        self._asking = CommandHandlers(program)
        self._restraint = LogRateLimit()

    def begin(
        self,
        method: str,
        params: methods.Params,
        caller: Caller,
        reply: Callable[[Reply], None],
    ) -> None:
        """Answer one permitted request through `reply`: at once, or from the ticking thread."""
        try:
            if method in queries.QUERIES:
                reply(queries.QUERIES[method](self._program, params))
            elif method == RELOAD:
                self._reload(reply)
            else:
                self._ask(method, params, caller, reply)
        except RequestError as failure:
            reply(failure)

    def _ask(
        self,
        method: str,
        params: methods.Params,
        caller: Caller,
        reply: Callable[[Reply], None],
    ) -> None:
        if method not in STOPS:
            self._check_ready()

        def carry_out() -> None:
            try:
                reply(self._asking.carry_out(method, params, caller))
            except RequestError as failure:
                reply(failure)

        self._inbox.post(carry_out)

    def _check_ready(self) -> None:
        self._program.latest()
        if self._inbox.full:
            raise RequestError(
                ErrorCode.NOT_READY, "too many requests wait for the next tick; try again"
            )

    def _reload(self, reply: Callable[[Reply], None]) -> None:
        self._program.latest()
        self._program.reloader.begin(lambda outcome: reply(self._reloaded(outcome)))

    def _reloaded(self, outcome: ReloadOutcome) -> Reply:
        if not outcome.taken:
            sentence = f"the configuration stays as it was: {outcome.problems[0]}"
            return RequestError(ErrorCode.CONFIG_REFUSED, sentence, problems=outcome.problems)
        digest = configuration.digest(self._program.in_effect.config)
        return {"changed": list(outcome.changed), "digest": digest}

    def state(self, messages: list[str] | None) -> results.State:
        """What is known now; Failure for a message that the gateway does not receive."""
        return queries.state(self._program, messages)

    def metrics(self) -> bytes:
        """The metrics' text; Failure where they are not installed."""
        if self._program.metrics is None:
            sentence = "metrics need an extra: pip install 'vcu-gateway[metrics]'"
            raise RequestError(ErrorCode.NOT_READY, sentence)
        return self._program.metrics()

    def owns_demand(self, caller: Caller) -> bool:
        """True while a fresh demand of this connection counts."""
        return self._asking.owns_demand(caller)

    def refused(self, method: str, caller: Caller, sentence: str) -> None:
        """Have it logged that a right was missing."""
        self._note("api_refused", caller, {"method": method, "sentence": sentence})

    def closed(self, caller: Caller, reason: str) -> None:
        """Have it logged that the gateway ended a connection."""
        self._note("api_client_closed", caller, {"reason": reason})

    def _note(self, name: str, caller: Caller, fields: Mapping[str, object]) -> None:
        what = (name, caller.peer.uid, *fields.values())
        untold = self._restraint.untold(what, time.monotonic_ns())
        if untold is None:
            return
        peer = {"uid": caller.peer.uid, "pid": caller.peer.pid, "untold": untold}
        event = Event(name, Severity.WARNING, {**fields, **peer})
        self._inbox.post(lambda: self._program.daemon.journal.tell(event))

    def gone(self, caller: Caller) -> None:
        """The demand of a connection ends with it."""
        self._inbox.post(lambda: self._asking.end_demands_of(caller))
