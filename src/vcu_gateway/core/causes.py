"""Causes that stand and are held, their events, and the coded signals that give them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum
from typing import NamedTuple

from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.state import LatestFrame, Snapshot


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


class Effect(Enum):
    """Effect of a cause on the command (docs/safety.md, Effects)."""

    ALARM = "alarm"
    TURBO_OFF = "turbo off"
    POWER_LIMIT = "power limit"
    REGEN_LIMIT = "regen limit"
    REGEN_OFF = "regen off"
    CAP = "cap"
    STOP = "stop"
    CUT = "cut"

    # Members are what they are; Enum's own hash is a call in Python, ten times a tick.
    __hash__ = object.__hash__


LIMITING = frozenset(
    {Effect.TURBO_OFF, Effect.POWER_LIMIT, Effect.REGEN_LIMIT, Effect.REGEN_OFF, Effect.CAP}
)
BLOCKING = frozenset({Effect.STOP, Effect.CUT})
_NO_EFFECTS: frozenset[Effect] = frozenset()


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding of a rule: one cause with one of its effects.

    Attributes:
        cause: stable word for machines.
        subject: the signal, message or part that it is about.
        detail: its value, as a person reads it.
        until_restart: the effect stays when the cause goes.
        latches: enters FAULT from every mode, not from ACTIVE alone.
    """

    cause: str
    subject: str
    effect: Effect
    detail: str = ""
    until_restart: bool = False
    latches: bool = False

    @property
    def key(self) -> tuple[str, str, Effect]:
        """Identity of a finding: cause, subject and effect, without its detail."""
        return self.cause, self.subject, self.effect

    def __str__(self) -> str:
        if self.effect is Effect.CAP:  # its detail says how much
            colon = "" if ": " in self.detail else ":"
            return f"{self.subject}{colon} {self.detail}"
        detail = f" {self.detail}" if self.detail else ""
        return f"{self.subject}{detail}: {self.effect.value}"


class HeldCause(NamedTuple):
    """Finding that counts, with the times of its first and last sighting.

    Attributes:
        absent_since_ns: the first tick that did not see it any more; None while it is seen.
    """

    finding: Finding
    since_ns: int
    seen_ns: int
    absent_since_ns: int | None = None

    def stands(self, now_ns: int) -> bool:
        """True where the cause was seen at this very instant, not held only."""
        return self.seen_ns == now_ns


class Causes:
    """Every cause that counts: seen now, or absent for less than the holding time."""

    def __init__(self) -> None:
        self._held: dict[tuple[str, str, Effect], HeldCause] = {}

    @property
    def held(self) -> tuple[HeldCause, ...]:
        """Every cause that counts, in the order of its appearance."""
        return tuple(self._held.values())

    def update(self, findings: Iterable[Finding], hold_ns: int, now_ns: int) -> list[Event]:
        """Take in the findings of a tick; events for causes that began and that ended."""
        events = []
        for finding in findings:
            events += self.note(finding, now_ns)
        for key, held in tuple(self._held.items()):
            if held.seen_ns == now_ns or held.finding.until_restart:
                continue
            absent_since_ns = now_ns if held.absent_since_ns is None else held.absent_since_ns
            if now_ns - absent_since_ns >= hold_ns:
                del self._held[key]
                events.append(_event("cause_ended", held.finding))
            elif held.absent_since_ns is None:
                self._held[key] = held._replace(absent_since_ns=now_ns)
        return events

    def note(self, finding: Finding, now_ns: int) -> list[Event]:
        """Take in one finding, also between two ticks; an event where its cause began."""
        key = finding.key
        before = self._held.get(key)
        if before is None:
            self._held[key] = HeldCause(finding, now_ns, now_ns)
            return [_event("cause_began", finding)]
        if before.finding.until_restart and not finding.until_restart:
            # A lower code of the same signal does not end what stays until restart.
            finding = replace(finding, until_restart=True)
        self._held[key] = HeldCause(finding, before.since_ns, now_ns)
        return []

    def effects(self) -> frozenset[Effect]:
        if not self._held:
            return _NO_EFFECTS
        return frozenset([held.finding.effect for held in self._held.values()])

    def having(self, effects: frozenset[Effect]) -> tuple[HeldCause, ...]:
        if not self._held:
            return ()
        return tuple([held for held in self._held.values() if held.finding.effect in effects])


