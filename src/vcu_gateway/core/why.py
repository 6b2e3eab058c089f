"""Why the gateway does what it does, as a value and as a line."""

from dataclasses import dataclass
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, LIMITING, Causes, Effect, Held
from vcu_gateway.core.demand import DemandDesk
from vcu_gateway.core.supervisor import FaultClass, Latch, Mode, Supervisor

_NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class Why:
    """One instant, explained.

    Attributes:
        judged_ns: the tick that last judged the causes.
        blocks: causes that stop or cut; limits: causes that limit; alarms: the rest.
        waits: conditions that are not met yet, as sentences.
        demand_source: owner of the demand, None without one.
        demand_age_ns: None without a demand and for the bench demand, which does not age.
        demand_ttl_ms: None for ever, and without a demand.
        next_step: what to do, as a sentence.
    """

    now_ns: int
    judged_ns: int
    mode: Mode
    latch: Latch | None
    blocks: tuple[Held, ...]
    limits: tuple[Held, ...]
    alarms: tuple[Held, ...]
    waits: tuple[str, ...]
    demand_source: str | None
    demand_age_ns: int | None
    demand_ttl_ms: int | None
    demand_fresh: bool
    next_step: str

    def sentence(self) -> str:
        """Everything in one line."""
        parts = [self.mode.value]
        if self.latch is not None:
            parts.append(f"latched ({self.latch.fault_class.value}): {self.latch.reason}")
        parts += [self._told("blocked by", self.blocks), self._told("limited by", self.limits)]
        parts += [self._told("alarm", self.alarms), *self.waits, self._demand(), self.next_step]
        return "; ".join(part for part in parts if part)

    def headline(self) -> str:
        """The same in some words: of several causes only the first."""
        parts = [self.mode.value]
        if self.latch is not None:
            parts.append(f"latched: {self.latch.reason}")
        parts += [_first("blocked by", self.blocks) or _first("limited by", self.limits)]
        parts += [*self.waits[:1], self.next_step]
        return "; ".join(part for part in parts if part)

    def _told(self, what: str, held: tuple[Held, ...]) -> str:
        if not held:
            return ""
        return f"{what} " + ", ".join(self._cause(one) for one in held)

    def _cause(self, held: Held) -> str:
        since = f"for {(self.now_ns - held.since_ns) / 1e9:.1f} s"
        gone = "" if held.stands(self.judged_ns) else ", gone and held"
        return f"{held.finding} ({since}{gone})"

    def _demand(self) -> str:
        if self.demand_source is None:
            return "no demand"
        if self.demand_age_ns is None:
            return f"demand of {self.demand_source}"
        state = "" if self.demand_fresh else ", expired"
        return f"demand of {self.demand_source} {self.demand_age_ns // _NS_PER_MS} ms old{state}"

    def signature(self) -> tuple[object, ...]:
        """What a person would call the same answer: all but ages and values."""
        keys = tuple(held.finding.key for held in self.blocks + self.limits + self.alarms)
        return (self.mode, self.latch, keys, self.waits, self.demand_source, self.demand_fresh)


def _first(what: str, held: tuple[Held, ...]) -> str:
    more = f" and {len(held) - 1} more" if len(held) > 1 else ""
    return f"{what} {held[0].finding}{more}" if held else ""


class Facts(NamedTuple):
    """Where the answer comes from; `judged_ns` is the tick that last judged the causes."""

    judged_ns: int
    supervisor: Supervisor
    causes: Causes
    desk: DemandDesk


def explained(facts: Facts, waits: tuple[str, ...], refusal: str, now_ns: int) -> Why:
    """The answer now; `refusal` is why arming or resetting would be refused, or empty."""
    mode, latch, demand = facts.supervisor.mode, facts.supervisor.latch, facts.desk.current
    return Why(
        now_ns=now_ns,
        judged_ns=facts.judged_ns,
        mode=mode,
        latch=latch,
        blocks=facts.causes.having(BLOCKING),
        limits=facts.causes.having(LIMITING),
        alarms=facts.causes.having(frozenset({Effect.ALARM})),
        waits=waits,
        demand_source=None if demand is None else demand.source,
        demand_age_ns=facts.desk.age_ns(now_ns),
        demand_ttl_ms=None if demand is None else demand.ttl_ms,
        demand_fresh=facts.desk.fresh(now_ns),
        next_step=next_step(mode, latch, refusal),
    )


def next_step(mode: Mode, latch: Latch | None, refusal: str) -> str:
    """What to do now; `refusal` is why arming or resetting would be refused, or empty."""
    if mode is Mode.FAULT:
        level = "service " if latch and latch.fault_class is FaultClass.SERVICE else ""
        return f"first: {refusal}; then {level}reset" if refusal else f"{level}reset"
    if mode is Mode.STANDBY:
        return f"before arming: {refusal}" if refusal else "arm"
    return {
        Mode.STARTING: "wait",
        Mode.ACTIVE: "drive; disarm to end",
        Mode.STOPPING: "the gateway is ending",
    }[mode]
