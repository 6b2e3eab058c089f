"""Events: facts as values; the core cannot log."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum


class Severity(IntEnum):
    """Severity of an event, as the log's levels."""

    INFO = 20
    WARNING = 30
    ERROR = 40
    CRITICAL = 50


@dataclass(frozen=True, slots=True)
class Event:
    """A fact with its fields; the name is a stable snake_case word for machines."""

    name: str
    severity: Severity
    fields: Mapping[str, object] = field(default_factory=dict)
