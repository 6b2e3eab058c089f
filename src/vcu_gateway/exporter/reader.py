"""Answers of the API for one scrape, read over one connection, and the recorder's state."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

from vcu_gateway.api import results
from vcu_gateway.client import Client, ClientError, calls
from vcu_gateway.client.calls import Call
from vcu_gateway.errors import GatewayError
from vcu_gateway.recording.recorder_status import STATUS_PATH, RecorderStatus, read_status

ResultT = TypeVar("ResultT")

TIME_LIMIT_S = 2.0
"""For all requests of one reading, beside the wait for a connection."""


class GatewayAnswers(NamedTuple):
    """Answers of the gateway, as far as it gave them.

    Attributes:
        health: None where the gateway does not answer; then all others are None, too.
        state, why: None before the first tick, too.
        config: configuration in effect; None where the gateway does not tell it.
        recorder: what the recorder told last, however long ago; None where there is none, or its
            file may not be read. The gateway need not answer for that.
        recorder_age_s: how long ago; None likewise.
    """

    health: results.Health | None = None
    state: results.State | None = None
    why: results.Why | None = None
    config: results.ConfigInEffect | None = None
    recorder: RecorderStatus | None = None
    recorder_age_s: float | None = None


class GatewayReader:
    """Reader of the API; any thread may call `read`.

    Where the gateway does not answer, `health` is None and `report` gets a sentence, once until
    it changes. Threads that wait for each other share one reading, so that the time of a
    scrape is bounded however many there are.
    """

    def __init__(
        self,
        client: Client,
        report: Callable[[str], None],
        time_limit_s: float = TIME_LIMIT_S,
        status_path: Path = STATUS_PATH,
    ) -> None:
        """`status_path` is of the recorder's state."""
        self._client = client
        self._status_path = status_path
        self._report = report
        self._time_limit_s = time_limit_s
        self._lock = threading.Lock()
        self._latest = GatewayAnswers()
        self._latest_end_s = -1.0
        self._config: results.ConfigInEffect | None = None
        self._reported = ""

    def read(self) -> GatewayAnswers:
        """A reading that ended after this call began."""
        begin_s = time.monotonic()
        with self._lock:
            if self._latest_end_s < begin_s:
                self._latest = self._with_recorder(self._read())
                self._latest_end_s = time.monotonic()
            return self._latest

    def _read(self) -> GatewayAnswers:
        deadline_s = time.monotonic() + self._time_limit_s
        try:
            health = self._call(calls.health(), self._time_limit_s)
        except ClientError as error:
            self._report_change(f"no metrics of the gateway: {error}")
            return GatewayAnswers()
        self._report_change("the gateway answers")
        return GatewayAnswers(
            health,
            self._call_if_answered(calls.state(None), deadline_s),
            self._call_if_answered(calls.why(), deadline_s),
            self._config_in_effect(health.get("config_digest"), deadline_s),
        )

    def _with_recorder(self, answers: GatewayAnswers) -> GatewayAnswers:
        try:
            status = read_status(self._status_path)
        except GatewayError:
            return answers
        return answers._replace(recorder=status, recorder_age_s=status.age_s())

    def _config_in_effect(
        self, digest: str | None, deadline_s: float
    ) -> results.ConfigInEffect | None:
        """Configuration in effect, asked for again only where its digest has changed."""
        if self._config is None or self._config["digest"] != digest:
            self._config = self._call_if_answered(calls.config(), deadline_s)
        return self._config

    def _call_if_answered(self, call: Call[ResultT], deadline_s: float) -> ResultT | None:
        """The result; None for an error: not ready, not known to an older gateway, too late."""
        try:
            return self._call(call, max(0.0, deadline_s - time.monotonic()))
        except ClientError:
            return None

    def _call(self, call: Call[ResultT], timeout_s: float) -> ResultT:
        self._client.timeout_s = timeout_s
        return self._client.call(call)

    def _report_change(self, sentence: str) -> None:
        if sentence != self._reported:
            self._reported = sentence
            self._report(sentence)
