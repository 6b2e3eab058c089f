"""Summary of an explanation: the one thing that is waited for, in plain words.

It comes from the same explanation as the sentence of `why` and names what comes first in it: what
STARTING waits for, what is against arming in STANDBY, what limits ACTIVE, what holds FAULT. A
dead link comes before the messages that it keeps away.

    waiting for the battery: BMS_Status, since 1.5 s
    waiting for you: press Arm
    limited by motor controller 1: PCU1_Status1 missing, since 3.2 s
    stopped by the emergency stop, service reset first
"""

from collections.abc import Iterator

from vcu_gateway.core.causes import Effect, HeldCause
from vcu_gateway.core.operator_requests import LISTENING
from vcu_gateway.core.supervisor import FaultClass, LatchedFault, Mode
from vcu_gateway.core.why import WAITING_FOR, Explanation
from vcu_gateway.units import NS_PER_S

LONGEST_SUMMARY_CHARACTERS = 69
"""Of a summary: one line of 80 columns, beside the mode."""

_NODES = {
    "BMS": "the battery",
    "PCU1": "motor controller 1",
    "PCU2": "motor controller 2",
    "ARD2": "steering and wheels",
    "IMU": "the inertial unit",
}
_EMERGENCY_STOP = "emergency stop"
_PARTS = {
    _EMERGENCY_STOP: "the emergency stop",
    "link": "the bus: {}",
    "own frames": "the bus: our frames are not confirmed",
    "command": "the bus: another sender, {}",
    "tick": "this computer: tick {} late",
    "gate": "the gateway: frame blocked, {}",
    "restart state": "the restart state: {}",
}
"""By the subject of a finding that is about no message; {} is its detail."""

_AWAITED = frozenset({"stale", "link", "unconfirmed"})
_OF_A_MESSAGE = {"stale": " missing", "late": " late"}
_LONG_S = 120
_EFFECTS = tuple(f": {effect.value}" for effect in Effect)

_WORDS = {
    LISTENING: "waiting: another sender of our frames may be on the bus",
    "sending our first frames": "waiting for the bus to take our first frames",
    "throttle 0 until released below 5 %": "waiting for the released pedal",
    "throttle 0 until the direction changes": "waiting for the change of direction",
    "throttle 0 in power mode safety": "waiting for another power mode than safety",
    "power mode ": "waiting for power mode ",
    "drive mode ": "waiting for drive mode ",
    "the gateway was restarted ": "restarted too often: ",
    "the restart state cannot be kept": "the restart state cannot be kept",
    "there is no fresh demand": "waiting for the pedals or a program: no fresh demand",
    "the demanded throttle is not 0": "waiting for the released pedal: the throttle is not 0",
    "the demanded throttle has not been 0": "waiting for the pedal to stay released",
    "both controllers must have the same direction": "waiting for one direction for both motors",
    "a change of direction is pending": "waiting for the change of direction",
    "the speed limit has not come down": "waiting for the speed limit to come down",
}
"""Words by the beginning of a condition or refusal that names no cause; the rest of it is kept."""


def summary(explained: Explanation) -> str:
    """What is waited for, what limits or stopped the vehicle: at most 69 characters."""
    form = ""
    for form in _forms(explained):
        if len(form) <= LONGEST_SUMMARY_CHARACTERS:
            return form
    return f"{form[: LONGEST_SUMMARY_CHARACTERS - 1]}…"


def _forms(explained: Explanation) -> Iterator[str]:
    mode, refusal = explained.mode, explained.refusal
    if mode is Mode.STOPPING:
        yield "the gateway is ending"
    elif mode is Mode.STARTING and explained.waits and not _dead_links(explained):
        yield from _condition(explained, explained.waits[0])
    elif words := _in_words(refusal):
        stopped = "stopped, " if mode is Mode.FAULT else ""
        yield from (f"{stopped}{form}" for form in words)
    elif mode is Mode.FAULT:
        yield from _fault(explained)
    elif explained.blocks:
        yield from _blocked(explained)
    elif refusal:
        yield f"before arming: {refusal}"
    else:
        yield from _unblocked(explained)


def _unblocked(explained: Explanation) -> Iterator[str]:
    if explained.waits:
        yield from _condition(explained, explained.waits[0])
    elif explained.mode is Mode.ACTIVE:
        yield from _active(explained)
    elif explained.mode is Mode.STANDBY:
        yield "waiting for you: press Arm"
    else:
        yield "waiting for the next tick"


def _condition(explained: Explanation, wait: str) -> Iterator[str]:
    if not wait.startswith(WAITING_FOR):
        yield from _in_words(wait) or [wait]
        return
    message, _, frames = wait.removeprefix(WAITING_FOR).partition(": ")
    named = f"{WAITING_FOR}{_part(message, '')}"
    if frames:
        yield f"{named}, {frames}"
        yield named
    else:
        others = sum(other.startswith(WAITING_FOR) for other in explained.waits) - 1
        since = [held for held in explained.blocks if held.finding.subject == message]
        yield from _since(explained, named, since[0] if since else None, others)


