"""Routes of the page: who may ask for what, and how it is answered.

Call that many ask for at once, and that is made once for all who wait.

What the page may ask of the gateway: stop, disarm, arm, reset, a drive mode; never a demand.

The emergency stop is asked for again and again until the gateway has answered. What became of it
on the bus and at the controllers is no part of the answer: every state tells it.
"""

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response

from vcu_gateway.api.errors import Right
from vcu_gateway.api.results import FaultClassName, Granted, ModeName
from vcu_gateway.client import ApiError, AsyncClient, ClientError
from vcu_gateway.web.access import Access, Visitor
from vcu_gateway.web.gateway_link import GatewayLink, now_ms
from vcu_gateway.web.guard import NO_STORE, PageRequestError
from vcu_gateway.web.history import MOST_SIGNALS, PreparedSamples
from vcu_gateway.web.state_row import part_of
from vcu_gateway.web.stream import Streams
from vcu_gateway.web.users import ACTION_RIGHTS, WebEvents

ResultT = TypeVar("ResultT")


class MergedCall(Generic[ResultT]):
    """One call at a time; whoever asks while one runs shares the next, which begins after that.

    So each has what began after he asked: a stop that was carried out before is none for him.
    """

    def __init__(self, call: Callable[[], Awaitable[ResultT]]) -> None:
        self._call = call
        self._running: asyncio.Task[ResultT] | None = None
        self._next: asyncio.Task[ResultT] | None = None

    async def __call__(self) -> ResultT:
        """Result of a call that begins from now on."""
        if self._next is None:
            self._next = asyncio.create_task(self._after(self._running))
        return await asyncio.shield(self._next)  # who leaves ends it for nobody else

    async def _after(self, before: "asyncio.Task[ResultT] | None") -> ResultT:
        if before is not None:
            await asyncio.wait([before])
        self._running, self._next = self._next, None
        return await self._call()


_TRY_TIMEOUT_S = 0.3
_TRIES_FOR_S = 0.9
_AGAIN_S = 0.05
_ASK_TIMEOUT_S = 1.0


class Answer(NamedTuple):
    """The answer to an action.

    Attributes:
        answered: the gateway has; granted: and will do it.
        mode: when it was granted; None where it was not, or where that is not known.
    """

    answered: bool
    granted: bool = False
    mode: ModeName | None = None
    sentence: str = ""


class Actions:
    """Actions on the gateway, on connections of their own: a stop waits for nothing else.

    Attributes:
        tuning: gives drive mode and curves now, asked for once for all; ClientError where that
            fails.
    """

    def __init__(self, socket_path: Path) -> None:
        self._stopping = AsyncClient(socket_path, _TRY_TIMEOUT_S)
        self._asking = asking = AsyncClient(socket_path, _ASK_TIMEOUT_S)
        self.tuning = MergedCall(asking.tuning)
        self._calls: Mapping[str, Callable[[], Awaitable[Answer]]] = {
            "estop": MergedCall(self._ask_to_stop),
            "disarm": MergedCall(lambda: _outcome(self._stopping.disarm())),
            "arm": lambda: _outcome(asking.arm()),
            "reset driver": lambda: _outcome(asking.reset("driver")),
            "reset service": lambda: _outcome(asking.reset("service")),
        }

    async def act(self, name: str) -> Answer:
        """Carry out an action of `users.ACTION_RIGHTS`."""
        return await self._calls[name]()

    async def set_drive_mode(self, mode: str, level: FaultClassName) -> Answer:
        return await _outcome(self._asking.set_drive_mode(mode, level))

    async def _ask_to_stop(self) -> Answer:
        """Ask until it has answered, for 0.9 s; the browser asks again after that."""
        end_s = time.monotonic() + _TRIES_FOR_S
        while True:
            try:
                return _granted(await self._stopping.estop())
            except ApiError as error:
                # The gateway stops also where a request is wrong in form, and says so.
                return Answer(answered=True, granted=True, sentence=error.sentence)
            except ClientError as error:
                if time.monotonic() >= end_s:
                    return Answer(answered=False, sentence=str(error))
                await asyncio.sleep(_AGAIN_S)

    async def close(self) -> None:
        await self._stopping.close()
        await self._asking.close()


async def _outcome(asked: Awaitable[Granted]) -> Answer:
    try:
        return _granted(await asked)
    except ApiError as error:
        return Answer(answered=True, sentence=error.sentence)
    except ClientError as error:
        return Answer(answered=False, sentence=str(error))


def _granted(granted: Any) -> Answer:
    """The answer for one that a gateway of any version granted."""
    return Answer(answered=True, granted=True, mode=part_of(granted, "mode"))


_MAY_NOT = Answer(answered=False, sentence="the role may not")
_BODY_WITHIN_S = 10.0
_MOST_JSON_BYTES = 4096
_POINTS = range(2, 4001)
_SIGN_IN = "sign in: there is no session, or it has ended"

Handler = Callable[[Request, Visitor], Awaitable[Response]]


