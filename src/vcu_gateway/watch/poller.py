"""The picture of a running gateway, asked for on a thread again and again."""

import dataclasses
import functools
import threading
import time
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from vcu_gateway.api.results import Health, State, Why
from vcu_gateway.client import Client, ClientError
from vcu_gateway.watch.view_model import SourceProblem, SourceRefusedError, ViewModel

_STATE_EVERY_S = 0.2
_REST_EVERY_S = 0.5
_JOIN_S = 3.0


class GatewaySource:
    """A Source over the client: the state 5 times a second, the rest 2 times.

    A gateway that cannot be asked is asked again; until then the picture tells since when.
    """

    def __init__(self, socket_path: Path | None = None) -> None:
        self._socket_path = socket_path
        self._picture = ViewModel()
        self._rest_due_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="asking", daemon=True)

    def latest(self) -> ViewModel:
        """What is known now."""
        return self._picture

    def estop(self) -> None:
        """Cut the power of both controllers; RefusedError where that was not granted."""
        self._request(Client.estop)

    def disarm(self) -> None:
        """From active to standby; RefusedError where that was not granted."""
        self._request(Client.disarm)

    def _request(self, method: Any) -> None:
        """On a connection of its own, which nothing else holds up."""
        try:
            with Client(self._socket_path) as client:
                method(client)
        except ClientError as error:
            raise SourceRefusedError(str(error)) from error

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        with Client(self._socket_path) as client:
            while not self._stop.is_set():
                try:
                    self._picture = self._asked(client)
                except ClientError as error:
                    self._lost(str(error))
                except ValidationError as error:
                    what = f"{error.title} has {error.error_count()} unknown values"
                    self._lost(f"it speaks another version of the API: {what}")
                self._stop.wait(_STATE_EVERY_S)

    def _asked(self, client: Client) -> ViewModel:
        state: State = _checked(State, client.state())
        before, now_s = self._picture, time.monotonic()
        changed = before.why is None or before.why["mode"] != state["mode"]
        if not changed and before.trouble is None and now_s < self._rest_due_s:
            return dataclasses.replace(before, state=state)
        why, health = _checked(Why, client.why()), _checked(Health, client.health())
        self._rest_due_s = now_s + _REST_EVERY_S
        return ViewModel(state, why, health)

    def _lost(self, sentence: str) -> None:
        before = self._picture.trouble
        since = datetime.now().astimezone() if before is None else before.since
        self._picture = dataclasses.replace(self._picture, trouble=SourceProblem(sentence, since))


def _checked(shape: Any, answer: Any) -> Any:
    """The answer, where it has this shape; a gateway of another version may answer otherwise."""
    _adapter(shape).validate_python(answer)
    return answer  # as it came: the check makes 80.0 of 80


@functools.cache
def _adapter(shape: Any) -> TypeAdapter[Any]:
    return TypeAdapter(shape)
