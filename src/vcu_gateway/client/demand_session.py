"""The connection that carries one source's demand. Nothing here waits; time is an argument."""

import contextlib
import socket
from collections.abc import Mapping
from pathlib import Path

from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.connect import connect
from vcu_gateway.client.demand import RequestValues
from vcu_gateway.client.errors import GarbledError, UnreachableError
from vcu_gateway.client.keeping import DeadMan, Demand
from vcu_gateway.units import NS_PER_S

_READ_BYTES = 65536
_FIRST_RETRY_NS = 50_000_000
_LAST_RETRY_NS = 1_000_000_000


class DemandSession:
    """Sends what an owner asks for and what its keeping repeats; reconnects by itself.

    Whoever drives it calls `step` when `socket` is readable or `step`'s time has come. Only
    `step` and `close` close the socket, so that nobody waits on one that is closed.

    Attributes:
        socket: None while there is no connection.
    """

    def __init__(self, path: Path, keeping: DeadMan, timeout_s: float) -> None:
        self.keeping = keeping
        self.socket: socket.socket | None = None
        self._path = path
        self._patience_ns = round(timeout_s * NS_PER_S)
        self._inbox = jsonrpc.MessageDecoder()
        self._broken = False
        self._released = False
        self._unanswered: dict[int | None, str] = {}
        self._heard_ns = 0
        self._retry_ns = 0
        self._next_pause_ns = _FIRST_RETRY_NS

    @property
    def connected(self) -> bool:
        """Whether a demand can be sent now."""
        return self.socket is not None and not self._broken

    @property
    def settled(self) -> bool:
        """Nothing is on its way whose answer could still come."""
        return not self.connected or not self._unanswered

    def open(self, now_ns: int) -> None:
        """Connect and ask for no motion; UnreachableError where nobody listens."""
        self.socket = connect(self._path)
        self._inbox = jsonrpc.MessageDecoder()
        self._unanswered.clear()
        self.keeping.still()
        self._send_demand(self.keeping.repeat(now_ns), now_ns)

    def ask(self, body: RequestValues, now_ns: int) -> None:
        """Send new values now; without a connection they are dropped, never sent later."""
        demand = self.keeping.ask(body, now_ns)
        if self.connected:
            self._send_demand(demand, now_ns)

    def still(self, now_ns: int) -> None:
        """Ask for no motion now."""
        self.keeping.still()
        if self.connected:
            self._send_demand(self.keeping.repeat(now_ns), now_ns)

    def release(self, now_ns: int) -> None:
        """End the demand now; nothing is repeated or mended from here on."""
        self._released = True
        if self.connected:
            params = {"source": self.keeping.source}
            self._send("demand.release", self.keeping.next_number(now_ns), params, now_ns)

    def step(self, now_ns: int) -> int:
        """Read answers, repeat what is due, mend the connection; when to come again at latest."""
        if self.socket is not None:
            self._read(self.socket, now_ns)
        if not self._released and self.connected and self.keeping.due_ns <= now_ns:
            self._send_demand(self.keeping.repeat(now_ns), now_ns)
        if self._broken:
            self._lose(now_ns)
        if self._released:
            return now_ns + _LAST_RETRY_NS
        if self.socket is None and self._retry_ns <= now_ns:
            self._reopen(now_ns)
        return self._retry_ns if self.socket is None else self.keeping.due_ns

    def hang_up(self) -> None:
        """End the connection for whoever waits on `socket`."""
        if self.socket is not None:
            with contextlib.suppress(OSError):  # It had ended.
                self.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the connection, which ends the demand."""
        if self.socket is not None:
            self.socket.close()
            self.socket = None

    def _send_demand(self, demand: Demand, now_ns: int) -> None:
        self._send("demand.set", demand["sequence"], demand, now_ns)

    def _send(self, method: str, number: int, params: Mapping[str, object], now_ns: int) -> None:
        """A gateway that does not take a whole line at once has hung: the connection is broken."""
        assert self.socket is not None  # noqa: S101
        if not self._unanswered:
            self._heard_ns = now_ns
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
            self._take(self._inbox.feed(data), now_ns)
        except BlockingIOError:
            self._broken |= self._hangs(now_ns)
        except (OSError, GarbledError):
            self._broken = True

    def _hangs(self, now_ns: int) -> bool:
        return bool(self._unanswered) and now_ns - self._heard_ns > self._patience_ns

    def _take(self, arrived: list[jsonrpc.Incoming], now_ns: int) -> None:
        for incoming in arrived:
            if isinstance(incoming, jsonrpc.Response):
                self._heard_ns = now_ns
                self._heed(incoming)

    def _heed(self, answer: jsonrpc.Response) -> None:
        method = self._unanswered.pop(answer.id, "")
        if answer.id is not None and method != "demand.set":
            return
        if answer.error is None:
            self._next_pause_ns = _FIRST_RETRY_NS
            self.keeping.granted(answer.result)
        elif answer.error.code != ErrorCode.NOT_READY.value:
            self.keeping.refused(answer.error)

    def _lose(self, now_ns: int) -> None:
        self.close()
        self._broken = False
        self._retry_ns = now_ns + self._next_pause_ns
        self._next_pause_ns = min(2 * self._next_pause_ns, _LAST_RETRY_NS)

    def _reopen(self, now_ns: int) -> None:
        try:
            self.open(now_ns)
        except UnreachableError:
            self._lose(now_ns)
