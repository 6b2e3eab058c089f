"""A gateway that the test speaks for, line by line; for what an order of lines decides."""

import contextlib
import json
import select
import socket
from pathlib import Path
from typing import Any, Self

from tests.client.fake_gateway import PATIENCE_S

_A_MOMENT_S = 0.05


class Scripted:
    """One connection, taken when its first line is read.

    Attributes:
        last: the request that was read last.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.last: dict[str, Any] = {}
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen()
        self._listener.settimeout(PATIENCE_S)
        self._connection: socket.socket | None = None

    @property
    def connection(self) -> socket.socket:
        if self._connection is None:
            self._connection = self._listener.accept()[0]
            self._connection.settimeout(PATIENCE_S)
        return self._connection

    def read(self) -> dict[str, Any]:
        """The next request."""
        line = b""
        while not line.endswith(b"\n"):
            line += self.connection.recv(1)
        self.last = json.loads(line)
        return self.last

    def grant(self, request: dict[str, Any] | None = None) -> None:
        """Grant this request, or the next."""
        answered = request or self.read()
        answer = {"jsonrpc": "2.0", "id": answered["id"], "result": {"granted": True}}
        self.connection.sendall(json.dumps(answer).encode() + b"\n")

    def end_unread(self) -> None:
        """End the connection once a request has come, without reading it."""
        select.select([self.connection], [], [], PATIENCE_S)
        self.connection.close()

    def dribble(self) -> None:
        """Answer the next request with an endless line, a little at a time."""
        self.read()
        with contextlib.suppress(OSError):
            while self.has_nothing_to_read():
                self.connection.sendall(b" ")

    def has_nothing_to_read(self) -> bool:
        """Whether the client waits, seen for a moment."""
        return not select.select([self.connection], [], [], _A_MOMENT_S)[0]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._listener.close()
        if self._connection is not None:
            self._connection.close()
