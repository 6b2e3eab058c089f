"""What the fake gateway answers: as little of a gateway as its clients can see."""

import threading
import time
from collections.abc import Mapping
from typing import Any

from vcu_gateway.api.errors import ErrorCode, RequestError

CONTROLLERS = ("PCU1", "PCU2")
RANGES = {"throttle_pct": 100.0, "brake_pct": 100.0}
VALUES = {"throttle_pct": 0.0, "brake_pct": 0.0, "power_mode": "eco", "motor_reverse": False}
SIGNAL = {"value": 52.1, "raw": 521, "unit": "V", "quality": "good"}
MESSAGES: Mapping[str, Any] = {
    name: {
        "frame_count": 7,
        "marked_count": 0,
        "age_ms": 12.5,
        "period_ms": 500.0,
        "stale": False,
        "signals": {"PackVoltage": SIGNAL},
    }
    for name in ("BMS_Status", "PCU1_Status1")
}


def refused(refusal: str, sentence: str) -> RequestError:
    return RequestError(ErrorCode.REFUSED, sentence, refusal)


class Vehicle:
    """A healthy one, in standby. One lock; every method is called from connections' threads.

    Attributes:
        demands_expire: False for a drive on a busy machine whose test is about something else.
    """

    def __init__(self) -> None:
        self.mode = "standby"
        self.demands_expire = True
        self.not_ready = False
        self._lock = threading.RLock()
        self._source: str | None = None
        self._connection = 0
        self._sequence = -1
        self._controllers: Mapping[str, Mapping[str, Any]] = {}
        self._end_ns = 0

    def answer(self, method: str, params: Mapping[str, Any], connection: int) -> Any:
        """The result; Failure where it is refused."""
        with self._lock:
            self._expire()
            if self.not_ready:
                raise RequestError(ErrorCode.NOT_READY, "the gateway is starting; try again")
            return getattr(self, "_" + method.replace(".", "_"))(params, connection)

    def state(self, messages: list[str] | None) -> dict[str, Any]:
        with self._lock:
            self._expire()
            return self._state_get({"messages": messages}, 0)

    def gone(self, connection: int) -> None:
        """The demand of a connection ends with it."""
        with self._lock:
            if connection == self._connection:
                self._end_demand()

    def _end_demand(self) -> None:
        self._source, self._connection, self._controllers = None, 0, {}
        self.mode = "standby" if self.mode == "active" else self.mode

    def _expire(self) -> None:
        is_over = self.demands_expire and time.monotonic_ns() > self._end_ns
        if self._source is not None and is_over:
            self._end_demand()

    def _granted(self) -> dict[str, Any]:
        return {"granted": True, "mode": self.mode}

    def _demand_set(self, params: Mapping[str, Any], connection: int) -> Any:
        if self._source is not None and connection != self._connection:
            raise refused("other_owner", f"{self._source} owns the demand")
        controllers = params["controllers"] or dict.fromkeys(CONTROLLERS, params["values"])
        self._judge(controllers)
        if params["source"] == self._source and params["sequence"] <= self._sequence:
            raise refused("old_sequence", "sequence is not above the last one")
        self._source, self._sequence = params["source"], params["sequence"]
        self._connection, self._controllers = connection, controllers
        self._end_ns = params["made_ns"] + params["ttl_ms"] * 1_000_000
        return self._granted()

    def _judge(self, controllers: Mapping[str, Mapping[str, Any]]) -> None:
        for name in CONTROLLERS:
            if name not in controllers:
                raise refused("controller_missing", f"the demand says nothing of {name}")
            for quantity, most in RANGES.items():
                if not 0 <= controllers[name][quantity] <= most:
                    raise refused("out_of_range", f"{name} {quantity} must be 0 to {most:g}")

    def _demand_release(self, params: Mapping[str, Any], connection: int) -> Any:
        if connection != self._connection:
            raise refused("other_owner", f"{params['source']} does not own the demand")
        self._end_demand()
        return self._granted()

    def _arm(self, params: Mapping[str, Any], connection: int) -> Any:
        if self.mode == "standby" and self._source is None:
            raise refused("not_allowed_now", "there is no fresh demand")
        if self.mode != "standby" or self._throttle_pct() > 0:
            raise refused("not_allowed_now", f"not in {self.mode}, or the throttle is not 0")
        self.mode = "active"
        return self._granted()

    def _throttle_pct(self) -> float:
        return max((one["throttle_pct"] for one in self._controllers.values()), default=0.0)

    def _disarm(self, params: Mapping[str, Any], connection: int) -> Any:
        self.mode = "standby" if self.mode == "active" else self.mode
        return self._granted()

    def _estop(self, params: Mapping[str, Any], connection: int) -> Any:
        self.mode = "fault"
        return self._granted()

    def _reset(self, params: Mapping[str, Any], connection: int) -> Any:
        if params["level"] == "driver" and self.mode == "fault":
            raise refused("not_allowed_now", "it needs a reset at service level")
        self.mode = "standby"
        return self._granted()

    def _state_get(self, params: Mapping[str, Any], connection: int) -> Any:
        names = params["messages"] if params["messages"] is not None else list(MESSAGES)
        for name in names:
            if name not in MESSAGES:
                raise RequestError(ErrorCode.INVALID_PARAMS, f"there is no message {name}")
        return {
            "monotonic_ns": time.monotonic_ns(),
            "mode": self.mode,
            "messages": {name: MESSAGES[name] for name in names},
            "commands": {name: self._command(name) for name in CONTROLLERS},
        }

    def _command(self, name: str) -> dict[str, Any]:
        asked = self._controllers.get(name, VALUES) if self.mode == "active" else VALUES
        return {**VALUES, **asked, "power_cut": False, "frame": None}

    def _tuning_get(self, params: Mapping[str, Any], connection: int) -> Any:
        return {"drive_mode": None, "curves": [], "slip_throttle_max_pct": None}

    def _why(self, params: Mapping[str, Any], connection: int) -> Any:
        return {"sentence": f"{self.mode}; arm", "mode": self.mode, "next_step": "arm"}

    def _health(self, params: Mapping[str, Any], connection: int) -> Any:
        return {"pid": 1, "config_digest": "d"}

    def _events(self, params: Mapping[str, Any], connection: int) -> Any:
        return {"events": [], "forgotten": params["limit"]}

    def _config_get(self, params: Mapping[str, Any], connection: int) -> Any:
        return {"file": "gateway.yaml", "digest": "d", "values": {}}

    def _config_reload(self, params: Mapping[str, Any], connection: int) -> Any:
        return {"changed": [], "digest": "d"}

    def _protocol_get(self, params: Mapping[str, Any], connection: int) -> Any:
        return {"digest": "d", "messages": [], "aliases": {}}
