"""Bus state: lost, bus-off and error-passive, from error frames and what the interface said."""

from collections import deque

from vcu_gateway.replay.verdict.wire import MS

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
        """Take in an error frame; the identifier carries the classes."""
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
        """The interface is down or gone."""
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
        """True while there is no interface."""
        return self._lost_ns is not None

    def end_tick(self) -> None:
        """A bus-off that is over has been judged."""
        self._went_off_ns = None
