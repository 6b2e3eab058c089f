"""What the view shows, and what it needs of whoever knows it."""

from dataclasses import dataclass
from datetime import datetime
from typing import NamedTuple, Protocol

from vcu_gateway.api.results import Health, State, Why


class SourceProblem(NamedTuple):
    """Why nothing new is known: a sentence, and since when, in local time."""

    sentence: str
    since: datetime


@dataclass(frozen=True, slots=True)
class ViewModel:
    """The latest that is known; None where nothing was heard yet.

    Attributes:
        trouble: None while the gateway answers; else the rest is what it said last.
    """

    state: State | None = None
    why: Why | None = None
    health: Health | None = None
    trouble: SourceProblem | None = None


class SourceRefusedError(Exception):
    """A request was not granted, or not heard; the text says why."""


class ViewSource(Protocol):
    """Where the picture comes from. `latest` never waits; the others may, for a second or two."""

    def latest(self) -> ViewModel:
        """What is known now."""

    def estop(self) -> None:
        """Cut the power of both controllers; RefusedError where that was not granted."""

    def disarm(self) -> None:
        """From active to standby; RefusedError where that was not granted."""
