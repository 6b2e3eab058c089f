"""Pedals: latches that hold the throttle at 0, judged from every demand between two ticks.

Every demand is judged when it is granted, not only the one that a tick finds: a pedal that was
wrong for a millisecond was wrong.
"""

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

from vcu_gateway.core.demand import ControllerDemands

_OVERRIDE_THROTTLE_PCT = 25.0
_OVERRIDE_BRAKE_PCT = 5.0
_RELEASED_PCT = 5.0
_TRACKS_DIFFERENCE_PCT = 10.0
_TRACKS_DIFFER_MAX_NS = 100_000_000


class ThrottleHold(Enum):
    """Reason for holding both throttles at 0 until the pedal is released."""

    OVERRIDE = "brake over throttle"
    TRACKS = "the pedal's tracks differ"
    TAKEN_OVER = "another source took over"
    SIGNAL = "a pedal is not to be believed"


class _PedalState(NamedTuple):
    """Pedals of one demand: any controller's begin a hold, those of every one end it.

    Attributes:
        drives: throttle is demanded.
        overrides: brake over throttle.
        differs: the tracks of one controller are too far apart.
        released, track2_released: the track is below 5 %; true where there is no second one.
    """

    drives: bool
    overrides: bool
    differs: bool
    released: bool
    track2_released: bool


def _not_known(differs: bool) -> _PedalState:
    """Pedals that are not to be believed: they may be anywhere."""
    return _PedalState(True, False, differs, False, False)


class Pedals:
    """Latches of the throttle pedal and demanded directions, from one tick to the next.

    A latch ends with a demand whose throttle is below 5 % for every controller, on both tracks
    for the tracks' latch; the tick after a demand that set it has throttle 0 in any case.
    Times are those of the gateway's clock in ns; memory does not grow with the demands.

    Attributes:
        latched: what holds the throttle until the pedal is released.
    """

    def __init__(self) -> None:
        self.latched: set[ThrottleHold] = set()
        self._this_interval: set[ThrottleHold] = set()
        self._directions: set[tuple[str, bool]] = set()
        self._differ_since_ns: int | None = None
        self._zero_since_ns: int | None = None
        self._judged: tuple[ControllerDemands, _PedalState] | None = None

    def judge(
        self, demanded: ControllerDemands, made_ns: int, now_ns: int, *, known: bool = True
    ) -> None:
        """Take a demand that was made then and is granted now.

        One whose pedals are not `known` releases nothing, and holds the tick that follows.
        """
        self._note_directions(demanded)
        if not known:
            self._this_interval.add(ThrottleHold.SIGNAL)
            self._judged = demanded, _not_known(self._differ_since_ns is not None)
        state = self._state_of(demanded)
        self._judge_zero(state, now_ns)
        self._judge_tracks(state, made_ns, now_ns)
        self._judge_override(state)

    def interrupted(self) -> None:
        """No demand is fresh: what has to last without interruption begins anew."""
        self._differ_since_ns = self._zero_since_ns = None
        self._judged = None

    def taken_over(self) -> None:
        """Another source's demand is next, in the middle of a drive."""
        self._latch(ThrottleHold.TAKEN_OVER)
        self._judged = None

    def zero_for_ns(self, now_ns: int) -> int | None:
        """How long every demand had a throttle of 0; None where the last one has not."""
        return None if self._zero_since_ns is None else now_ns - self._zero_since_ns

    def tick(
        self, demanded: ControllerDemands | None, applied: Mapping[str, bool], now_ns: int
    ) -> bool:
        """Whether the throttle stays 0 in this tick; the next interval begins.

        `demanded` is what counts now, None without a fresh demand; `applied` holds whether each
        controller turns in reverse. A direction that any demand of the interval has and
        that is not the applied one holds the throttle too.
        """
        judged_before = self._judged is not None and self._judged[0] is demanded
        if demanded is None:
            self.interrupted()
        elif judged_before and self._differ_since_ns is None:
            self._note_directions(demanded)
        else:
            self.judge(demanded, now_ns, now_ns)  # its tracks last; a bench demand is never granted
        turning = not applied.items() >= self._directions
        held = turning or bool(self.latched or self._this_interval)
        self._this_interval.clear()
        self._directions.clear()
        return held

    def _note_directions(self, demanded: ControllerDemands) -> None:
        for name, one in demanded.items():
            self._directions.add((name, one.motor_reverse))

    def _state_of(self, demanded: ControllerDemands) -> _PedalState:
        """Pedals of a demand; kept, because a tick meets the one again that was judged last."""
        if self._judged is None or self._judged[0] is not demanded:
            self._judged = demanded, _pedal_state(demanded)
        return self._judged[1]

    def _judge_zero(self, state: _PedalState, now_ns: int) -> None:
        if state.drives:
            self._zero_since_ns = None
        elif self._zero_since_ns is None:
            self._zero_since_ns = now_ns

    def _judge_tracks(self, state: _PedalState, made_ns: int, now_ns: int) -> None:
        since_ns = self._differ_since_ns
        if since_ns is not None and now_ns - since_ns > _TRACKS_DIFFER_MAX_NS:
            self._latch(ThrottleHold.TRACKS)  # also where this demand ends the difference
        if not state.differs:
            self._differ_since_ns = None
        elif since_ns is None:
            self._differ_since_ns = made_ns
        if state.released and state.track2_released:
            self.latched.discard(ThrottleHold.TRACKS)

    def _judge_override(self, state: _PedalState) -> None:
        if state.overrides:
            self._latch(ThrottleHold.OVERRIDE)
        elif state.released:
            self.latched -= {ThrottleHold.OVERRIDE, ThrottleHold.TAKEN_OVER}

    def _latch(self, hold: ThrottleHold) -> None:
        self.latched.add(hold)
        self._this_interval.add(hold)


def _pedal_state(demanded: ControllerDemands) -> _PedalState:
    drives = differs = overrides = False
    released = track2_released = True
    for one in demanded.values():
        throttle_pct, track2_pct = one.throttle_pct, one.throttle_track2_pct
        drives |= throttle_pct > 0
        released &= throttle_pct < _RELEASED_PCT
        overrides |= throttle_pct > _OVERRIDE_THROTTLE_PCT and one.brake_pct > _OVERRIDE_BRAKE_PCT
        if track2_pct is not None:
            differs |= abs(throttle_pct - track2_pct) > _TRACKS_DIFFERENCE_PCT
            track2_released &= track2_pct < _RELEASED_PCT
    return _PedalState(drives, overrides, differs, released, track2_released)
