"""Spans of causes: from when until when each one counted, from the events of a drive."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from vcu_gateway.core.causes import HeldCause


class CauseKey(NamedTuple):
    """What makes a cause one, as in the core: two causes may have the same subject and effect."""

    cause: str
    subject: str
    effect: str

    def __str__(self) -> str:
        return f"{self.subject} ({self.cause}): {self.effect}"

    @property
    def title(self) -> str:
        """Subject and effect; of a curve its key, as several curves are over the same quantity."""
        curve = self.cause.startswith("curves.")
        return f"{self.cause if curve else self.subject}: {self.effect}"


@dataclass
class CauseSpan:
    """Time for which a cause counted; `ended_ns` is None where it still does at the end."""

    key: CauseKey
    detail: str
    began_ns: int
    ended_ns: int | None = None


class CauseSpans:
    """Builds the spans of a recording, or of one side of a comparison; only the first `most`."""

    def __init__(self, most: int | None = None) -> None:
        self.spans: list[CauseSpan] = []
        self._most = most
        self._open: dict[CauseKey, CauseSpan] = {}

    @property
    def effects(self) -> frozenset[str]:
        return frozenset(key.effect for key in self._open)

    def stand(self, held: Iterable[HeldCause], now_ns: int) -> None:
        """At a checkpoint these causes count: those that did go on, all others have ended."""
        findings = [one.finding for one in held]
        details = {CauseKey(f.cause, f.subject, f.effect.value): f.detail for f in findings}
        for key in self._open.keys() - details.keys():
            self._end(key, now_ns)
        for key, detail in details.items():
            self._begin(key, detail, now_ns)

    def event(self, name: str, fields: Mapping[str, object], now_ns: int) -> None:
        """Take in an event; those of other names than a cause's change nothing."""
        key = CauseKey(*(str(fields.get(part, "")) for part in CauseKey._fields))
        if name == "cause_began":
            self._begin(key, str(fields.get("detail", "")), now_ns)
        elif name == "cause_ended":
            self._end(key, now_ns)

    def end(self, now_ns: int) -> None:
        """Nothing is known of what follows: every cause ends here."""
        for key in tuple(self._open):
            self._end(key, now_ns)

    def _begin(self, key: CauseKey, detail: str, now_ns: int) -> None:
        if key in self._open:
            return
        span = self._open[key] = CauseSpan(key, detail, now_ns)
        if self._most is None or len(self.spans) < self._most:
            self.spans.append(span)

    def _end(self, key: CauseKey, now_ns: int) -> None:
        span = self._open.pop(key, None)
        if span is not None:
            span.ended_ns = now_ns
