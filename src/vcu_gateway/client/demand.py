"""Demand values, the dead-man that repeats and ends them, and their connection. It never waits.

Sans-IO in all but the non-blocking socket: time is an argument, and a thread or an asyncio task
calls `DemandSession.step` when the socket is readable or the time that `step` returned has come.
"""

import contextlib
import math
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict, get_args

from vcu_gateway.api import results
from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.errors import ApiError, ApiTimeoutError, GarbledError, UnreachableError
from vcu_gateway.client.jsonrpc import connect
from vcu_gateway.units import NS_PER_MS, NS_PER_S, NS_PER_US

_SHORTEST_PERIOD_NS = 1_000_000
_LONGEST_PERIOD_NS = 1_000_000_000
_DIRECTIONS_DIFFER = "directions_differ"

CONTROLLERS: tuple[str, ...] = get_args(results.ControllerName)

RELEASED_BEFORE_ARMING_S = 0.2
"""Duration of released throttle that the gateway requires before it can be armed."""

RELEASE_TIMEOUT_S = 0.2
"""Longest wait for the answers, once for the end of motion and once for the release."""


class ControllerValues(TypedDict, total=False):
    """Demand for one controller; what is left out is at the gateway's default.

    The gateway refuses a value outside its range in `vcu_gateway.demand_ranges.RANGES`.
    """

    throttle_pct: float
    throttle_track2_pct: float | None
    """The pedal's second track; None where there is none."""
    brake_pct: float
    power_mode: results.PowerModeName
    motor_reverse: bool
    regen_brake: bool
    speed_limit_rpm: float | None
    """None is the configured maximum."""
    power_limit_w: float | None
    """None is the configured maximum."""


class DemandValues(ControllerValues, total=False):
    """Demand for both controllers: the same values, or different ones for each."""

    PCU1: ControllerValues
    PCU2: ControllerValues


DemandRequest = Mapping[str, Any]
"""Parameters of one `demand.set` request."""

RequestValues = Mapping[str, Mapping[str, Any]]
"""The members of a `DemandRequest` that hold values: `values`, `controllers`."""

# Both tracks, because the gateway may require the second.
NO_MOTION: RequestValues = {
    "values": {"throttle_pct": 0.0, "throttle_track2_pct": 0.0, "brake_pct": 0.0},
}


def request_values(values: Mapping[str, Any]) -> RequestValues:
    """Demand values in the request's form; the gateway checks them.

    Raises:
        ValueError: a number is not finite.
    """
    controllers = {name: values[name] for name in CONTROLLERS if name in values}
    common = {name: values[name] for name in values if name not in CONTROLLERS}
    members: dict[str, Mapping[str, Any]] = {}
    if controllers:
        members["controllers"] = {name: _finite(one) for name, one in controllers.items()}
    if common or not controllers:
        members["values"] = _finite(common)
    return members


def without_motion(values: RequestValues) -> RequestValues:
    """No throttle and no brake; the direction stays, for changing it is a request of its own."""
    if "controllers" in values:
        controllers = values["controllers"]
        stopped = {name: _without_motion(controllers.get(name, {})) for name in CONTROLLERS}
        return {"controllers": stopped}
    return {"values": _without_motion(values["values"])}


