"""Explanation of the gateway's state, as a value and as one line."""

from collections.abc import Mapping, Set
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, LIMITING, Effect, HeldCause
from vcu_gateway.core.demand import ControllerDemands, PowerMode
from vcu_gateway.core.pedals import ThrottleHold
from vcu_gateway.core.supervisor import FaultClass, LatchedFault, Mode
from vcu_gateway.units import NS_PER_MS, NS_PER_S

LONGEST_CHARACTERS = 200
"""Of a sentence."""

WAITING_FOR = "waiting for "
"""Begins a condition that a message has to meet; its name follows."""

_ALARM = frozenset({Effect.ALARM})
_NAMED = (3, 2, 1)
# What becomes shorter, step by step, until the sentence is short enough.
_SHORTENED = (
    *("alarms", "alarms", "alarms", "limits", "limits", "blocks", "demand"),
    *("limits", "blocks", "waits", "waits", "alarms", "limits", "blocks", "blocks", "latch"),
)


class Explanation(NamedTuple):
    """One instant, explained.

    Attributes:
        judged_ns: the tick that last judged the causes.
        blocks: causes that stop or cut; limits: causes that limit; alarms: the rest.
        waits: conditions that are not met yet, as sentences.
        demand_source: owner of the demand, None without one.
        demand_age_ns: None without a demand and for the bench demand, which does not age.
        demand_ttl_ms: None for ever, and without a demand.
        next_step: what to do, as a sentence.
        refusal: why arming or resetting would be refused, or empty.
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
    refusal: str = ""

    def sentence(self) -> str:
        """Most important part of it in one line of at most 200 characters."""
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
        shown = [one for one in held if one.finding.subject not in waited]
        if not shown:
            return [""] * (len(_NAMED) + 2)
        count = f"{what} {len(shown)} cause" + ("s" if len(shown) > 1 else "")
        return [*(self._grouped(what, shown, most) for most in _NAMED), count, ""]

    def _grouped(self, what: str, held: list[HeldCause], most: int) -> str:
        """Causes with the same description in one group, the most severe group first."""
        groups: dict[str, list[str]] = {}
        for one in sorted(held, key=self._rank):
            groups.setdefault(self._description(one), []).append(one.finding.subject)
        shown = [
            f"{_listed(subjects, most)}{description}" for description, subjects in groups.items()
        ]
        left = sum(len(subjects) for subjects in list(groups.values())[most:])
        return f"{what} {', '.join(shown[:most])}" + (f" and {left} more" if left else "")

    def _rank(self, held: HeldCause) -> tuple[bool, bool]:
        return held.finding.effect is not Effect.CUT, not held.stands(self.judged_ns)

    def _description(self, held: HeldCause) -> str:
        since = f"for {(self.now_ns - held.since_ns) / NS_PER_S:.1f} s"
        gone = "" if held.stands(self.judged_ns) else ", gone and held"
        return f"{str(held.finding).removeprefix(held.finding.subject)} ({since}{gone})"

    def _demand(self) -> str:
        if self.demand_source is None:
            return "no demand"
        if self.demand_age_ns is None:
            return f"demand of {self.demand_source}"
        state = "" if self.demand_fresh else ", expired"
        return f"demand of {self.demand_source} {self.demand_age_ns // NS_PER_MS} ms old{state}"


def _joined(forms: dict[str, list[str]]) -> str:
    return "; ".join(form for form, *_ in forms.values() if form)


def _listed(names: list[str], most: int) -> str:
    """`A, B and C`, or `A, B, C and 2 others`."""
    left = len(names) - most
    if left > 0:
        return f"{', '.join(names[:most])} and {left} other" + ("s" if left > 1 else "")
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _message(wait: str) -> str | None:
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


class Reasons(NamedTuple):
    """All that an explanation says but ages, as it is found in every tick.

    Equal ones say the same; nothing in them changes later, so any thread may read them.

    Attributes:
        held: every cause that counts, in the order of its appearance.
        refusal: why arming or resetting would be refused, or empty.
    """

    mode: Mode
    latch: LatchedFault | None
    held: tuple[HeldCause, ...]
    waits: tuple[str, ...]
    demand_source: str | None
    demand_ttl_ms: int | None
    demand_fresh: bool
    refusal: str

    def signature(self) -> tuple[object, ...]:
        """Key of answers that are the same to a person: all but values and the next step."""
        keys = tuple([one.finding.key for one in self.held])
        return (self.mode, self.latch, keys, self.waits, self.demand_source, self.demand_fresh)


def explained(
    reasons: Reasons, now_ns: int, judged_ns: int, demand_age_ns: int | None
) -> Explanation:
    """The answer at `now_ns`; `judged_ns` is the tick that last judged the causes."""
    told = reasons._asdict()
    held = told.pop("held")
    return Explanation(
        **told,
        now_ns=now_ns,
        judged_ns=judged_ns,
        blocks=_having(BLOCKING, held),
        limits=_having(LIMITING, held),
        alarms=_having(_ALARM, held),
        demand_age_ns=demand_age_ns,
        next_step=next_step(reasons.mode, reasons.latch, reasons.refusal),
    )


def _having(effects: frozenset[Effect], causes: tuple[HeldCause, ...]) -> tuple[HeldCause, ...]:
    return tuple(held for held in causes if held.finding.effect in effects)


_NEXT_STEPS = {
    Mode.STARTING: "wait",
    Mode.ACTIVE: "drive; disarm to end",
    Mode.STOPPING: "the gateway is ending",
}


def next_step(mode: Mode, latch: LatchedFault | None, refusal: str) -> str:
    """Next step of the operator; `refusal` is the reason against arming or resetting, or empty."""
    if mode is Mode.FAULT:
        level = "service " if latch and latch.fault_class is FaultClass.SERVICE else ""
        return f"first: {refusal}; then {level}reset" if refusal else f"{level}reset"
    if mode is Mode.STANDBY:
        return f"before arming: {refusal}" if refusal else "arm"
    return _NEXT_STEPS[mode]


def release_wait(latched: Set[ThrottleHold]) -> str:
    """What a throttle that these hold at 0 waits for."""
    reasons = ", ".join(hold.value for hold in ThrottleHold if hold in latched)
    return f"throttle 0 until released below 5 %: {reasons}"


def safety_mode_wait(controllers: list[str]) -> str:
    """Why these have no throttle: their power mode demands none."""
    return f"throttle 0 in power mode safety ({' and '.join(controllers)})"


def power_mode_waits(waiting: Mapping[str, PowerMode]) -> list[str]:
    """Power modes, by controller, that cannot rise yet."""
    names: dict[PowerMode, list[str]] = {}
    for name, mode in waiting.items():
        names.setdefault(mode, []).append(name)
    return [
        f"power mode {mode.name.lower()} until the throttle is below 5 % ({' and '.join(some)})"
        for mode, some in names.items()
    ]


def direction_wait(
    demanded: ControllerDemands, speeds_rpm: tuple[float | None, ...], limit_rpm: float
) -> str:
    """What a change of direction waits for; after it nothing but the next tick is missing."""
    speeds = dict(zip(demanded, speeds_rpm, strict=True))
    unknown = [name for name, speed in speeds.items() if speed is None]
    fast = [name for name, speed in speeds.items() if speed is not None and speed >= limit_rpm]
    sentence = "throttle 0 until the direction changes"
    if unknown:
        sentence += f"; speed unknown of {' and '.join(unknown)}"
    if fast:
        sentence += f"; not below {limit_rpm:g} rpm: {' and '.join(fast)}"
    return sentence
