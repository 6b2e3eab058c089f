"""A gateway that its clients cannot tell from the real one, until it is told to misbehave.

A real Unix socket, a thread for each connection, requests judged by the contract's own models.
"""

import contextlib
import dataclasses
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tests.client.vehicle import Vehicle
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.api.methods import METHODS

PATIENCE_S = 30.0


@dataclasses.dataclass
class Faults:
    """What goes wrong, by method; empty is a healthy gateway.

    Attributes:
        refuse: answered with this. silent: carried out, never answered.
        hang_up: the connection ends instead of an answer, so many times.
        say: sent instead of an answer, before a hang-up too.
        late: answered only once the event is set.
        one_byte: answers go out a byte at a time. full: every connection is turned away.
    """

    refuse: dict[str, RequestError] = dataclasses.field(default_factory=dict)
    silent: set[str] = dataclasses.field(default_factory=set)
    hang_up: dict[str, int] = dataclasses.field(default_factory=dict)
    say: dict[str, bytes] = dataclasses.field(default_factory=dict)
    late: dict[str, threading.Event] = dataclasses.field(default_factory=dict)
    one_byte: bool = False
    full: bool = False


@dataclasses.dataclass(frozen=True)
class Seen:
    """A request as it arrived."""

    connection: int
    method: str
    params: Mapping[str, Any]
    at_ns: int

    @property
    def throttle_pct(self) -> float | None:
        """What it asks of both controllers; None where it is no such demand."""
        return (self.params.get("values") or {}).get("throttle_pct")


class FakeGateway:
    """`seen` has every request in order; `open_connections` the numbers of those not ended."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.vehicle = Vehicle()
        self.faults = Faults()
        self.seen: list[Seen] = []
        self.open_connections: set[int] = set()
        self.accepted = 0
        self._changed = threading.Condition()
        self._sockets: dict[int, socket.socket] = {}
        self._threads: list[threading.Thread] = []
        self._listener: socket.socket | None = None

    def start(self) -> None:
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(os.fspath(self.path))
        self._listener.listen(16)
        self._spawn(self._accept, self._listener)

    def stop(self) -> None:
        """End it with all its connections, as a gateway that ends."""
        if self._listener is not None:
            self._listener.shutdown(socket.SHUT_RDWR)
            self._listener.close()
            self._listener = None
            self.path.unlink()
        self.hang_up()
        for event in self.faults.late.values():
            event.set()
        for thread in self._threads:
            thread.join(PATIENCE_S)
        self._threads.clear()

    def restart(self) -> None:
        """A new gateway in the same place, unarmed."""
        self.stop()
        self.vehicle = Vehicle()
        self.start()

    def hang_up(self) -> None:
        """End every connection, not the gateway."""
        for connection in list(self._sockets.values()):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def methods(self) -> list[str]:
        """The methods of all requests so far."""
        return [one.method for one in self.seen]

    def demands(self) -> list[Seen]:
        """All demands so far."""
        return [one for one in list(self.seen) if one.method == "demand.set"]

    def wait_for(self, condition: Callable[[], object], what: str = "") -> None:
        """Until the condition holds, judged at every request and end of a connection."""
        with self._changed:
            assert self._changed.wait_for(condition, PATIENCE_S), what or "it did not happen"

    def _spawn(self, target: Callable[..., None], *args: Any) -> None:
        thread = threading.Thread(target=target, args=args, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            if self.faults.full:
                failure = RequestError(ErrorCode.TOO_MANY_CLIENTS, "16 clients are the most")
                connection.sendall(_line({"id": None, "error": failure.as_json()}))
                connection.close()
                continue
            with self._changed:
                self.accepted += 1
                self._sockets[self.accepted] = connection
                self.open_connections.add(self.accepted)
            self._spawn(self._serve, connection, self.accepted, self.vehicle)

    def _serve(self, connection: socket.socket, number: int, vehicle: Vehicle) -> None:
        rest = b""
        with connection, contextlib.suppress(OSError):
            while data := connection.recv(65536):
                *lines, rest = (rest + data).split(b"\n")
                if not all(self._handle(connection, number, line, vehicle) for line in lines):
                    break
        vehicle.gone(number)
        with self._changed:
            self._sockets.pop(number, None)
            self.open_connections.discard(number)
            self._changed.notify_all()

    def _handle(
        self, connection: socket.socket, number: int, line: bytes, vehicle: Vehicle
    ) -> bool:
        """False where the connection is to end."""
        message = json.loads(line)
        method, params = message["method"], message.get("params", {})
        assert message["jsonrpc"] == "2.0"
        with self._changed:
            self.seen.append(Seen(number, method, params, time.monotonic_ns()))
            self._changed.notify_all()
        answer = self._answer(method, params, number, vehicle)
        if self.faults.hang_up.get(method, 0) > 0:
            self.faults.hang_up[method] -= 1
            connection.sendall(self.faults.say.get(method, b""))
            return False
        self._reply(connection, method, {"id": message["id"], **answer})
        if method == "state.subscribe" and "result" in answer:
            self._send_updates(connection, params, vehicle)
            return False
        return True

    def _answer(
        self, method: str, params: Mapping[str, Any], number: int, vehicle: Vehicle
    ) -> dict[str, Any]:
        try:
            if method in self.faults.refuse:
                raise self.faults.refuse[method]
            checked = METHODS[method].params.model_validate(params).model_dump()
            if method == "state.subscribe":
                vehicle.state(checked["messages"])
                return {"result": {"subscription": 1, "rate_hz": checked["rate_hz"]}}
            return {"result": vehicle.answer(method, checked, number)}
        except ValidationError as error:
            return {"error": RequestError(ErrorCode.INVALID_PARAMS, str(error)).as_json()}
        except RequestError as failure:
            return {"error": failure.as_json()}

    def _reply(self, connection: socket.socket, method: str, answer: dict[str, Any]) -> None:
        if method in self.faults.late:
            self.faults.late[method].wait(PATIENCE_S)
        if method in self.faults.silent:
            return
        data = self.faults.say.get(method) or _line(answer)
        size = 1 if self.faults.one_byte else len(data)
        with contextlib.suppress(OSError):  # it has left; what it sent before is still read
            for at in range(0, len(data), size):
                connection.sendall(data[at : at + size])

    def _send_updates(
        self, connection: socket.socket, params: Mapping[str, Any], vehicle: Vehicle
    ) -> None:
        """Until the client or somebody here ends the connection."""
        connection.settimeout(1 / params.get("rate_hz", 10.0))
        while True:
            update = {"subscription": 1, "lost": 0, "state": vehicle.state(params.get("messages"))}
            connection.sendall(
                self.faults.say.get("state.update")
                or _line({"method": "state.update", "params": update})
            )
            with contextlib.suppress(TimeoutError):
                if not connection.recv(1):
                    return


def _line(message: Mapping[str, Any]) -> bytes:
    return json.dumps({"jsonrpc": "2.0", **message}).encode() + b"\n"
