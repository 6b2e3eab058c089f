"""One connection for asyncio: no task, no transport; whoever waits is the one who reads."""

import asyncio
import contextlib
import socket
from collections import deque
from pathlib import Path
from typing import TypeVar

from vcu_gateway.client import jsonrpc
from vcu_gateway.client.calls import Call
from vcu_gateway.client.connect import connect
from vcu_gateway.client.errors import GarbledError

ResultT = TypeVar("ResultT")

READ_BYTES = 65536


class AsyncConnection:
    """Lines to the gateway and messages from it; time limits are the caller's."""

    def __init__(self, path: Path) -> None:
        self._socket = connect(path)
        self._inbox = jsonrpc.MessageDecoder()
        self._arrived: deque[jsonrpc.Incoming] = deque()
        self._ended = False
        self._reading = False

    async def send(self, data: bytes) -> bool:
        """False where the gateway had closed before it had all of it."""
        try:
            await asyncio.get_running_loop().sock_sendall(self._socket, data)
        except ConnectionError:
            return False
        return True

    async def read(self) -> bytes:
        """Some bytes; none once the connection has ended."""
        if self._ended:
            return b""
        self._reading = True
        try:
            return await asyncio.get_running_loop().sock_recv(self._socket, READ_BYTES)
        except ConnectionError:
            return b""
        finally:
            self._reading = False
            if self._ended:
                self._socket.close()

    async def receive(self) -> jsonrpc.Incoming | None:
        """The next message; None once the connection has ended."""
        while not self._arrived:
            data = await self.read()
            if not data:
                return None
            self._arrived += self._inbox.feed(data)
        return self._arrived.popleft()

    def close(self) -> None:
        """Closed twice is closed; what came and was not received is dropped."""
        self._ended = True
        self._arrived.clear()
        if not self._reading:
            self._socket.close()
            return
        with contextlib.suppress(OSError):  # Wakes whoever reads, who closes.
            self._socket.shutdown(socket.SHUT_RDWR)


async def ask(connection: AsyncConnection, request_id: int, call: Call[ResultT]) -> ResultT:
    """Send one request and wait for its answer; an error is raised."""
    sent = await connection.send(jsonrpc.request(request_id, call.method, call.params))
    # A gateway that did not take it all may still have said why.
    answer = await _answer(connection, request_id, call)
    if answer is None:
        raise call.unanswered(sent)
    result: ResultT = answer.value()
    return result


async def _answer(
    connection: AsyncConnection, request_id: int, call: Call[ResultT]
) -> jsonrpc.Response | None:
    """None where the connection ended instead."""
    try:
        while (incoming := await connection.receive()) is not None:
            if isinstance(incoming, jsonrpc.Response) and incoming.concerns(request_id):
                return incoming
    except GarbledError as error:
        raise GarbledError(f"{error}{call.doubt}") from error
    return None
