"""Source of the live view: what it shows, polled from the running gateway on a thread."""

import dataclasses
import functools
import threading
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self, cast

from pydantic import TypeAdapter, ValidationError

from vcu_gateway.api.results import Health, State, TuningNow, Why
from vcu_gateway.client import ApiError, Client, ClientError

_STATE_PERIOD_S = 0.2
_REST_PERIOD_S = 0.5
_JOIN_TIMEOUT_S = 3.0


class SourceProblem(NamedTuple):
    """Reason why the gateway cannot be polled, and since when, in local time."""

    sentence: str
    since: datetime


@dataclass(frozen=True, slots=True)
class ViewModel:
    """Latest results of the gateway; None before the first.

    Attributes:
        tuning: None where the gateway is too old to tell it, too.
        problem: None while the gateway answers; else the rest are its last results.
    """

    state: State | None = None
    why: Why | None = None
    health: Health | None = None
    tuning: TuningNow | None = None
    problem: SourceProblem | None = None


class ViewSource(Protocol):
    """Source of view models. `latest` never waits; `request` may, for a second or two."""

    def latest(self) -> ViewModel: ...

    def request(self, what: str) -> None:
        """Send `estop` or `disarm`; ClientError, which says why, where it was not granted."""


class GatewaySource:
    """View source over the client: the state 5 times a second, the rest 2 times.

    A gateway that is not reachable is polled on; meanwhile the view model says since when.
    """

    def __init__(self, socket_path: Path | None = None) -> None:
        self._socket_path = socket_path
        self._view = ViewModel()
        self._rest_due_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="poller", daemon=True)

    def latest(self) -> ViewModel:
        return self._view

    def request(self, what: str) -> None:
        """On a connection of its own, which nothing else holds up."""
        with Client(self._socket_path) as client:
            getattr(client, what)()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self._stop.set()
        self._thread.join(_JOIN_TIMEOUT_S)

    def _run(self) -> None:
        with Client(self._socket_path) as client:
            while not self._stop.is_set():
                try:
                    self._view = self._polled(client)
                except ClientError as error:
                    self._mark_unreachable(str(error))
                except ValidationError as error:
                    what = f"{error.title} has {error.error_count()} unknown values"
                    self._mark_unreachable(f"it has another version of the API: {what}")
                self._stop.wait(_STATE_PERIOD_S)

    def _polled(self, client: Client) -> ViewModel:
        state: State = _checked(State, client.state())
        before, now_s = self._view, time.monotonic()
        changed = before.why is None or before.why["mode"] != state["mode"]
        if not changed and before.problem is None and now_s < self._rest_due_s:
            return dataclasses.replace(before, state=state)
        why, health = _checked(Why, client.why()), _checked(Health, client.health())
        self._rest_due_s = now_s + _REST_PERIOD_S
        return ViewModel(state, why, health, _tuning(client))

    def _mark_unreachable(self, sentence: str) -> None:
        before = self._view.problem
        since = datetime.now().astimezone() if before is None else before.since
        self._view = dataclasses.replace(self._view, problem=SourceProblem(sentence, since))


def _tuning(client: Client) -> TuningNow | None:
    try:
        return cast(TuningNow, _checked(TuningNow, client.tuning()))
    except ApiError:
        return None


def _checked(result_type: Any, result: Any) -> Any:
    """The result, checked against its type: a gateway of another version may differ."""
    _adapter(result_type).validate_python(result)
    return result  # as it came: the check makes 80.0 of 80


@functools.cache
def _adapter(result_type: Any) -> TypeAdapter[Any]:
    return TypeAdapter(result_type)
