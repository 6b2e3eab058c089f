"""Demand of the operator: bounded, finite, with a time to live and one owner."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import NamedTuple, Protocol

from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, RANGES, SPEED_LIMIT_HIGHEST_RPM, span
from vcu_gateway.units import NS_PER_MS

CONTROLLERS = ("PCU1", "PCU2")

BENCH_SOURCE = "bench"
"""Owner of the static demand of a test bench; no other source may use the name."""

RELEASED_PCT = 5.0
"""A throttle below it is released."""

MOST_SOURCES = 64
"""Sources whose last sequence number is kept, for as long as the gateway runs."""


class PowerMode(IntEnum):
    """The command's power modes; the numbers are the codes on the wire."""

    ECO = 0
    NORMAL = 1
    TURBO = 2
    SAFETY = 3


@dataclass(frozen=True, slots=True)
class ControllerDemand:
    """Demand of one controller.

    Every quantity is within its range in `RANGES`; throttle_track2_pct is what the pedal's second
    track says, None where it has none.
    """

    throttle_pct: float = 0.0
    brake_pct: float = 0.0
    power_mode: PowerMode = PowerMode.ECO
    motor_reverse: bool = False
    regen_brake: bool = False
    speed_limit_rpm: float = float(SPEED_LIMIT_HIGHEST_RPM)
    power_limit_w: float = float(POWER_LIMIT_HIGHEST_W)
    throttle_track2_pct: float | None = None


ControllerDemands = Mapping[str, ControllerDemand]
"""Demand of each controller, by name."""


@dataclass(frozen=True, slots=True)
class Demand:
    """Demand of one source for both controllers.

    Attributes:
        source: name of the sender.
        sequence: number of the request, rising within a source.
        ttl_ms: how long it counts; None for ever (the bench demand alone).
        controllers: demand of each controller, by name.
        made_ns: when it was made, from where its time to live counts; None when it is offered.
    """

    source: str
    sequence: int
    ttl_ms: int | None
    controllers: ControllerDemands
    made_ns: int | None = None


class Refusal(Enum):
    """Reason for refusing a request; the values are stable words for machines."""

    NOT_FINITE = "not_finite"
    OUT_OF_RANGE = "out_of_range"
    CONTROLLER_MISSING = "controller_missing"
    SECOND_TRACK_MISSING = "second_track_missing"
    DIRECTIONS_DIFFER = "directions_differ"
    TTL_OUT_OF_RANGE = "ttl_out_of_range"
    NAME_RESERVED = "name_reserved"
    OTHER_OWNER = "other_owner"
    OLD_SEQUENCE = "old_sequence"
    TOO_MANY_SOURCES = "too_many_sources"
    EXPIRED = "expired"
    FROM_THE_FUTURE = "from_the_future"
    NOT_ALLOWED_NOW = "not_allowed_now"
    NO_SUCH_MODE = "no_such_mode"


class RequestResult(NamedTuple):
    """Result of a request: granted, or the refusal as a code and a sentence."""

    granted: bool
    refusal: Refusal | None = None
    sentence: str = ""


GRANTED = RequestResult(granted=True)


def refused(refusal: Refusal, sentence: str) -> RequestResult:
    return RequestResult(False, refusal, sentence)


class DemandTerms(Protocol):
    """Conditions of a demand, and priorities of sources; the settings have them."""

    @property
    def ttl_max_ms(self) -> int: ...
    @property
    def priorities(self) -> Mapping[str, int]: ...
    @property
    def independent_directions(self) -> bool: ...
    @property
    def second_track_required(self) -> bool: ...


def fault_of(demand: Demand, terms: DemandTerms) -> RequestResult:
    """First fault of the demand's values, as a refusal; GRANTED where there is none."""
    for controller in CONTROLLERS:
        if controller not in demand.controllers:
            sentence = f"the demand says nothing of {controller}"
            return refused(Refusal.CONTROLLER_MISSING, sentence)
        answer = _fault_of_values(controller, demand.controllers[controller], terms)
        if not answer.granted:
            return answer
    if not terms.independent_directions and directions_differ(demand.controllers):
        sentence = "both controllers must have the same direction"
        return refused(Refusal.DIRECTIONS_DIFFER, sentence)
    if demand.ttl_ms is not None and not 0 < demand.ttl_ms <= terms.ttl_max_ms:
        sentence = f"ttl_ms must be 1 to {terms.ttl_max_ms}, not {demand.ttl_ms}"
        return refused(Refusal.TTL_OUT_OF_RANGE, sentence)
    return GRANTED


def directions_differ(demanded: ControllerDemands) -> bool:
    return len({one.motor_reverse for one in demanded.values()}) > 1