class Routes:
    """Handlers of the API under /api; the page's files are apart."""

    def __init__(
        self,
        access: Access,
        link: GatewayLink,
        actions: Actions,
        streams: Streams,
        events: WebEvents,
    ) -> None:
        self._access = access
        self._link = link
        self._actions = actions
        self._streams = streams
        self._events = events
        self._samples = PreparedSamples(link.answers.history.read)

    def for_visitors(self, handler: Handler) -> Callable[[Request], Awaitable[Response]]:
        """The handler for whoever may look; 401 for everybody else."""

        async def guarded(request: Request) -> Response:
            visitor = self._access.visitor(request)
            if visitor is None or not visitor.looks:
                raise PageRequestError(401, _SIGN_IN)
            return await handler(request, visitor)

        return guarded

    async def session(self, request: Request) -> Response:
        """Who the browser is, and by which clock the stream's times are."""
        visitor = self._access.visitor(request)
        looks = visitor is not None and visitor.looks
        rights = [right.value for right in Right if visitor and looks and visitor.may(right)]
        return answer(
            {
                "signed_in": looks,
                "has_users": self._access.has_users,
                "user": visitor.user if visitor else "",
                "role": visitor.role.value if visitor else "",
                "rights": rights,
                "clock": clock(),
            }
        )

    async def clock(self, request: Request, visitor: Visitor) -> Response:
        del request, visitor
        return answer(clock())

    async def sign_in(self, request: Request) -> Response:
        given = await json_body(request)
        name, password = given.get("name"), given.get("password")
        if not (isinstance(name, str) and isinstance(password, str) and self._access.has_users):
            raise PageRequestError(400, "name and password are needed")
        address = request.client.host if request.client else ""
        token, role = await self._access.sign_in(name, password, address)
        response = answer({"user": name, "role": role.value})
        self._access.set_cookie(response, token)
        return response

    async def sign_out(self, request: Request) -> Response:
        self._access.sign_out(request)
        response = answer({})
        response.delete_cookie(self._access.cookie, path="/")
        return response

    async def stream(self, request: Request, visitor: Visitor) -> Response:
        return self._streams.response(request, visitor.address, lambda: self._looks(request))

    def _looks(self, request: Request) -> bool:
        visitor = self._access.visitor(request)
        return visitor is not None and visitor.looks

    async def act(self, request: Request) -> Response:
        """Stop, disarm, arm or reset; a session that has ended may still stop."""
        name = request.path_params["name"].replace("-", " ")
        right = ACTION_RIGHTS.get(name)
        if right is None:
            raise PageRequestError(404, "there is no such action")
        visitor = self._access.visitor(request)
        if visitor is None or not (visitor.looks or name == "estop"):
            raise PageRequestError(401, _SIGN_IN)
        if not visitor.may(right):
            self._told(name, visitor, _MAY_NOT)
            raise PageRequestError(403, f"a {visitor.role.value} may not ask for {name}")
        return self._told(name, visitor, await self._actions.act(name))

    async def tuning(self, request: Request, visitor: Visitor) -> Response:
        """Drive mode, and where the vehicle is on each curve."""
        del request, visitor
        try:
            return answer(await self._actions.tuning())
        except ClientError as error:
            raise PageRequestError(503, str(error)) from error

    async def set_drive_mode(self, request: Request, visitor: Visitor) -> Response:
        """Ask for a drive mode; at service level for who has that right."""
        given = await json_body(request)
        mode, level = given.get("mode"), given.get("level", "driver")
        if not isinstance(mode, str) or level not in ("driver", "service"):
            raise PageRequestError(400, "mode is a name, level driver or service")
        right = Right.SERVICE if level == "service" else Right.OPERATE
        if not visitor.may(right):
            self._told("drive mode", visitor, _MAY_NOT)
            raise PageRequestError(403, f"a {visitor.role.value} may not ask for a drive mode so")
        done = await self._actions.set_drive_mode(mode, level)
        return self._told(f"drive mode {mode}", visitor, done)

    def _told(self, action: str, visitor: Visitor, done: Answer) -> Response:
        """The answer to an action, which is an event, too."""
        self._events.tell(
            "action_asked",
            "info" if done.granted else "warning",
            action=action,
            **visitor.fields(),
            granted=done.granted,
            answer=done.sentence,
        )
        return answer(done._asdict(), 200 if done.granted else 409 if done.answered else 503)

    async def history(self, request: Request, visitor: Visitor) -> Response:
        """Samples of signals over the last ten minutes, for the plots."""
        del visitor
        known = set(self._link.answers.history.names)
        names = [name for name in request.query_params.get("signals", "").split(",") if name]
        unknown = [name for name in names if name not in known]
        if unknown or not 0 < len(names) <= MOST_SIGNALS:
            sentence = f"signals: 1 to {MOST_SIGNALS} names that there are samples of"
            raise PageRequestError(400, sentence)
        points = _number(request.query_params.get("points", "1200"))
        if points not in _POINTS:
            raise PageRequestError(400, f"points: {_POINTS[0]} to {_POINTS[-1]}")
        encoded = await self._samples.encoded(tuple(names), points)
        return encoded.response(request, NO_STORE)


def clock() -> dict[str, float]:
    """CLOCK_MONOTONIC and the wall clock, in ms."""
    return {"monotonic_ms": now_ms(), "wall_ms": time.time() * 1000}


def answer(value: object, status: int = 200) -> JSONResponse:
    """An answer that nobody keeps."""
    return JSONResponse(value, status, NO_STORE)


async def body(request: Request, most_bytes: int) -> bytes:
    """The request's body; PageRequestError where it does not come, or is larger."""
    received = bytearray()
    try:
        async with asyncio.timeout(_BODY_WITHIN_S):
            async for chunk in request.stream():
                received += chunk
                if len(received) > most_bytes:
                    raise PageRequestError(413, f"larger than {most_bytes} bytes")
    except (TimeoutError, ClientDisconnect) as error:
        raise PageRequestError(408, "the request did not come in time") from error
    return bytes(received)


async def json_body(request: Request) -> dict[str, Any]:
    """The request's body; PageRequestError where it is no JSON object."""
    try:
        value = json.loads(await body(request, _MOST_JSON_BYTES))
    except (ValueError, RecursionError) as error:
        raise PageRequestError(400, "no JSON") from error
    if not isinstance(value, dict):
        raise PageRequestError(400, "no JSON object")
    return value


def _number(text: str) -> int:
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else -1
