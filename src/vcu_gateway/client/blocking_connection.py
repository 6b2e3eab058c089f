"""One connection for threads: every step waits, up to a deadline, then raises TimeoutError."""

import contextlib
import socket
import time
from collections import deque
from pathlib import Path
from typing import TypeVar

from vcu_gateway.client import jsonrpc
from vcu_gateway.client.calls import Call
from vcu_gateway.client.connect import connect
from vcu_gateway.client.errors import GarbledError

ResultT = TypeVar("ResultT")

READ_BYTES = 65536
_TURN_WITHIN_S = 2.0  # a hundred are let in a second


class Connection:
    """Lines to the gateway and messages from it; deadlines are in time.monotonic()."""

    def __init__(self, path: Path) -> None:
        self._socket = connect(path, _TURN_WITHIN_S)
        self._inbox = jsonrpc.MessageDecoder()
        self._arrived: deque[jsonrpc.Incoming] = deque()
        self._ended = False

    def send(self, data: bytes, deadline_s: float) -> bool:
        """False where the gateway had closed before it had all of it."""
        self._socket.settimeout(_left_s(deadline_s))
        try:
            self._socket.sendall(data)
        except ConnectionError:
            return False
        return True

    def read(self, deadline_s: float) -> bytes:
        """Some bytes; none once the connection has ended."""
        if self._ended:
            return b""
        self._socket.settimeout(_left_s(deadline_s))
        try:
            return self._socket.recv(READ_BYTES)
        except ConnectionError:
            return b""

    def receive(self, deadline_s: float) -> jsonrpc.Incoming | None:
        """The next message; None once the connection has ended."""
        while not self._arrived:
            data = self.read(deadline_s)
            if not data:
                return None
            self._arrived += self._inbox.feed(data)
        return self._arrived.popleft()

    def interrupt(self) -> None:
        """End it for whoever waits on it in another thread."""
        with contextlib.suppress(OSError):  # It had ended.
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Closed twice is closed; what came and was not received is dropped."""
        self._ended = True
        self._arrived.clear()
        self._socket.close()


def ask(connection: Connection, request_id: int, call: Call[ResultT], deadline_s: float) -> ResultT:
    """Send one request and wait for its answer; an error is raised."""
    sent = connection.send(jsonrpc.request(request_id, call.method, call.params), deadline_s)
    # A gateway that did not take it all may still have said why.
    answer = _answer(connection, request_id, call, deadline_s)
    if answer is None:
        raise call.unanswered(sent)
    result: ResultT = answer.value()
    return result


def _answer(
    connection: Connection, request_id: int, call: Call[ResultT], deadline_s: float
) -> jsonrpc.Response | None:
    """None where the connection ended instead."""
    try:
        while (incoming := connection.receive(deadline_s)) is not None:
            if isinstance(incoming, jsonrpc.Response) and incoming.concerns(request_id):
                return incoming
    except GarbledError as error:
        raise GarbledError(f"{error}{call.doubt}") from error
    return None


def _left_s(deadline_s: float) -> float:
    left_s = deadline_s - time.monotonic()
    if left_s <= 0:
        raise TimeoutError
    return left_s
