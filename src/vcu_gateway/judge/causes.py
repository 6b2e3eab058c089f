"""Causes and effects: docs/safety.md, Causes, from the bytes and error frames of the bus alone."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.judge.arrivals import Arrivals
from vcu_gateway.judge.limits import VerdictLimits
from vcu_gateway.judge.wire import CONTROLLERS, MS

_BUS_OFF, _CONTROLLER, _RESTARTED = 0x040, 0x004, 0x100
_PASSIVE, _ACTIVE = 0x10 | 0x20, 0x40
_WARNING = 0x04 | 0x08
_WINDOW_NS = 5_000 * MS
_PASSIVE_MAX_NS = 1_000 * MS


class BusState:
    """Bus as it is known; a bus-off that came and went between two ticks counts once."""

    def __init__(self) -> None:
        self._lost_ns: int | None = None
        self._off_ns: int | None = None
        self._went_off_ns: int | None = None
        self._passive_since_ns: int | None = None
        self._passive: deque[tuple[int, int]] = deque()

    @property
    def down_ns(self) -> int | None:
        """Since when nothing can be sent, or could not for a moment since the last tick."""
        known = (self._lost_ns, self._off_ns, self._went_off_ns)
        return min((one for one in known if one is not None), default=None)

    def error_frame(self, can_id: int, data: bytes, at_ns: int) -> None:
        if can_id & _BUS_OFF:
            self._note_off(at_ns)
        elif can_id & _RESTARTED:
            self._off_ns = None
            self._note_passive(False, at_ns)
        elif can_id & _CONTROLLER and len(data) > 1:
            self._controller_byte(data[1], at_ns)

    def _controller_byte(self, bits: int, at_ns: int) -> None:
        if bits & _PASSIVE:
            self._note_passive(True, at_ns)
        elif bits & (_WARNING | _ACTIVE):
            self._note_passive(False, at_ns)
            if bits & _ACTIVE:
                self._off_ns = None

    def _note_off(self, at_ns: int) -> None:
        if self._off_ns is None:
            self._off_ns = self._went_off_ns = at_ns
        self._note_passive(False, at_ns)

    def _note_passive(self, passive: bool, at_ns: int) -> None:
        since_ns = self._passive_since_ns
        if passive:
            self._passive_since_ns = at_ns if since_ns is None else since_ns
        elif since_ns is not None:
            self._passive.append((since_ns, at_ns))
            self._passive_since_ns = None

    def carrier(self, present: bool, at_ns: int) -> None:
        """The carrier came or went; a controller in bus-off has none."""
        if present:
            self._off_ns = None
        else:
            self._note_off(at_ns)

    def lost(self, at_ns: int) -> None:
        self._lost_ns = at_ns if self._lost_ns is None else self._lost_ns

    def opened(self) -> None:
        """The interface was opened: what was reported before no longer counts."""
        self._lost_ns = self._off_ns = None
        self._passive_since_ns = None
        self._passive.clear()

    def passive_since_ns(self, now_ns: int) -> int | None:
        """When error-passive had lasted for more than a second of five; None where it has not."""
        begin_ns = now_ns - _WINDOW_NS
        while self._passive and self._passive[0][1] <= begin_ns:
            self._passive.popleft()
        spans = list(self._passive)
        if self._passive_since_ns is not None:
            spans.append((self._passive_since_ns, now_ns))
        passive_ns = sum(until - max(since, begin_ns) for since, until in spans)
        return now_ns - (passive_ns - _PASSIVE_MAX_NS) if passive_ns > _PASSIVE_MAX_NS else None

    @property
    def is_lost(self) -> bool:
        return self._lost_ns is not None

    def end_tick(self) -> None:
        self._went_off_ns = None


TURBO_OFF, POWER_LIMIT, REGEN_LIMIT = "TURBO_OFF", "POWER_LIMIT", "REGEN_LIMIT"
REGEN_OFF, STOP, CUT = "REGEN_OFF", "STOP", "CUT"

# Bits of BMS_Status by byte and shift, with the effects of the codes 1, 2, 3.
_BATTERY: tuple[tuple[str, int, int, int, tuple[tuple[str, ...], ...]], ...] = (
    ("CellOvervoltage", 5, 0, 3, ((REGEN_LIMIT,), (REGEN_OFF,), (REGEN_OFF,))),
    ("CellUndervoltage", 5, 2, 3, ((POWER_LIMIT,), (STOP,), (CUT,))),
    ("DischargeOvercurrent", 5, 6, 3, ((REGEN_LIMIT, POWER_LIMIT), (CUT,), (CUT,))),
    ("Overtemperature", 6, 2, 3, ((), (CUT,), (CUT,))),
    ("Undertemperature", 6, 4, 3, ((REGEN_OFF,), (CUT,), (CUT,))),
    ("InternalFault", 6, 7, 1, ((CUT,),)),
)
_PROTECTION = ((TURBO_OFF,), (STOP,), (STOP,))
_VOLTAGE: dict[int, tuple[str, ...]] = {
    0: (POWER_LIMIT, REGEN_OFF),
    1: (POWER_LIMIT,),
    5: (REGEN_OFF,),
    6: (POWER_LIMIT, REGEN_OFF),
    7: (POWER_LIMIT, REGEN_OFF),
}
_UNCONFIRMED_TICKS = 3


class Seen(NamedTuple):
    """Cause with one of its effects, seen in a tick.

    Attributes:
        since_ns: when its frame arrived, or when silence passed its deadline.
        for_ever: the effect stays until the next start.
        span_ns: how much later it may have been, where a recording has no better time.
    """

    effect: str
    cause: str
    since_ns: int
    for_ever: bool = False
    span_ns: int = 0


def seen(arrivals: Arrivals, limits: VerdictLimits, now_ns: int) -> Iterator[Seen]:
    """Every cause that frames and their absence show at this tick."""
    yield from _battery(arrivals)
    yield from _silence(arrivals, limits, now_ns)
    for controller in CONTROLLERS:
        yield from _controller(arrivals, controller)
        yield from _echoes(arrivals, controller, now_ns)
    if arrivals.foreign_ns is not None:
        yield Seen(STOP, "another sender of our commands", arrivals.foreign_ns)


def _battery(arrivals: Arrivals) -> Iterator[Seen]:
    for frame in arrivals.judged("BMS_Status"):
        for signal, byte, shift, mask, effects in _BATTERY:
            code = frame.data[byte] >> shift & mask
            for effect in effects[code - 1] if code else ():
                for_ever = signal == "CellOvervoltage" and code == 3
                yield Seen(effect, f"BMS_Status.{signal} {code}", frame.at_ns, for_ever)
    repeats, at_ns = arrivals.life.worst
    if repeats:
        cause = "BMS_Status.LifeSignal unchanged"
        yield Seen(REGEN_LIMIT, cause, at_ns)
        yield Seen(POWER_LIMIT, cause, at_ns)
        if repeats > 1:
            yield Seen(STOP, cause, at_ns)


def _silence(arrivals: Arrivals, limits: VerdictLimits, now_ns: int) -> Iterator[Seen]:
    age_ns = arrivals.age_ns("BMS_Status", now_ns)
    if age_ns is not None and age_ns > limits.battery_late_ns:
        since_ns = now_ns - age_ns + limits.battery_late_ns
        for effect in (REGEN_LIMIT, POWER_LIMIT):
            yield Seen(effect, "BMS_Status late", since_ns)
    for name in (*limits.required_messages, "PCU1_Status1", "PCU2_Status1"):
        if not arrivals.stale(name, now_ns):
            continue
        silent_ns = arrivals.age_ns(name, now_ns)
        since_ns = now_ns if silent_ns is None else now_ns - silent_ns + limits.stale_ns[name]
        if name in limits.required_messages:
            yield Seen(STOP, f"{name} stale", since_ns)
        if name.endswith("Status1"):
            yield Seen(TURBO_OFF, f"{name} stale", since_ns)
            yield Seen(POWER_LIMIT, f"{name} stale", since_ns)


def _controller(arrivals: Arrivals, controller: str) -> Iterator[Seen]:
    name = f"{controller}_Status1"
    for frame in arrivals.judged(name):
        voltage, heat = frame.data[3] & 7, frame.data[3] >> 5 & 3
        for effect in _VOLTAGE.get(voltage, ()):
            yield Seen(effect, f"{name}.VoltageLevel {voltage}", frame.at_ns)
        for effect in _PROTECTION[heat - 1] if heat else ():
            yield Seen(effect, f"{name}.TemperatureProtectLevel {heat}", frame.at_ns)


def _echoes(arrivals: Arrivals, controller: str, now_ns: int) -> Iterator[Seen]:
    name = f"{controller}_Status1"
    if arrivals.stale(name, now_ns):
        return
    above, below = arrivals.above[controller], arrivals.below[controller]
    if above.worst[0]:
        yield Seen(STOP, f"{name} echoes more throttle than commanded", above.worst[1])
    other = CONTROLLERS[1 - CONTROLLERS.index(controller)]
    both = arrivals.below[other].run and not arrivals.stale(f"{other}_Status1", now_ns)
    if below.worst[0] > 1 and not both:
        yield Seen(STOP, f"{name} echoes less throttle than commanded", below.worst[1])
    turned = arrivals.turned[controller]
    if turned.worst[0] > 1:
        yield Seen(STOP, f"{name} echoes another direction", turned.worst[1])


class Unconfirmed:
    """Ticks in a row after which a controller's command did not come back."""

    def __init__(self) -> None:
        self._missed = dict.fromkeys(CONTROLLERS, 0)
        self._emitted = False

    def tick(self, echoed: dict[str, int]) -> bool:
        """True from the third on."""
        for controller in CONTROLLERS:
            if controller in echoed:
                self._missed[controller] = 0
            elif self._emitted:
                self._missed[controller] += 1
        return max(self._missed.values()) >= _UNCONFIRMED_TICKS

    def note_emitted(self, emitted: bool) -> None:
        self._emitted = emitted


