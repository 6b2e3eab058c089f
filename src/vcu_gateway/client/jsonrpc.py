"""JSON-RPC 2.0 by lines, sans-IO: bytes in, responses and notifications out."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from vcu_gateway.client.errors import ApiError, GarbledError, api_error

MAX_LINE_BYTES = 4 * 1024 * 1024
"""Limit of one line; more without an end of line is garbled."""


class Response(NamedTuple):
    """Response to one request.

    Attributes:
        id: the request's number; None where the gateway could not read one.
        error: why there is no result; None where there is one.
    """

    id: int | None
    result: Any
    error: ApiError | None

    def concerns(self, request_id: int) -> bool:
        """Whether it answers this request; an error without a number answers any."""
        return self.id == request_id or (self.id is None and self.error is not None)

    def value(self) -> Any:
        if self.error is not None:
            raise self.error
        return self.result


class Notification(NamedTuple):
    """Message of the gateway that answers no request."""

    method: str
    params: Mapping[str, Any]


Incoming = Response | Notification


class MessageDecoder:
    """Incremental decoder of one connection's bytes; keeps an incomplete line."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Incoming]:
        """The messages that these bytes complete, in order.

        Raises:
            GarbledError: not JSON-RPC, or a line longer than MAX_LINE_BYTES.
        """
        seen = len(self._rest)
        self._rest += data
        if self._rest.find(b"\n", seen) < 0:
            lines = []
        else:
            *lines, self._rest = self._rest.split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            raise GarbledError(f"the gateway sent a line of more than {MAX_LINE_BYTES} bytes")
        return [_decode(bytes(line)) for line in lines]


def request(request_id: int, method: str, params: Mapping[str, object]) -> bytes:
    """One request as a line; ValueError where a number is not finite."""
    members = {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}
    return json.dumps(members, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _decode(line: bytes) -> Incoming:
    try:
        return _message(json.loads(line))
    except (ValueError, RecursionError) as error:
        raise GarbledError(f"the gateway sent no JSON-RPC: {error}: {line[:80]!r}") from error


def _message(message: object) -> Incoming:
    if not isinstance(message, dict) or message.get("jsonrpc") != "2.0":
        raise ValueError("not an object of JSON-RPC 2.0")
    if "method" in message:
        return _notification(message)
    request_id = message.get("id")
    if request_id is not None and type(request_id) is not int:
        raise ValueError("the id is not an integer")
    if ("result" in message) == ("error" in message):
        raise ValueError("not exactly one of result and error")
    if "error" in message:
        return Response(request_id, None, api_error(message["error"]))
    return Response(request_id, message["result"], None)


def _notification(message: Mapping[str, Any]) -> Notification:
    params = message.get("params", {})
    if not isinstance(message["method"], str) or not isinstance(params, dict):
        raise ValueError("not a notification with a method and named parameters")
    return Notification(message["method"], params)
