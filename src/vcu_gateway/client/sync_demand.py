"""Demand owner of the synchronous client: a thread drives the demand session."""

import math
import select
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self, Unpack

from vcu_gateway.client.demand import (
    RELEASE_TIMEOUT_S,
    RELEASED_BEFORE_ARMING_S,
    DemandValues,
    OwnedDemand,
    request_values,
)
from vcu_gateway.client.errors import ClientError
from vcu_gateway.units import NS_PER_MS, NS_PER_S


class DemandOwner(OwnedDemand):
    """Owner of one source's demand, on a connection of its own; a dead-man's handle.

    `set` sends at once. Between two calls a thread repeats the last values, but only until
    `hold_s` after the last `set`: then it demands no throttle and no brake, so that a control
    loop that hangs does not leave its last throttle on. With `hold_s=None` the values hold for
    as long as this process lives. Independent of it, the gateway ends a demand `ttl_ms` after
    it was made, and when its connection ends: that covers a killed or frozen process.

    Entering demands no motion and returns 0.2 s after the gateway has granted that, so that
    `arm` is possible. Leaving, also by an exception, demands no motion and releases the demand.

    A broken connection is reopened. Values set before, or meanwhile, do not come back: no
    motion is demanded until the next `set`. Only `motor_reverse` outlasts `hold_s`, a refusal
    and a break, because changing the direction is a request of its own.

    Any thread may call `set`. The owner can be entered once.
    """

    def __init__(
        self, path: Path, source: str, ttl_ms: int, hold_s: float | None, timeout_s: float
    ) -> None:
        super().__init__(path, source, ttl_ms, hold_s, timeout_s)
        self._stepped = threading.Condition()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"demand {source}", daemon=True)

    def set(self, **values: Unpack[DemandValues]) -> None:
        """Demand the same of both controllers, or of each: `set(PCU1={...}, PCU2={...})`.

        What is left out is at its default; numbers must be finite (ValueError), the gateway
        checks the rest. Does not wait for the answer: a refusal is raised by the next `set`,
        which then sends nothing. Without a connection the values are dropped; see `connected`.
        """
        made_ns = time.monotonic_ns()
        checked = request_values(values)
        if not self._thread.is_alive():
            raise ClientError("the demand is not entered, or released")
        with self._stepped:
            self._session.send_values(checked, made_ns)

    def release(self) -> None:
        """Demand no motion, end the demand and the connection; again, it does nothing."""
        try:
            for send in (self._session.end_motion, self._session.release):
                with self._stepped:
                    send(time.monotonic_ns())
                self._wait_for(lambda: self._session.settled, RELEASE_TIMEOUT_S)
        finally:
            self._end()

    def __enter__(self) -> Self:
        if self._ended.is_set():
            raise ClientError("a released demand cannot be entered again")
        with self._stepped:
            self._session.open(time.monotonic_ns())
            self._thread.start()
        try:
            self._wait_for(lambda: self._dead_man.answered, self._timeout_s)
            self._dead_man.check_first_answer(self._timeout_s)
            self._ended.wait(RELEASED_BEFORE_ARMING_S)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        self.release()

    def _wait_for(self, condition: Callable[[], bool], timeout_s: float) -> None:
        with self._stepped:
            self._stepped.wait_for(condition, timeout_s)

    def _end(self) -> None:
        self._ended.set()
        with self._stepped:
            self._session.shutdown()  # Wakes the thread.
        if self._thread.is_alive():
            self._thread.join()
        self._session.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            with self._stepped:
                next_step_ns = self._session.step(time.monotonic_ns())
                connection = self._session.socket
                self._stepped.notify_all()
            self._wait_for_input(connection, next_step_ns)

    def _wait_for_input(self, connection: socket.socket | None, until_ns: int) -> None:
        timeout_ns = max(0, until_ns - time.monotonic_ns())
        if connection is None:
            self._ended.wait(timeout_ns / NS_PER_S)
            return
        readable = select.poll()
        readable.register(connection, select.POLLIN)
        readable.poll(math.ceil(timeout_ns / NS_PER_MS))