class DeadMan:
    """Dead-man's handle: numbers demands, repeats the last values and ends them.

    Values are repeated every third of their time to live, until `hold_s` after they were set;
    from then on no throttle and no brake is demanded. The same follows a refusal and a new
    connection, until values are set again. Times are in nanoseconds of one monotonic clock.

    Attributes:
        refusal: the error that `new_values` raises next or raised last; None again once a later
            demand is granted.
        last_answer: the latest granted result; None before the first.
        due_ns: when `repeat` is due.
    """

    def __init__(self, source: str, ttl_ms: int, hold_s: float | None) -> None:
        self.source = source
        self.refusal: ApiError | None = None
        self.last_answer: results.Granted | None = None
        self.due_ns = 0
        self._ttl_ms = ttl_ms
        self._hold_ns = None if hold_s is None else round(hold_s * NS_PER_S)
        self._values: RequestValues = NO_MOTION
        self._hold_end_ns: int | None = None
        self._refusal_raised = True
        self._sequence = 0
        self._refused_in_a_row = 0

    def new_values(self, values: RequestValues, now_ns: int) -> DemandRequest:
        """The request for new values; instead raises a refusal that was not raised yet."""
        if self.refusal is not None and not self._refusal_raised:
            self._refusal_raised = True
            raise self.refusal
        self._values = values
        self._hold_end_ns = None if self._hold_ns is None else now_ns + self._hold_ns
        return self._request(now_ns)

    def repeat(self, now_ns: int) -> DemandRequest:
        """The request for the last values, stamped now, or for no motion after their hold."""
        if self._hold_end_ns is not None and now_ns >= self._hold_end_ns:
            self.end_motion()
        return self._request(now_ns)

    def end_motion(self) -> None:
        self._values = without_motion(self._values)
        self._hold_end_ns = None

    def next_sequence(self, now_ns: int) -> int:
        """A rising number, also above those of an earlier process on the same machine."""
        self._sequence = max(self._sequence + 1, now_ns // NS_PER_US)
        return self._sequence

    def granted(self, answer: results.Granted) -> None:
        self.last_answer = answer
        self._refused_in_a_row = 0
        if self._refusal_raised:
            self.refusal = None

    def refused(self, error: ApiError) -> None:
        """Note that the gateway refused a demand: no motion, after the first refusal at once."""
        self.refusal, self._refusal_raised = error, False
        self._refused_in_a_row += 1
        self.end_motion()
        if error.refusal == _DIRECTIONS_DIFFER:
            self._values = NO_MOTION
        if self._refused_in_a_row == 1:
            self.due_ns = 0

    @property
    def answered(self) -> bool:
        return bool(self.last_answer or self.refusal)

    def check_first_answer(self, timeout_s: float) -> None:
        """Raise the refusal of the first demand, or ApiTimeoutError without an answer."""
        if self.refusal is not None:
            raise self.refusal
        if not self.answered:
            raise ApiTimeoutError(f"the gateway took no demand within {timeout_s:g} s")

    def _request(self, now_ns: int) -> DemandRequest:
        self.due_ns = now_ns + self._period_ns()
        if self._hold_end_ns is not None:
            self.due_ns = min(self.due_ns, self._hold_end_ns)
        return {
            "source": self.source,
            "sequence": self.next_sequence(now_ns),
            "ttl_ms": self._ttl_ms,
            "made_ns": now_ns,
            **self._values,
        }

    def _period_ns(self) -> int:
        """A third of the time to live; doubled with each refusal in a row, up to a second."""
        period_ns = max(self._ttl_ms * NS_PER_MS // 3, _SHORTEST_PERIOD_NS)
        backoff_ns = period_ns << min(self._refused_in_a_row, 10)
        return min(backoff_ns, max(period_ns, _LONGEST_PERIOD_NS))


def _without_motion(values: Mapping[str, Any]) -> Mapping[str, Any]:
    # Nothing else is copied: what was refused for a wrong value must not be refused again.
    if values.get("motor_reverse") is True:
        return {**NO_MOTION["values"], "motor_reverse": True}
    return NO_MOTION["values"]


def _finite(values: Mapping[str, Any]) -> Mapping[str, Any]:
    return {name: _finite_number(name, value) for name, value in values.items()}


def _finite_number(name: str, value: object) -> object:
    if value is None or isinstance(value, str | bool):
        return value
    try:
        number = float(value)  # type: ignore[arg-type]  # TypeError is the right answer
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} is {number}; it must be a finite number")
    return number


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
            waited_ns = now_ns - self._waiting_since_ns
            self._broken |= bool(self._unanswered) and waited_ns > self._timeout_ns
        except (OSError, GarbledError):
            self._broken = True

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


class OwnedDemand:
    """A demand as its owner, synchronous or not, holds it and tells of it."""

    def __init__(
        self, path: Path, source: str, ttl_ms: int, hold_s: float | None, timeout_s: float
    ) -> None:
        self._timeout_s = timeout_s
        self._dead_man = DeadMan(source, ttl_ms, hold_s)
        self._session = DemandSession(path, self._dead_man, timeout_s)

    @property
    def connected(self) -> bool:
        """Whether a `set` reaches the gateway now."""
        return self._session.connected

    @property
    def refusal(self) -> ApiError | None:
        """The latest refusal, until it was raised and a later demand granted."""
        return self._dead_man.refusal

    @property
    def last_answer(self) -> results.Granted | None:
        """The latest granted result, with the mode then; None before the first."""
        return self._dead_man.last_answer
