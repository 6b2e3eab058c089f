"""One line of one connection: read, judged, and answered or handed to the service."""

import functools
import itertools
from collections.abc import Callable

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.api.methods import (
    Nothing,
    Params,
    ResetParams,
    SubscribeParams,
    UnsubscribeParams,
    right_needed,
)
from vcu_gateway.api.results import Subscribed, Update
from vcu_gateway.core.demand import Refusal
from vcu_gateway.server import jsonrpc
from vcu_gateway.server.counters import Counters
from vcu_gateway.server.service import Caller, Reply, RequestService
from vcu_gateway.server.session import (
    LINE_TOO_LONG,
    MAX_LINE_BYTES,
    ReplyTo,
    Session,
    SubscriptionState,
)

MAX_SUBSCRIPTIONS = 4
"""Of one connection."""

LateReply = Callable[[int, int, Reply], None]
"""Called with the connection's number, our number of the request, and the reply."""


class RequestHandler:
    """What is done with a request; the socket it came from is the connection's affair."""

    def __init__(self, service: RequestService, counters: Counters, reply: LateReply) -> None:
        self._service = service
        self._counters = counters
        self._reply = reply
        self._numbers = itertools.count(1)

    def check_extent(self, connection: Session, now_ns: int) -> None:
        """Refuse a line that is longer than a line may be, before it has ended."""
        if connection.lines.is_too_long and not connection.is_ending:
            failure = RequestError(
                ErrorCode.PARSE_ERROR, f"a line has at most {MAX_LINE_BYTES} bytes"
            )
            self._send(connection, None, failure, now_ns)
            connection.end_after_output(LINE_TOO_LONG)

    def handle(self, connection: Session, line: bytes, now_ns: int) -> None:
        """Do what this line asks."""
        self._counters.requests += 1
        request = jsonrpc.parse(line)
        if isinstance(request, jsonrpc.RefusedRequest):
            self._refuse(connection, request, now_ns)
            return
        try:
            result = self._result(connection, request, now_ns)
        except RequestError as failure:
            # Without its traceback, or it would keep itself alive through this frame.
            result = failure.with_traceback(None)
        if result is not None and request.id is not None:
            self._send(connection, request.id, result, now_ns)

    def _refuse(self, connection: Session, refused: jsonrpc.RefusedRequest, now_ns: int) -> None:
        """Say what is wrong; a stop is done all the same, and the answer waits for that."""
        if refused.stop is not None:
            self._counters.stopped_anyway += 1
            addressee = ReplyTo(refused.id, refused.failure)
            self._begin(connection, refused.stop, Nothing(), addressee)
        elif refused.is_answered:
            self._send(connection, refused.id, refused.failure, now_ns)

    def answer(self, connection: Session, number: int, reply: Reply, now_ns: int) -> None:
        """Send the service's reply to the request of this number; the first one counts."""
        addressee = connection.answered(number, now_ns)
        if addressee is None:
            return
        if addressee.wrong is not None:
            reply = _with_what_became(addressee.wrong, reply)
        self._send(connection, addressee.id, reply, now_ns)

    def update(self, connection: Session, subscription: SubscriptionState, now_ns: int) -> None:
        """Send what is due, or count what a slow reader misses."""
        points = subscription.pass_by(now_ns)
        if connection.has_output:
            subscription.lost += points
            self._counters.lost_updates += points
            return
        state = self._service.state(subscription.messages)
        update = Update(subscription=subscription.number, lost=subscription.lost, state=state)
        subscription.lost = 0
        connection.send(jsonrpc.notification_line("state.update", update), now_ns)

    def _send(
        self, connection: Session, request_id: jsonrpc.RequestId | None, reply: Reply, now_ns: int
    ) -> None:
        if isinstance(reply, RequestError):
            self._counters.count_error(reply.code.name.lower())
            connection.send(jsonrpc.error_line(request_id, reply), now_ns)
        elif request_id is not None:
            connection.send(jsonrpc.result_line(request_id, reply), now_ns)

    def _result(self, connection: Session, request: jsonrpc.Request, now_ns: int) -> Reply | None:
        """The result; None where the service will reply. Failure is raised."""
        self._check_right(_caller(connection), request)
        if isinstance(request.params, SubscribeParams):
            return self._subscribe(connection, request.params, now_ns)
        if isinstance(request.params, UnsubscribeParams):
            return _unsubscribe(connection, request.params)
        if request.method == "demand.set" and connection.peer_ended:
            what = "this connection has ended, and a demand ends with its connection"
            raise RequestError(ErrorCode.REFUSED, what, Refusal.NOT_ALLOWED_NOW.value)
        addressee = None if request.id is None else ReplyTo(request.id)
        self._begin(connection, request.method, request.params, addressee)
        return None

    def _begin(
        self, connection: Session, method: str, params: Params, addressee: ReplyTo | None
    ) -> None:
        caller, number = _caller(connection), next(self._numbers)
        connection.drives = connection.drives or method == "demand.set"
        connection.unanswered[number] = addressee
        reply = functools.partial(self._reply, caller.connection, number)
        self._service.begin(method, params, caller, reply)

    def _check_right(self, caller: Caller, request: jsonrpc.Request) -> None:
        needed = right_needed(request.method, request.params)
        if needed in caller.rights:
            return
        level = (
            f" at {request.params.level} level" if isinstance(request.params, ResetParams) else ""
        )
        sentence = (
            f"{request.method}{level} needs the right {needed.value!r}, which user"
            f" {caller.peer.uid} and its groups do not have"
        )
        self._service.refused(request.method, caller, sentence)
        raise RequestError(ErrorCode.NO_RIGHT, sentence)

    def _subscribe(self, connection: Session, params: SubscribeParams, now_ns: int) -> Subscribed:
        if len(connection.subscriptions) >= MAX_SUBSCRIPTIONS:
            what = f"{MAX_SUBSCRIPTIONS} subscriptions are the most; end one with state.unsubscribe"
            raise RequestError(ErrorCode.REFUSED, what, Refusal.NOT_ALLOWED_NOW.value)
        self._service.state(params.messages)  # Failure where a name is wrong
        number = next(self._numbers)
        subscription = SubscriptionState(number, params.messages, params.rate_hz, now_ns)
        connection.subscriptions[number] = subscription
        return Subscribed(subscription=number, rate_hz=params.rate_hz)


def _caller(connection: Session) -> Caller:
    if connection.caller is None:
        raise AssertionError("the metrics port speaks no JSON")
    return connection.caller


def _with_what_became(wrong: RequestError, reply: Reply) -> RequestError:
    """What was wrong with a request to stop, and that the vehicle was stopped all the same."""
    became = (
        f"not done: {reply.sentence}" if isinstance(reply, RequestError) else "done all the same"
    )
    return RequestError(wrong.code, f"{wrong.sentence}; {became}")


def _unsubscribe(connection: Session, params: UnsubscribeParams) -> Subscribed:
    subscription = connection.subscriptions.pop(params.subscription, None)
    if subscription is None:
        what = f"this connection has no subscription {params.subscription}"
        raise RequestError(ErrorCode.INVALID_PARAMS, what)
    return Subscribed(subscription=subscription.number, rate_hz=subscription.rate_hz)
