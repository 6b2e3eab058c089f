"""Connection to the gateway: its Unix socket, and JSON-RPC 2.0 by lines, sans-IO."""

import errno
import json
import os
import socket
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.client.errors import ApiError, GarbledError, UnreachableError, api_error

SOCKET_VARIABLE = "VCU_GATEWAY_SOCKET"
SOCKET_PATH = Path("/run/vcu-gateway/control.sock")

_REMEDIES = {
    errno.ENOENT: "there is no socket {path}: start the gateway (systemctl start vcu-gateway), or"
    f" name its socket in {SOCKET_VARIABLE}",
    errno.ECONNREFUSED: "no process listens at {path}: the gateway has ended; start it"
    " (systemctl start vcu-gateway)",
    errno.EACCES: "no permission to open {path}: join the group that `ls -l {path}` shows, and"
    " log in again",
    errno.EAGAIN: "{path} takes no more connections: the gateway hangs or is overrun; see"
    " `systemctl status vcu-gateway`",
}


def default_socket_path() -> Path:
    """Path of the gateway's socket: VCU_GATEWAY_SOCKET, else /run/vcu-gateway/control.sock."""
    return Path(os.environ.get(SOCKET_VARIABLE) or SOCKET_PATH)


def connect(path: Path, timeout_s: float = 0.0) -> socket.socket:
    """A connected, non-blocking socket.

    Args:
        path: the Unix socket.
        timeout_s: longest wait while the listener's backlog is full; 0 does not wait.

    Raises:
        UnreachableError: the message says what to do.
    """
    try:
        return _connected_socket(os.fspath(path), timeout_s)
    except OSError as error:
        known = _REMEDIES.get(error.errno or 0)
        sentence = known.format(path=path) if known else f"cannot connect to {path}: {error}"
        raise UnreachableError(sentence) from error


def _connected_socket(path: str, timeout_s: float) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        connection.setblocking(timeout_s > 0)
        if timeout_s > 0:
            # Not socket.settimeout: a non-blocking connect fails at once on a full backlog.
            timeval = struct.pack("@ll", int(timeout_s), int(timeout_s % 1 * 1e6))
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, timeval)
        connection.connect(path)
        connection.setblocking(False)
    except BaseException:
        connection.close()
        raise
    return connection


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
        self._rest += data
        lines: list[bytearray] = []
        if b"\n" in data:
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