def _fault_of_values(
    controller: str, demanded: ControllerDemand, terms: DemandTerms
) -> RequestResult:
    if terms.second_track_required and demanded.throttle_track2_pct is None:
        sentence = f"{controller} throttle_track2_pct is missing; the configuration requires it"
        return refused(Refusal.SECOND_TRACK_MISSING, sentence)
    for name, (lowest, highest) in RANGES.items():
        given = getattr(demanded, name)
        if given is None:
            continue
        value = _as_float(given)
        if not math.isfinite(value):
            return refused(Refusal.NOT_FINITE, f"{controller} {name} is {value}")
        if not lowest <= value <= highest:
            sentence = f"{controller} {name} must be {span(name)}, not {value:g}"
            return refused(Refusal.OUT_OF_RANGE, sentence)
    return GRANTED


def _as_float(value: float) -> float:
    """Value as a float; infinity for an int beyond every float."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _fault_of_time(ttl_ms: int, made_ns: int, now_ns: int) -> RequestResult:
    """Refusal of a demand that is too old, or from the future, when it arrives; else GRANTED."""
    age_ns = now_ns - made_ns
    if age_ns < 0:
        sentence = f"made_ns is {-age_ns} ns ahead of this machine's monotonic clock"
        return refused(Refusal.FROM_THE_FUTURE, sentence)
    if age_ns > ttl_ms * NS_PER_MS:
        sentence = f"it is {age_ns // NS_PER_MS} ms old and counts for {ttl_ms} ms"
        return refused(Refusal.EXPIRED, sentence)
    return GRANTED


class DemandArbiter:
    """Arbiter of demands: the one that counts, and which source owns it.

    A source owns the demand while its own is fresh; meanwhile only a source of higher
    priority takes it over. The last sequence number of every source is kept, so that an old
    request cannot come back, whichever source had the demand meanwhile.

    Attributes:
        current: the last demand taken, fresh or not; None before the first.
    """

    def __init__(self, bench_demand: ControllerDemand | None) -> None:
        self.current: Demand | None = None
        self._made_ns = 0
        self._ended = False
        self._sequences: dict[str, int] = {}
        if bench_demand is not None:
            both = dict.fromkeys(CONTROLLERS, bench_demand)
            self.current = Demand(BENCH_SOURCE, 0, None, both)

    def offer(self, demand: Demand, terms: DemandTerms, now_ns: int) -> RequestResult:
        """Take a demand or refuse it; a refused one changes nothing."""
        if demand.source == BENCH_SOURCE or demand.ttl_ms is None:
            return refused(Refusal.NAME_RESERVED, f"{BENCH_SOURCE} is the configured bench demand")
        made_ns = now_ns if demand.made_ns is None else demand.made_ns
        answer = fault_of(demand, terms)
        if answer.granted:
            answer = _fault_of_time(demand.ttl_ms, made_ns, now_ns)
        if answer.granted:
            answer = self._fault_of_sequence(demand)
        if answer.granted:
            answer = self._right_of(demand.source, terms.priorities, now_ns)
        if answer.granted:
            self.current, self._made_ns, self._ended = demand, made_ns, False
            self._sequences[demand.source] = demand.sequence
        return answer

    def _fault_of_sequence(self, demand: Demand) -> RequestResult:
        last = self._sequences.get(demand.source)
        if last is None:
            if len(self._sequences) < MOST_SOURCES:
                return GRANTED
            sentence = f"{MOST_SOURCES} sources have asked since the start, which is the most"
            return refused(Refusal.TOO_MANY_SOURCES, sentence)
        if demand.sequence > last:
            return GRANTED
        return refused(Refusal.OLD_SEQUENCE, f"sequence {demand.sequence} is not above {last}")

    def _right_of(self, source: str, priorities: Mapping[str, int], now_ns: int) -> RequestResult:
        owner = self.current
        if owner is None or owner.source == source or not self.fresh(now_ns):
            return GRANTED
        if priorities.get(source, 0) > priorities.get(owner.source, 0):
            return GRANTED
        return refused(Refusal.OTHER_OWNER, f"{owner.source} owns the demand")

    def end(self, source: str) -> RequestResult:
        """The demand of its owner counts no more; refused for any other source."""
        if self.current is None or self.current.source != source:
            return refused(Refusal.OTHER_OWNER, f"{source} does not own the demand")
        self._ended = True
        return GRANTED

    @property
    def taken(self) -> bool:
        """True once a source made a demand: the bench demand counts no more."""
        return self.current is not None and self.current.ttl_ms is not None

    @property
    def made_ns(self) -> int:
        """When the last demand taken was made; 0 before the first."""
        return self._made_ns

    def age_ns(self, now_ns: int) -> int | None:
        """Time since the demand was made; None without one and for the bench demand."""
        if self.current is None or self.current.ttl_ms is None:
            return None
        return now_ns - self._made_ns

    def fresh(self, now_ns: int) -> bool:
        """True while the demand counts: not ended, and not older than its time to live."""
        if self.current is None or self._ended:
            return False
        if self.current.ttl_ms is None:
            return True
        return 0 <= now_ns - self._made_ns <= self.current.ttl_ms * NS_PER_MS
