"""Granted demands: the one that counts, and what holds the throttle at 0."""

from typing import NamedTuple

from vcu_gateway.judge.limits import JudgedDemand, JudgedDemands
from vcu_gateway.judge.wire import MS

_TRACKS_PCT, _TRACKS_NS = 10.0, 100 * MS
_RELEASED_PCT = 5.0
_OVERRIDE_THROTTLE_PCT, _OVERRIDE_BRAKE_PCT = 25.0, 5.0


class GrantedDemand(NamedTuple):
    """Demand that was granted, and how long it counts; ttl_ms None: for ever."""

    source: str
    controllers: JudgedDemands
    made_ns: int
    ttl_ms: int | None

    def fresh(self, now_ns: int) -> bool:
        return self.ttl_ms is None or 0 <= now_ns - self.made_ns <= self.ttl_ms * MS


class GrantedDemands:
    """Demands since the last tick and the one that counts.

    Attributes:
        known: False until the first demand of a recording that begins in the middle.
        directions: reverse or not, by controller, as demanded since the last tick.
    """

    def __init__(self, bench: JudgedDemands | None, *, known: bool) -> None:
        self.known = known or bench is not None
        self.current: GrantedDemand | None = None
        self._judged: GrantedDemand | None = None
        if bench is not None:
            self.current = GrantedDemand("bench", bench, 0, None)
        self.directions: set[tuple[str, bool]] = set()
        self._held: set[str] = set()
        self._this_interval: set[str] = set()
        self._apart_since_ns: int | None = None
        self._released_since_ns: int | None = None

    def offered(self, now_ns: int) -> None:
        """A demand is offered: what was interrupted begins anew."""
        if not self.fresh(now_ns):
            self._apart_since_ns = self._released_since_ns = None

    def granted(self, demand: GrantedDemand, now_ns: int, *, driving: bool) -> None:
        """Take a demand that was granted; `driving`: in ACTIVE."""
        before = self.current
        if driving and before is not None and before.source != demand.source:
            self._hold("another source took over")
        self.current = self._judged = demand
        self.known = True
        self._judge(demand.controllers, demand.made_ns, now_ns)

    def doubted(self, demand: GrantedDemand) -> None:
        """Take a demand of pedals that are not believed: it releases nothing, and holds a tick."""
        self.current = self._judged = demand
        self.known = True
        self._note_directions(demand.controllers)
        self._released_since_ns = None
        self._this_interval.add("a pedal is not believed")

    def ended(self) -> None:
        if self.current is not None:
            self.current = self.current._replace(made_ns=-(10**18), ttl_ms=0)

    def fresh(self, now_ns: int) -> bool:
        """True while there is a demand that counts."""
        return self.current is not None and self.current.fresh(now_ns)

    def is_owner(self, source: str) -> bool:
        return self.current is not None and self.current.source == source

    def of(self, controller: str) -> JudgedDemand | None:
        """What is demanded of a controller, fresh or not."""
        return None if self.current is None else self.current.controllers[controller]

    def released_for_ns(self, now_ns: int) -> int | None:
        """How long every demand had a throttle of 0; None where the last has not."""
        if self.current is not None and self.current.ttl_ms is None:
            return now_ns  # a static demand's throttle reads as 0 until ACTIVE
        since_ns = self._released_since_ns
        return None if since_ns is None else now_ns - since_ns

    def asks_throttle(self, now_ns: int) -> bool:
        """True where a fresh demand has throttle; a static one's reads as 0 until ACTIVE."""
        one = self.current
        if one is None or one.ttl_ms is None or not one.fresh(now_ns):
            return False
        return any(each.throttle_pct > 0 for each in one.controllers.values())

    def _hold(self, reason: str) -> None:
        self._held.add(reason)
        self._this_interval.add(reason)

    def _judge(self, demanded: JudgedDemands, made_ns: int, now_ns: int) -> None:
        self._note_directions(demanded)
        pedals = demanded.values()
        if any(one.throttle_pct > 0 for one in pedals):
            self._released_since_ns = None
        elif self._released_since_ns is None:
            self._released_since_ns = now_ns
        self._judge_tracks(demanded, made_ns, now_ns)
        if any(_overrides(one) for one in pedals):
            self._hold("brake over throttle")
        elif all(one.throttle_pct < _RELEASED_PCT for one in pedals):
            self._held -= {"brake over throttle", "another source took over"}

    def _note_directions(self, demanded: JudgedDemands) -> None:
        self.directions.update([(name, one.motor_reverse) for name, one in demanded.items()])

    def _judge_tracks(self, demanded: JudgedDemands, made_ns: int, now_ns: int) -> None:
        since_ns = self._apart_since_ns
        if since_ns is not None and now_ns > since_ns + _TRACKS_NS:
            self._hold("the pedal's tracks differ")
        apart = any(abs(one.throttle_pct - _track2(one)) > _TRACKS_PCT for one in demanded.values())
        if not apart:
            self._apart_since_ns = None
        elif since_ns is None:
            self._apart_since_ns = made_ns
        tracks = [max(one.throttle_pct, _track2(one)) for one in demanded.values()]
        if max(tracks) < _RELEASED_PCT:
            self._held.discard("the pedal's tracks differ")

    def holds(self, now_ns: int) -> set[str]:
        """Why the throttle has to be 0 in this tick; the next interval begins."""
        if self.current is None or not self.fresh(now_ns):
            self._apart_since_ns = self._released_since_ns = None
        elif self.current is self._judged and self._apart_since_ns is None:
            self._note_directions(self.current.controllers)
        else:
            self._judge(self.current.controllers, now_ns, now_ns)
        found = self._held | self._this_interval
        self._this_interval = set()
        return found

    def end_tick(self) -> None:
        self.directions.clear()


def _track2(one: JudgedDemand) -> float:
    return one.throttle_pct if one.throttle_track2_pct is None else one.throttle_track2_pct


def _overrides(one: JudgedDemand) -> bool:
    return one.throttle_pct > _OVERRIDE_THROTTLE_PCT and one.brake_pct > _OVERRIDE_BRAKE_PCT