def _in_words(sentence: str) -> list[str]:
    for beginning, words in _WORDS.items():
        if sentence.startswith(beginning):
            whole = words + sentence.removeprefix(beginning)
            return [whole, whole.partition(" (")[0], whole.partition("; ")[0]]
    return []


def _blocked(explained: Explanation, stopped: str = "") -> Iterator[str]:
    """The cause that blocks, the link before others; where it is over it only counts a while."""
    held = (*_dead_links(explained), *explained.blocks)[0]
    finding, others = held.finding, len(_subjects(explained.blocks)) - 1
    if not held.stands(explained.judged_ns):
        yield from _shortened(f"{stopped}waiting a moment after {_named(held)}", "")
    elif finding.cause in _AWAITED:
        named = f"{stopped}{WAITING_FOR}{_part(finding.subject, finding.detail)}"
        yield from _since(explained, named, held, others)
    else:
        yield from _since(explained, f"{stopped}blocked by {_named(held)}", held, others)


def _fault(explained: Explanation) -> Iterator[str]:
    """What holds the fault; where nothing does, what latched it, and the reset."""
    blocks, latch = explained.blocks, explained.latch
    if blocks and blocks[0].finding.subject != _EMERGENCY_STOP:
        yield from _blocked(explained, "stopped, ")
        return
    level = "service " if latch and latch.fault_class is FaultClass.SERVICE else ""
    stopped = _latched(latch) if latch else "stopped"
    yield from _shortened(stopped, f", {level}reset first")


def _active(explained: Explanation) -> Iterator[str]:
    if explained.limits:
        held = explained.limits[0]
        others = len(_subjects(explained.limits)) - 1
        yield from _since(explained, f"limited by {_named(held)}", held, others)
    elif not explained.demand_fresh:
        yield "waiting for a fresh demand"
    else:
        yield "drive: nothing limits it"


def _since(
    explained: Explanation, named: str, held: HeldCause | None, others: int
) -> Iterator[str]:
    """With the count of others and the time, then shorter."""
    since = ""
    if held:
        since = f", since {_age(explained.now_ns - held.since_ns)}"
        if not held.stands(explained.judged_ns):
            since = ", until the restart" if held.finding.until_restart else ", over soon"
    if others:
        yield f"{named} and {others} more{since}"
    yield from _shortened(named, since)


def _shortened(named: str, end: str) -> Iterator[str]:
    """Part and what of it, from whole to without the end and without a value."""
    part, separator, what = named.rpartition(": ")
    bare = f"{part}{separator}{what.partition(' ')[0]}" if separator else named
    yield f"{named}{end}"
    yield f"{named.partition(' (')[0]}{end}"
    yield named.partition(" (")[0]
    yield f"{bare}{end}"
    yield bare


def _dead_links(explained: Explanation) -> list[HeldCause]:
    return [
        held
        for held in explained.blocks
        if held.finding.cause == "link" and held.stands(explained.judged_ns)
    ]


def _subjects(causes: tuple[HeldCause, ...]) -> set[str]:
    return {held.finding.subject for held in causes}


def _named(held: HeldCause) -> str:
    finding = held.finding
    if finding.effect is Effect.CAP:
        return str(finding)
    return _part(finding.subject, finding.detail, _OF_A_MESSAGE.get(finding.cause, ""))


def _latched(latch: LatchedFault) -> str:
    reason = latch.reason
    for effect in _EFFECTS:
        reason = reason.removesuffix(effect)
    for subject in (*_PARTS, reason.partition(" ")[0]):
        is_known = subject in _PARTS or subject.partition("_")[0] in _NODES
        if is_known and f"{reason} ".startswith(f"{subject} "):
            detail = reason.removeprefix(subject).strip()
            return f"stopped by {_part(subject, detail, _OF_A_MESSAGE['stale'])}"
    return f"stopped: {reason}"


def _part(subject: str, detail: str, of_a_message: str = "") -> str:
    if subject in _PARTS:
        return _PARTS[subject].format(detail)
    message, _, signal = subject.partition(".")
    what = f"{signal} {detail}" if signal else f"{message}{of_a_message}"
    node = _NODES.get(message.partition("_")[0], message if signal else "")
    return f"{node}: {what}" if node else what


def _age(duration_ns: int) -> str:
    """1.5 s, 3 min, 2 h."""
    seconds = max(0, duration_ns) / NS_PER_S
    if seconds < _LONG_S:
        return f"{seconds:.1f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < _LONG_S else f"{minutes / 60:.0f} h"
