"""Why the gateway does what it does, as a value and as a line."""

from dataclasses import dataclass
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, LIMITING, Causes, Effect, HeldCause
from vcu_gateway.core.demand import DemandArbiter
from vcu_gateway.core.supervisor import FaultClass, LatchedFault, Mode, Supervisor
from vcu_gateway.units import NS_PER_MS

LONGEST_CHARACTERS = 200
"""Of a sentence."""

WAITING_FOR = "waiting for "
"""Begins a condition that a message has to meet; its name follows."""

_NAMED = (3, 2, 1)
# What becomes shorter, step by step, until the sentence is short enough.
_SHORTENED = (
    *("alarms", "alarms", "alarms", "limits", "limits", "blocks", "demand"),
    *("limits", "blocks", "waits", "waits", "alarms", "limits", "blocks", "blocks", "latch"),
)


@dataclass(frozen=True, slots=True)
class Explanation:
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
    latch: LatchedFault | None
    blocks: tuple[HeldCause, ...]
    limits: tuple[HeldCause, ...]
    alarms: tuple[HeldCause, ...]
    waits: tuple[str, ...]
    demand_source: str | None
    demand_age_ns: int | None
    demand_ttl_ms: int | None
    demand_fresh: bool
    next_step: str

    def sentence(self) -> str:
        """What matters most of it in one line of at most 200 characters."""
        forms = self._forms()
        for part in _SHORTENED:
            if len(_joined(forms)) <= LONGEST_CHARACTERS:
                break
            forms[part] = forms[part][1:]
        line = _joined(forms)
        return line if len(line) <= LONGEST_CHARACTERS else f"{line[: LONGEST_CHARACTERS - 1]}…"

    def headline(self) -> str:
        """The same in some words: of several causes only the first."""
        parts = [self.mode.value]
        if self.latch is not None:
            parts.append(f"latched: {self.latch.reason}")
        parts += [_waiting(self.waits, 1)]
        parts += [_first("blocked by", self.blocks) or _first("limited by", self.limits)]
        parts += [self.next_step]
        return "; ".join(part for part in parts if part)

    def _forms(self) -> dict[str, list[str]]:
        """Each part of the sentence in its order, from its longest form to its shortest."""
        latched = ["", ""]
        if self.latch is not None:
            short = f"latched ({self.latch.fault_class.value})"
            latched = [f"{short}: {self.latch.reason}", short]
        return {
            "mode": [self.mode.value],
            "latch": latched,
            "waits": [_waiting(self.waits, most) for most in _NAMED],
            "blocks": self._causes("blocked by", self.blocks),
            "limits": self._causes("limited by", self.limits),
            "alarms": self._causes("alarm", self.alarms),
            "demand": [self._demand(), ""],
            "next_step": [self.next_step],
        }

    def _causes(self, what: str, held: tuple[HeldCause, ...]) -> list[str]:
        """Causes but those of messages that are waited for anyhow."""
        waited = {_message(wait) for wait in self.waits}
        told = [one for one in held if one.finding.subject not in waited]
        if not told:
            return [""] * (len(_NAMED) + 2)
        count = f"{what} {len(told)} cause" + ("s" if len(told) > 1 else "")
        return [*(self._told(what, told, most) for most in _NAMED), count, ""]

    def _told(self, what: str, held: list[HeldCause], most: int) -> str:
        """Causes of which the same is to be said in one group, the most severe group first."""
        groups: dict[str, list[str]] = {}
        for one in sorted(held, key=self._rank):
            groups.setdefault(self._said(one), []).append(one.finding.subject)
        told = [f"{_listed(subjects, most)}{said}" for said, subjects in groups.items()]
        left = sum(len(subjects) for subjects in list(groups.values())[most:])
        return f"{what} {', '.join(told[:most])}" + (f" and {left} more" if left else "")

    def _rank(self, held: HeldCause) -> tuple[bool, bool]:
        return held.finding.effect is not Effect.CUT, not held.stands(self.judged_ns)

    def _said(self, held: HeldCause) -> str:
        since = f"for {(self.now_ns - held.since_ns) / 1e9:.1f} s"
        gone = "" if held.stands(self.judged_ns) else ", gone and held"
        return f"{str(held.finding).removeprefix(held.finding.subject)} ({since}{gone})"

    def _demand(self) -> str:
        if self.demand_source is None:
            return "no demand"
        if self.demand_age_ns is None:
            return f"demand of {self.demand_source}"
        state = "" if self.demand_fresh else ", expired"
        return f"demand of {self.demand_source} {self.demand_age_ns // NS_PER_MS} ms old{state}"

    def signature(self) -> tuple[object, ...]:
        """What a person would call the same answer: all but ages and values."""
        keys = tuple(held.finding.key for held in self.blocks + self.limits + self.alarms)
        return (self.mode, self.latch, keys, self.waits, self.demand_source, self.demand_fresh)


def _joined(forms: dict[str, list[str]]) -> str:
    return "; ".join(form for form, *_ in forms.values() if form)


def _listed(names: list[str], most: int) -> str:
    """`A, B and C`, or `A, B, C and 2 others`."""
    left = len(names) - most
    if left > 0:
        return f"{', '.join(names[:most])} and {left} other" + ("s" if left > 1 else "")
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _message(wait: str) -> str | None:
    """The message that is waited for; None where it is something else."""
    if not wait.startswith(WAITING_FOR):
        return None
    return wait.removeprefix(WAITING_FOR).partition(":")[0]


def _waiting(waits: tuple[str, ...], most: int) -> str:
    """One condition as it is; of several, the messages in one list."""
    messages = [name for name in map(_message, waits) if name is not None]
    if len(messages) < 2:
        return "; ".join(waits)
    others = [wait for wait in waits if _message(wait) is None]
    return "; ".join([*others, f"{WAITING_FOR}{_listed(messages, most)}"])


def _first(what: str, held: tuple[HeldCause, ...]) -> str:
    more = f" and {len(held) - 1} more" if len(held) > 1 else ""
    return f"{what} {held[0].finding}{more}" if held else ""


class ExplanationInputs(NamedTuple):
    """Where the answer comes from; `judged_ns` is the tick that last judged the causes."""

    judged_ns: int
    supervisor: Supervisor
    causes: Causes
    desk: DemandArbiter


def explained(
    facts: ExplanationInputs, waits: tuple[str, ...], refusal: str, now_ns: int
) -> Explanation:
    """The answer now; `refusal` is why arming or resetting would be refused, or empty."""
    mode, latch, demand = facts.supervisor.mode, facts.supervisor.latch, facts.desk.current
    return Explanation(
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


def next_step(mode: Mode, latch: LatchedFault | None, refusal: str) -> str:
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
