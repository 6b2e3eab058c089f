"""JSON-RPC without a connection: bytes in, answers and notifications out."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from vcu_gateway.client.errors import ApiError, GarbledError, api_error

MAX_LINE_BYTES = 4 * 1024 * 1024
"""More without an end of line is no gateway."""


class Response(NamedTuple):
    """One request's answer.

    Attributes:
        id: the request's number; None where the gateway could not tell which, or none was read.
        error: why there is no result; None where there is one.
    """

    id: int | None
    result: Any
    error: ApiError | None

    def concerns(self, request_id: int) -> bool:
        """Whether it ends this request; an error without a number ends whatever waits."""
        return self.id == request_id or (self.id is None and self.error is not None)

    def value(self) -> Any:
        """The result, or the error raised."""
        if self.error is not None:
            raise self.error
        return self.result


class Notification(NamedTuple):
    """What the gateway tells unasked."""

    method: str
    params: Mapping[str, Any]


Incoming = Response | Notification


class MessageDecoder:
    """Gathers one connection's bytes into lines; half a line waits for its end."""

    def __init__(self) -> None:
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Incoming]:
        """Everything that these bytes complete, in order; GarbledError where it is no JSON-RPC."""
        seen = len(self._rest)
        self._rest += data
        if self._rest.find(b"\n", seen) < 0:
            lines = []
        else:
            *lines, self._rest = self._rest.split(b"\n")
        if len(self._rest) > MAX_LINE_BYTES:
            raise GarbledError(f"the gateway sent a line of more than {MAX_LINE_BYTES} bytes")
        return [_decoded(bytes(line)) for line in lines]


def request(request_id: int, method: str, params: Mapping[str, object]) -> bytes:
    """One request's line."""
    members = {"jsonrpc": "2.0", "id": request_id, "method": method, "params": params}
    return json.dumps(members, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _decoded(line: bytes) -> Incoming:
    try:
        return _understood(json.loads(line))
    except (ValueError, RecursionError) as error:
        raise GarbledError(f"the gateway sent no JSON-RPC: {error}: {line[:80]!r}") from error


def _understood(message: object) -> Incoming:
    if not isinstance(message, dict) or message.get("jsonrpc") != "2.0":
        raise ValueError("no object of version 2.0")
    if "method" in message:
        return _notification(message)
    request_id = message.get("id")
    if request_id is not None and type(request_id) is not int:
        raise ValueError("the id is none of ours")
    if ("result" in message) == ("error" in message):
        raise ValueError("not one of result and error")
    if "error" in message:
        return Response(request_id, None, api_error(message["error"]))
    return Response(request_id, message["result"], None)


def _notification(message: Mapping[str, Any]) -> Notification:
    params = message.get("params", {})
    if not isinstance(message["method"], str) or not isinstance(params, dict):
        raise ValueError("no notification of ours")
    return Notification(message["method"], params)
