"""The demand of one source, kept by a thread."""

import math
import select
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self, Unpack

from vcu_gateway.api import results
from vcu_gateway.client.demand import DemandRequest, request_values
from vcu_gateway.client.demand_session import DemandSession
from vcu_gateway.client.errors import ApiError, ApiTimeoutError, ClientError
from vcu_gateway.client.keeping import RELEASED_S, DeadMan
from vcu_gateway.units import NS_PER_MS, NS_PER_S

_FAREWELL_S = 0.2


class DemandOwner:
    """Asks for throttle and brake in one source's name, on a connection of its own.

    `set` sends at once. Between two calls a thread repeats the last values, but only until
    `hold_s` after the last `set`: then it asks for no throttle and no brake. This is a
    dead-man's handle: a control loop that hangs does not leave its last throttle on. With
    `hold_s=None` the values hold for as long as this process lives. Independent of it, the
    gateway ends a demand `ttl_ms` after it was made, and when its connection ends: a killed
    or frozen process is covered by that.

    Entering asks for no motion and returns 0.2 s after the gateway has granted that, so that
    `arm` is possible. Leaving, also by an exception, asks for no motion and releases the demand.

    A broken connection is mended by itself. What was asked for before, or meanwhile, does not
    come back: no motion is asked for until the next `set`. Only `motor_reverse` outlasts
    `hold_s`, a refusal and a break, because changing the direction is a request of its own.

    Any thread may call `set`. The owner can be entered once.
    """

    def __init__(
        self, path: Path, source: str, ttl_ms: int, hold_s: float | None, timeout_s: float
    ) -> None:
        self._timeout_s = timeout_s
        self._keeping = DeadMan(source, ttl_ms, hold_s)
        self._link = DemandSession(path, self._keeping, timeout_s)
        self._stepped = threading.Condition()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._keep, name=f"demand {source}", daemon=True)

    def set(self, **asked: Unpack[DemandRequest]) -> None:
        """Ask for the same of both controllers, or of each: `set(PCU1={...}, PCU2={...})`.

        What is left out is at its default; numbers must be finite (ValueError), the gateway
        judges the rest. Does not wait for the answer: a refusal is raised by the next `set`,
        which then sends nothing. Without a connection the values are dropped; see `connected`.
        """
        made_ns = time.monotonic_ns()
        body = request_values(asked)
        if not self._thread.is_alive():
            raise ClientError("the demand is not entered, or released")
        with self._stepped:
            self._link.ask(body, made_ns)

    @property
    def connected(self) -> bool:
        """Whether a `set` reaches the gateway now."""
        return self._link.connected

    @property
    def refusal(self) -> ApiError | None:
        """The latest refusal, until it was raised and a later demand granted."""
        return self._keeping.refusal

    @property
    def last_answer(self) -> results.Granted | None:
        """What the gateway granted last, with its mode then; None before the first."""
        return self._keeping.last_answer

    def release(self) -> None:
        """Ask for no motion, end the demand and the connection; again, it does nothing."""
        try:
            for last_word in (self._link.still, self._link.release):
                with self._stepped:
                    last_word(time.monotonic_ns())
                self._wait(lambda: self._link.settled, _FAREWELL_S)
        finally:
            self._end()

    def __enter__(self) -> Self:
        if self._ended.is_set():
            raise ClientError("a released demand cannot be entered again")
        with self._stepped:
            self._link.open(time.monotonic_ns())
            self._thread.start()
        try:
            self._await_first_answer()
            self._ended.wait(RELEASED_S)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    def _await_first_answer(self) -> None:
        heard = self._wait(lambda: bool(self.last_answer or self.refusal), self._timeout_s)
        if self.refusal is not None:
            raise self.refusal
        if not heard:
            sentence = f"the gateway took no demand within {self._timeout_s:g} s"
            raise ApiTimeoutError(sentence)

    def _wait(self, done: Callable[[], bool], timeout_s: float) -> bool:
        with self._stepped:
            return self._stepped.wait_for(done, timeout_s)

    def _end(self) -> None:
        self._ended.set()
        with self._stepped:
            self._link.hang_up()  # Wakes the thread.
        if self._thread.is_alive():
            self._thread.join()
        self._link.close()

    def _keep(self) -> None:
        while not self._ended.is_set():
            with self._stepped:
                again_ns = self._link.step(time.monotonic_ns())
                connection = self._link.socket
                self._stepped.notify_all()
            self._pause(connection, again_ns)

    def _pause(self, connection: socket.socket | None, again_ns: int) -> None:
        pause_ns = max(0, again_ns - time.monotonic_ns())
        if connection is None:
            self._ended.wait(pause_ns / NS_PER_S)
            return
        readable = select.poll()
        readable.register(connection, select.POLLIN)
        readable.poll(math.ceil(pause_ns / NS_PER_MS))
