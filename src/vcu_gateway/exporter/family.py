"""Families of metrics, and the answers of the API and of the recorder that they read."""

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Literal, NamedTuple, TypeVar

from vcu_gateway.api import results
from vcu_gateway.client import Client, ClientError
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
        tuning: drive mode and curves; None likewise.
        recorder: what the recorder told last, however long ago; None where there is none, or its
            file may not be read. The gateway need not answer for that.
        recorder_age_s: how long ago; None likewise.
    """

    health: results.Health | None = None
    state: results.State | None = None
    why: results.Why | None = None
    config: results.ConfigInEffect | None = None
    tuning: results.TuningNow | None = None
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
        self._client.timeout_s = self._time_limit_s
        try:
            health = self._client.health()
        except ClientError as error:
            self._report_change(f"no metrics of the gateway: {error}")
            return GatewayAnswers()
        self._report_change("the gateway answers")
        return GatewayAnswers(
            health,
            self._call_if_answered(self._client.state, deadline_s),
            self._call_if_answered(self._client.why, deadline_s),
            self._config_in_effect(health.get("config_digest"), deadline_s),
            self._call_if_answered(self._client.tuning, deadline_s),
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
            self._config = self._call_if_answered(self._client.config, deadline_s)
        return self._config

    def _call_if_answered(self, ask: Callable[[], ResultT], deadline_s: float) -> ResultT | None:
        """The result; None for an error: not ready, not known to an older gateway, too late."""
        self._client.timeout_s = max(0.0, deadline_s - time.monotonic())
        try:
            return ask()
        except ClientError:
            return None

    def _report_change(self, sentence: str) -> None:
        if sentence != self._reported:
            self._reported = sentence
            self._report(sentence)


LabelT = TypeVar("LabelT", bound=str)

PREFIX = "vcu_gateway_"
MS_PER_S = 1_000
US_PER_S = 1_000_000

Kind = Literal["counter", "gauge", "histogram"]
Samples = Mapping[tuple[str, ...], float]
"""Values by the values of the labels; what is not known is not in it."""

Read = Callable[[GatewayAnswers], Samples]


class Family(NamedTuple):
    """One metric with all its label sets.

    Attributes:
        name: as it is exposed; a counter's ends in _total.
        help: one sentence, with what an absent sample means.
        labels: their names, in the order of the keys of `read`'s samples.
        read: its samples. A histogram's key is the upper bound "le", its values cumulative.
            KeyError where the gateway is too old to report them.
    """

    name: str
    kind: Kind
    help: str
    labels: tuple[str, ...]
    read: Read

    def samples(self, reading: GatewayAnswers) -> Samples:
        """The samples; none where the gateway is too old to report them."""
        try:
            return self.read(reading)
        except KeyError:
            return {}


def counter(name: str, text: str, read: Read, *labels: str) -> Family:
    """A count since the start of the gateway."""
    return Family(f"{PREFIX}{name}_total", "counter", text, labels, read)


def gauge(name: str, text: str, read: Read, *labels: str) -> Family:
    return Family(PREFIX + name, "gauge", text, labels, read)


def of_health(read: Callable[[results.Health], Samples]) -> Read:
    """Samples of `health`; none where the gateway does not answer."""
    return lambda reading: {} if reading.health is None else read(reading.health)


def of_state(read: Callable[[results.State], Samples]) -> Read:
    """Samples of the state; none before the first tick."""
    return lambda reading: {} if reading.state is None else read(reading.state)


def of_why(read: Callable[[results.Why], Samples]) -> Read:
    """Samples of `why`; none before the first tick."""
    return lambda reading: {} if reading.why is None else read(reading.why)


def of_tuning(read: Callable[[results.TuningNow], Samples]) -> Read:
    """Samples of the tuning; none where the gateway does not tell it."""
    return lambda reading: {} if reading.tuning is None else read(reading.tuning)


def one(value: float | None) -> Samples:
    """The sample of a family without labels; none where the value is None."""
    return {} if value is None else {(): value}


def by(values: Mapping[LabelT, float | None]) -> Samples:
    """One sample for each value of the only label; none where the value is None."""
    return {(label,): value for label, value in values.items() if value is not None}


def states(known: Iterable[str], standing: Iterable[str]) -> Samples:
    """1 for each word that stands, 0 for the other known ones."""
    return by(dict.fromkeys(known, 0.0) | dict.fromkeys(standing, 1.0))
