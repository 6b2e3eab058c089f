"""The client for threads."""

import itertools
import os
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Literal, Self, TypeVar

from vcu_gateway.api import results
from vcu_gateway.client import calls, metrics_page
from vcu_gateway.client.blocking_connection import Connection, ask
from vcu_gateway.client.blocking_subscription import Subscription
from vcu_gateway.client.calls import Call
from vcu_gateway.client.connect import default_socket_path
from vcu_gateway.client.errors import ApiError, ApiTimeoutError, DisconnectedError
from vcu_gateway.client.sync_demand import DemandOwner

ResultT = TypeVar("ResultT")


class Client:
    """Talks to the gateway; any number of threads may share one, they take turns.

    It connects on first use and again after a break. A request that only tells is then sent
    once more; one that changes something is not, and raises DisconnectedError, unless it is
    certain that the gateway never got it, or it stops the vehicle (`estop`, `disarm`).

    Every method raises UnreachableError, ApiTimeoutError, DisconnectedError or ApiError.
    """

    def __init__(
        self, socket_path: str | os.PathLike[str] | None = None, timeout_s: float = 2.0
    ) -> None:
        self.socket_path = Path(socket_path) if socket_path is not None else default_socket_path()
        self.timeout_s = timeout_s
        self._turn = threading.Lock()
        self._request_ids = itertools.count(1)
        self._connection: Connection | None = None

    def state(self, messages: Iterable[str] | None = None) -> results.State:
        """What is known and commanded now, of these messages or of all."""
        return self.call(calls.state(messages))

    def subscribe(
        self, messages: Iterable[str] | None = None, rate_hz: float = 10.0
    ) -> Subscription:
        """The state again and again, 0.1 to 50 times a second, on a connection of its own."""
        call = calls.subscribe(messages, rate_hz)
        return Subscription(self.socket_path, call, rate_hz, self.timeout_s)

    def why(self) -> results.Why:
        """Why the vehicle does or does not move, and what to do next."""
        return self.call(calls.why())

    def health(self) -> results.Health:
        """How the gateway itself fares: bus, ticks, counters, versions."""
        return self.call(calls.health())

    def events(self, limit: int = 50) -> results.Events:
        """The latest events, 1 to 200 of them."""
        return self.call(calls.events(limit))

    def config(self) -> results.ConfigInEffect:
        """The configuration in effect."""
        return self.call(calls.config())

    def protocol(self) -> results.Protocol:
        """The bus's messages and signals."""
        return self.call(calls.protocol())

    def arm(self) -> results.Granted:
        """From standby to active; needs a fresh demand without throttle."""
        return self.call(calls.arm())

    def disarm(self) -> results.Granted:
        """From active to standby."""
        return self.call(calls.disarm())

    def reset(self, level: Literal["driver", "service"] = "driver") -> results.Granted:
        """From fault to starting."""
        return self.call(calls.reset(level))

    def estop(self) -> results.Granted:
        """Cut the power of both controllers, until a reset at service level."""
        return self.call(calls.estop())

    def reload(self) -> results.Reloaded:
        """Let the gateway read its configuration file again, all of it or nothing."""
        return self.call(calls.reload())

    def demand(self, source: str, *, ttl_ms: int = 200, hold_s: float | None = 0.5) -> DemandOwner:
        """Ask for throttle and brake in this name; see DemandOwner."""
        return DemandOwner(self.socket_path, source, ttl_ms, hold_s, self.timeout_s)

    def metrics(self) -> str:
        """The metrics in Prometheus's text format."""
        deadline_s = time.monotonic() + self.timeout_s
        connection = Connection(self.socket_path)
        try:
            return _page(connection, deadline_s).text()
        except TimeoutError:
            sentence = f"no page of metrics within {self.timeout_s:g} s"
            raise ApiTimeoutError(sentence) from None
        finally:
            connection.close()

    def call(self, call: Call[ResultT]) -> ResultT:
        """Send any request of `calls` and return its result."""
        deadline_s = time.monotonic() + self.timeout_s
        if not self._turn.acquire(timeout=self.timeout_s):
            raise ApiTimeoutError(f"{call.method} was not sent: other threads' requests hang")
        try:
            return self._answered(call, deadline_s)
        except TimeoutError:
            raise call.late(self.timeout_s) from None
        finally:
            self._turn.release()

    def _answered(self, call: Call[ResultT], deadline_s: float) -> ResultT:
        try:
            return self._once(call, deadline_s)
        except DisconnectedError as broken:
            if not call.may_go_again(broken):
                raise
        return self._once(call, deadline_s)

    def _once(self, call: Call[ResultT], deadline_s: float) -> ResultT:
        self._connection = self._connection or Connection(self.socket_path)
        try:
            return ask(self._connection, next(self._request_ids), call, deadline_s)
        except ApiError:
            raise
        except BaseException:
            # Whatever was not an answer leaves the connection in an unknown state.
            self._drop()
            raise

    def _drop(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def close(self) -> None:
        """Close the connection; the next call opens a new one."""
        with self._turn:
            self._drop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _page(connection: Connection, deadline_s: float) -> metrics_page.Page:
    """All that the gateway answers before it closes."""
    connection.send(metrics_page.REQUEST, deadline_s)
    page = metrics_page.Page()
    while data := connection.read(deadline_s):
        page.feed(data)
    return page
