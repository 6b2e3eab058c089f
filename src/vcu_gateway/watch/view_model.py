"""View model: the data that the live view shows, and the protocol of its source."""

from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple, Protocol

from vcu_gateway.api.results import Health, State, Why


class SourceProblem(NamedTuple):
    """Reason why the gateway cannot be polled, and since when, in local time."""

    sentence: str
    since: datetime


@dataclass(frozen=True, slots=True)
class ViewModel:
    """Latest results of the gateway; None before the first.

    Attributes:
        problem: None while the gateway answers; else the rest are its last results.
    """

    state: State | None = None
    why: Why | None = None
    health: Health | None = None
    problem: SourceProblem | None = None


class SourceRefusedError(Exception):
    """A request was refused or not answered; the message says why."""


class ViewSource(Protocol):
    """Source of view models. `latest` never waits; the others may, for a second or two."""

    def latest(self) -> ViewModel: ...

    def estop(self) -> None:
        """Cut the power of both controllers; SourceRefusedError where it was not granted."""

    def disarm(self) -> None:
        """From active to standby; SourceRefusedError where it was not granted."""
