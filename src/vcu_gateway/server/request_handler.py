"""Handler of the requests of all sessions: rights, subscriptions, and the service behind them."""

import functools
import itertools
from collections.abc import Callable

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.api.methods import (
    LEVEL_RIGHTS,
    METHODS,
    Nothing,
    Params,
    ResetParams,
    SubscribeParams,
    UnsubscribeParams,
)
from vcu_gateway.api.results import Subscribed, Update
from vcu_gateway.core.demand import Refusal
from vcu_gateway.server import jsonrpc
from vcu_gateway.server.jsonrpc import OVERTAKEN, OVERTAKEN_WORD, STOPS
from vcu_gateway.server.service import Caller, Counters, Reply, RequestService
from vcu_gateway.server.session import MAX_LINE_BYTES, ReplyTo, Session, SubscriptionState

MAX_SUBSCRIPTIONS = 4
"""Of one connection."""

LateReply = Callable[[int, int, Reply], None]
"""Called with the connection's number, our number of the request, and the reply."""


class RequestHandler:
    """Parses lines, checks rights and sends replies; sockets and timeouts are the `Session`'s."""

    def __init__(self, service: RequestService, counters: Counters, reply: LateReply) -> None:
        self._service = service
        self._counters = counters
        self._reply = reply
        self._numbers = itertools.count(1)

    def refuse_line(self, session: Session, now_ns: int) -> None:
        """Answer a line that exceeds the length."""
        what = f"a line has at most {MAX_LINE_BYTES} bytes"
        self._send(session, None, RequestError(ErrorCode.PARSE_ERROR, what), now_ns)

    def handle_next(self, session: Session, now_ns: int) -> bool:
        """Handle the line that waits; False where the session may have none handled now."""
        taken = session.take_line(now_ns)
        if taken is None:
            return False
        line, is_overtaken = taken
        self._handle(session, jsonrpc.parse(line), now_ns, is_overtaken=is_overtaken)
        return True

    def handle_marked(self, session: Session, line: bytes, now_ns: int) -> None:
        """Handle this line before all others where it is a stop; else it waits for its turn."""
        request = jsonrpc.parse(line)
        if jsonrpc.stop_of(request) is not None:
            session.lines.take_marked()
            self._handle(session, request, now_ns)

    def _handle(
        self,
        session: Session,
        request: jsonrpc.Request | jsonrpc.RefusedRequest,
        now_ns: int,
        *,
        is_overtaken: bool = False,
    ) -> None:
        self._counters.requests += 1
        if isinstance(request, jsonrpc.RefusedRequest):
            self._refuse(session, request, now_ns)
            return
        try:
            self._check(session, request, is_overtaken=is_overtaken)
            result = self._result(session, request, now_ns)
        except RequestError as error:
            # Without its traceback, or it would keep itself alive through this frame.
            result = error.with_traceback(None)
        if result is not None and request.id is not None:
            self._send(session, request.id, result, now_ns)

    def _refuse(self, session: Session, refused: jsonrpc.RefusedRequest, now_ns: int) -> None:
        """Reply with the error; a stop is carried out all the same, and the reply waits for it."""
        if refused.stop is not None:
            self._counters.stopped_anyway += 1
            addressee = ReplyTo(refused.id, refused.error)
            self._call_service(session, refused.stop, Nothing(), addressee)
        elif refused.is_answered:
            self._send(session, refused.id, refused.error, now_ns)

    def reply(self, session: Session, number: int, reply: Reply, now_ns: int) -> None:
        """Send the service's reply to a pending request; a second one is dropped."""
        addressee = session.take_pending(number, now_ns)
        if addressee is None:
            return
        if addressee.error is not None:
            reply = _with_outcome(addressee.error, reply)
        self._send(session, addressee.id, reply, now_ns)

    def send_update(self, session: Session, subscription: SubscriptionState, now_ns: int) -> None:
        """Send an update, or count it as lost where the reader is slow."""
        points = subscription.advance(now_ns)
        if session.has_output:
            subscription.lost += points
            self._counters.lost_updates += points
            return
        state = self._service.state(subscription.messages)
        update = Update(subscription=subscription.number, lost=subscription.lost, state=state)
        subscription.lost = 0
        session.send(jsonrpc.notification_line("state.update", update), now_ns)

    def _send(
        self,
        session: Session,
        request_id: jsonrpc.RequestId | None,
        reply: Reply,
        now_ns: int,
    ) -> None:
        if isinstance(reply, RequestError):
            self._counters.errors[reply.code.name.lower()] += 1
            session.send(jsonrpc.error_line(request_id, reply), now_ns)
        elif request_id is not None:
            session.send(jsonrpc.result_line(request_id, reply), now_ns)

    def _result(self, session: Session, request: jsonrpc.Request, now_ns: int) -> Reply | None:
        """Result; None where the service will reply. RequestError where it is refused."""
        if isinstance(request.params, SubscribeParams):
            return self._subscribe(session, request.params, now_ns)
        if isinstance(request.params, UnsubscribeParams):
            return _unsubscribe(session, request.params)
        addressee = None if request.id is None else ReplyTo(request.id)
        self._call_service(session, request.method, request.params, addressee)
        return None

    def _call_service(
        self, session: Session, method: str, params: Params, addressee: ReplyTo | None
    ) -> None:
        caller, number = session.caller, next(self._numbers)
        session.is_driver = session.is_driver or method == "demand.set"
        if method in STOPS:
            session.overtake()
        session.pending[number] = addressee
        reply = functools.partial(self._reply, caller.connection, number)
        self._service.handle(method, params, caller, reply)

    def _check(self, session: Session, request: jsonrpc.Request, *, is_overtaken: bool) -> None:
        """RequestError where the request is refused before the service sees it."""
        self._check_right(session.caller, request)
        if is_overtaken and request.method in OVERTAKEN:
            what = f"an estop or a disarm of this connection passed over this {request.method}"
            raise RequestError(ErrorCode.REFUSED, what, refusal=OVERTAKEN_WORD)
        if request.method == "demand.set" and session.peer_ended:
            what = "this connection has ended, and a demand ends with its connection"
            raise RequestError(ErrorCode.REFUSED, what, Refusal.NOT_ALLOWED_NOW.value)

    def _check_right(self, caller: Caller, request: jsonrpc.Request) -> None:
        needed, level = METHODS[request.method].right, ""
        if isinstance(request.params, ResetParams):
            level = f" at {request.params.level} level"
            needed = LEVEL_RIGHTS[request.params.level]
        if needed in caller.rights:
            return
        sentence = (
            f"{request.method}{level} needs the right {needed.value!r}, which user"
            f" {caller.peer.uid} and its groups do not have"
        )
        self._service.log_refused(request.method, caller, sentence)
        raise RequestError(ErrorCode.NO_RIGHT, sentence)

    def _subscribe(self, session: Session, params: SubscribeParams, now_ns: int) -> Subscribed:
        if len(session.subscriptions) >= MAX_SUBSCRIPTIONS:
            what = f"{MAX_SUBSCRIPTIONS} subscriptions are the most; end one with state.unsubscribe"
            raise RequestError(ErrorCode.REFUSED, what, Refusal.NOT_ALLOWED_NOW.value)
        self._service.state(params.messages)  # RequestError for an unknown name
        number = next(self._numbers)
        subscription = SubscriptionState(number, params.messages, params.rate_hz, now_ns)
        session.subscriptions[number] = subscription
        return Subscribed(subscription=number, rate_hz=params.rate_hz)


def _with_outcome(error: RequestError, reply: Reply) -> RequestError:
    """Error of a malformed request to stop, with its outcome."""
    outcome = (
        f"not done: {reply.sentence}" if isinstance(reply, RequestError) else "done all the same"
    )
    return RequestError(error.code, f"{error.sentence}; {outcome}")


def _unsubscribe(session: Session, params: UnsubscribeParams) -> Subscribed:
    subscription = session.subscriptions.pop(params.subscription, None)
    if subscription is None:
        what = f"this connection has no subscription {params.subscription}"
        raise RequestError(ErrorCode.INVALID_PARAMS, what)
    return Subscribed(subscription=subscription.number, rate_hz=subscription.rate_hz)