def _event(name: str, finding: Finding) -> Event:
    severity = Severity.WARNING if name == "cause_began" else Severity.INFO
    fields = {
        "cause": finding.cause,
        "subject": finding.subject,
        "effect": finding.effect.value,
        "detail": finding.detail,
    }
    return Event(name, severity, fields)


BATTERY_STATUS = "BMS_Status"
CONTROLLER_STATUS = tuple(f"{controller}_Status1" for controller in CONTROLLERS)

_ALARM, _STOP, _CUT = (Effect.ALARM,), (Effect.STOP,), (Effect.CUT,)
_LIMITS = (Effect.REGEN_LIMIT, Effect.POWER_LIMIT)
_NONE: tuple[Effect, ...] = ()

BATTERY_EFFECTS: Mapping[str, tuple[tuple[Effect, ...], ...]] = {
    "CellOvervoltage": (_NONE, (Effect.REGEN_LIMIT,), (Effect.REGEN_OFF,), (Effect.REGEN_OFF,)),
    "CellUndervoltage": (_NONE, (Effect.POWER_LIMIT,), _STOP, _CUT),
    "DischargeOvercurrent": (_NONE, _LIMITS, _CUT, _CUT),
    "TemperatureImbalance": (_NONE, _ALARM, _ALARM, _ALARM),
    "Overtemperature": (_NONE, _ALARM, _CUT, _CUT),
    "Undertemperature": (_NONE, (Effect.REGEN_OFF,), _CUT, _CUT),
    "VoltageImbalance": (_NONE, _ALARM),
    "InternalFault": (_NONE, _CUT),
}
"""Effects of each code of BMS_Status; a reserved code is the worst (docs/protocol.md E13)."""

UNTIL_RESTART = {("CellOvervoltage", 3)}

CONTROLLER_EFFECTS: Mapping[str, tuple[tuple[Effect, ...], ...]] = {
    "TemperatureProtectLevel": (_NONE, (Effect.TURBO_OFF,), _STOP, _STOP),
    "VoltageLevel": (
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
        (Effect.POWER_LIMIT,),
        _NONE,
        _NONE,
        _NONE,
        (Effect.REGEN_OFF,),
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
    ),
}
"""Effects of each code of a controller's Status1."""

_EFFECTS = {BATTERY_STATUS: BATTERY_EFFECTS, **dict.fromkeys(CONTROLLER_STATUS, CONTROLLER_EFFECTS)}
_CODED = {message: tuple(effects) for message, effects in _EFFECTS.items()}


class CodedSignals:
    """Findings of coded signals, kept while the frame that they come from is the latest."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[LatestFrame, tuple[Finding, ...]]] = {}

    def findings(self, snapshot: Snapshot, message: str) -> tuple[Finding, ...]:
        """Finding of every code that has an effect, in the frames that are to be judged."""
        frames = snapshot.judged(message)
        if len(frames) != 1:
            return tuple(_found(snapshot, message))
        (frame,) = frames
        kept = self._kept.get(message)
        if kept is None or kept[0] is not frame:
            kept = self._kept[message] = frame, tuple(_found(snapshot, message))
        return kept[1]


def _found(snapshot: Snapshot, message: str) -> Iterator[Finding]:
    for codes in snapshot.codes(message, _CODED[message]):
        for (signal, effects), raw in zip(_EFFECTS[message].items(), codes, strict=True):
            name = snapshot.code_name(message, signal, raw)
            subject, detail = f"{message}.{signal}", f"{raw} ({name or 'reserved'})"
            stays = (signal, raw) in UNTIL_RESTART
            for effect in effects[raw]:
                yield Finding("code", subject, effect, detail, until_restart=stays)
