"""The state again and again, for a thread."""

import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self, cast

from vcu_gateway.api import results
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.blocking_connection import Connection, ask
from vcu_gateway.client.calls import Call
from vcu_gateway.client.errors import ApiTimeoutError, GarbledError

_LOWEST_RATE_HZ = 0.1


class Subscription:
    """An iterator of updates with a connection of its own; it ends with that connection.

    `update["lost"]` counts what was not sent because this reader was slow. ApiTimeoutError
    where an update is overdue by the client's timeout. Use `with` where the loop may end early.
    """

    def __init__(
        self, path: Path, call: Call[results.Subscribed], rate_hz: float, timeout_s: float
    ) -> None:
        self._patience_s = timeout_s + 1 / max(rate_hz, _LOWEST_RATE_HZ)
        self._reading = threading.Lock()
        self._connection = Connection(path)
        try:
            ask(self._connection, 1, call, time.monotonic() + timeout_s)
        except BaseException as error:
            self._connection.close()
            if isinstance(error, TimeoutError):
                raise call.late(timeout_s) from None
            raise

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> results.Update:
        with self._reading:
            update = self._following()
            if update is None:
                self._connection.close()
                raise StopIteration
            return update

    def _following(self) -> results.Update | None:
        """The next update; None once the connection has ended."""
        try:
            return self._update(time.monotonic() + self._patience_s)
        except TimeoutError:
            raise ApiTimeoutError(f"no update within {self._patience_s:g} s") from None
        except GarbledError:
            self._connection.close()
            raise

    def _update(self, deadline_s: float) -> results.Update | None:
        while (incoming := self._connection.receive(deadline_s)) is not None:
            if isinstance(incoming, jsonrpc.Notification) and incoming.method == "state.update":
                return cast(results.Update, incoming.params)
        return None

    def close(self) -> None:
        """End it, from any thread; one that waits for an update gets no further one."""
        self._connection.interrupt()
        if self._reading.acquire(blocking=False):
            self._connection.close()
            self._reading.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
