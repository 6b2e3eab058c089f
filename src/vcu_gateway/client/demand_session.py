"""The connection of one demand: sends, repeats and reconnects. It never waits.

Sans-IO in all but the non-blocking socket: time is an argument, and a thread or an asyncio task
calls `DemandSession.step` when the socket is readable or the time that `step` returned has come.
"""

import contextlib
import socket
from collections.abc import Mapping
from pathlib import Path

from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.connect import connect
from vcu_gateway.client.demand import DeadMan, DemandRequest, RequestValues
from vcu_gateway.client.errors import GarbledError, UnreachableError
from vcu_gateway.units import NS_PER_S

_READ_BYTES = 65536
_FIRST_RETRY_NS = 50_000_000
_LONGEST_RETRY_NS = 1_000_000_000


class DemandSession:
    """Sends new demands and the repetitions of its `dead_man`; reconnects by itself.

    Only `step` and `close` close the socket, so that nobody waits on one that is closed.

    Attributes:
        socket: None while there is no connection.
    """

    def __init__(self, path: Path, dead_man: DeadMan, timeout_s: float) -> None:
        self.dead_man = dead_man
        self.socket: socket.socket | None = None
        self._path = path
        self._timeout_ns = round(timeout_s * NS_PER_S)
        self._decoder = jsonrpc.MessageDecoder()
        self._broken = False
        self._released = False
        self._unanswered: dict[int | None, str] = {}
        self._waiting_since_ns = 0
        self._retry_ns = 0
        self._backoff_ns = _FIRST_RETRY_NS

    @property
    def connected(self) -> bool:
        return self.socket is not None and not self._broken

    @property
    def settled(self) -> bool:
        """Whether no further answer can come."""
        return not self.connected or not self._unanswered

    def open(self, now_ns: int) -> None:
        """Connect and demand no motion; UnreachableError where no process listens."""
        self.socket = connect(self._path)
        self._decoder = jsonrpc.MessageDecoder()
        self._unanswered.clear()
        self.dead_man.end_motion()
        self._send_demand(self.dead_man.repeat(now_ns), now_ns)

    def send_values(self, values: RequestValues, now_ns: int) -> None:
        """Send new values now; without a connection they are dropped, never sent later."""
        demand = self.dead_man.new_values(values, now_ns)
        if self.connected:
            self._send_demand(demand, now_ns)

    def end_motion(self, now_ns: int) -> None:
        self.dead_man.end_motion()
        if self.connected:
            self._send_demand(self.dead_man.repeat(now_ns), now_ns)

    def release(self, now_ns: int) -> None:
        """End the demand now; no repetition and no reconnection from here on."""
        self._released = True
        if self.connected:
            params = {"source": self.dead_man.source}
            self._send("demand.release", self.dead_man.next_sequence(now_ns), params, now_ns)

    def step(self, now_ns: int) -> int:
        """Read answers, repeat what is due, reconnect; returns when to step again at the latest."""
        if self.socket is not None:
            self._read(self.socket, now_ns)
        if not self._released and self.connected and self.dead_man.due_ns <= now_ns:
            self._send_demand(self.dead_man.repeat(now_ns), now_ns)
        if self._broken:
            self._disconnect(now_ns)
        if self._released:
            return now_ns + _LONGEST_RETRY_NS
        if self.socket is None and self._retry_ns <= now_ns:
            self._reconnect(now_ns)
        return self._retry_ns if self.socket is None else self.dead_man.due_ns

    def shutdown(self) -> None:
        """Shut the connection down, which makes `socket` readable; `close` is still due."""
        if self.socket is not None:
            with contextlib.suppress(OSError):  # It had ended.
                self.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def _send_demand(self, demand: DemandRequest, now_ns: int) -> None:
        self._send("demand.set", demand["sequence"], demand, now_ns)

    def _send(self, method: str, number: int, params: Mapping[str, object], now_ns: int) -> None:
        """A gateway that does not take a whole line at once has hung: the connection is broken."""
        assert self.socket is not None  # noqa: S101 - who calls has it open
        if not self._unanswered:
            self._waiting_since_ns = now_ns
        self._unanswered[number] = method
        line = jsonrpc.request(number, method, params)
        try:
            self._broken = self.socket.send(line) < len(line)
        except OSError:
            self._broken = True

    def _read(self, connection: socket.socket, now_ns: int) -> None:
        try:
            data = connection.recv(_READ_BYTES)
            self._broken |= not data
            self._handle(self._decoder.feed(data), now_ns)
        except BlockingIOError:
            self._broken |= self._timed_out(now_ns)
        except (OSError, GarbledError):
            self._broken = True

    def _timed_out(self, now_ns: int) -> bool:
        return bool(self._unanswered) and now_ns - self._waiting_since_ns > self._timeout_ns

    def _handle(self, messages: list[jsonrpc.Incoming], now_ns: int) -> None:
        for message in messages:
            if isinstance(message, jsonrpc.Response):
                self._waiting_since_ns = now_ns
                self._handle_response(message)

    def _handle_response(self, response: jsonrpc.Response) -> None:
        method = self._unanswered.pop(response.id, "")
        if response.id is not None and method != "demand.set":
            return
        if response.error is None:
            self._backoff_ns = _FIRST_RETRY_NS
            self.dead_man.granted(response.result)
        elif response.error.code != ErrorCode.NOT_READY.value:
            self.dead_man.refused(response.error)

    def _disconnect(self, now_ns: int) -> None:
        self.close()
        self._broken = False
        self._retry_ns = now_ns + self._backoff_ns
        self._backoff_ns = min(2 * self._backoff_ns, _LONGEST_RETRY_NS)

    def _reconnect(self, now_ns: int) -> None:
        try:
            self.open(now_ns)
        except UnreachableError:
            self._disconnect(now_ns)