class HeldEffects:
    """Effects that count: seen now, or gone for less than the holding time."""

    def __init__(self) -> None:
        self._absent_since_ns: dict[tuple[str, str], int | None] = {}
        self._for_ever: set[tuple[str, str]] = set()

    def update(self, found: list[Seen], hold_ms: float, now_ns: int) -> list[Seen]:
        """Take in what a tick sees; what of it is new."""
        keys = {(one.effect, one.cause) for one in found}
        new = [one for one in found if (one.effect, one.cause) not in self._absent_since_ns]
        for key, absent_since_ns in tuple(self._absent_since_ns.items()):
            if key in keys or key in self._for_ever:
                continue
            since_ns = now_ns if absent_since_ns is None else absent_since_ns
            self._absent_since_ns[key] = since_ns
            if now_ns - since_ns >= hold_ms * MS:
                del self._absent_since_ns[key]
        self._absent_since_ns.update(dict.fromkeys(keys))
        self._for_ever |= {(one.effect, one.cause) for one in found if one.for_ever}
        return new

    @property
    def effects(self) -> set[str]:
        return {effect for effect, _ in self._absent_since_ns}

    @property
    def blocking(self) -> bool:
        """True while a cause stops or cuts, or did a moment ago."""
        return any(effect in (STOP, CUT) for effect, _ in self._absent_since_ns)
