"""The link as the ticking thread sees it: the keeper's news taken in, and told as events."""

from vcu_gateway.bus.connection import BusConnection
from vcu_gateway.bus.interface_warnings import interface_warnings
from vcu_gateway.bus.reconnect import CarrierChanged, LinkLost, LinkOpened, Reconnector, Unavailable
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.daemon.event_log import EventLog

_DROPS_TOLD_EVERY_NS = 10_000_000_000
_CHANGES_AT_ONCE = 10
_CHANGE_EVERY_NS = 2_000_000_000

_SEVERITIES = {LinkState.UP: Severity.INFO, LinkState.WARNING: Severity.WARNING}


class LinkEvents:
    """Takes one piece of news before each tick, so that a tick sees every loss.

    A link that was lost and is back between two ticks has been lost for one of them, and
    frames leave on it from the tick on that knows of it.
    """

    def __init__(
        self, gateway: Gateway, door: BusConnection, keeper: Reconnector, journal: EventLog
    ) -> None:
        self._gateway = gateway
        self._door = door
        self._keeper = keeper
        self._journal = journal
        self._told_state = LinkState.UP
        self._restraint = _Restraint()
        self._dropped_before = 0
        self._tell_drops_ns = 0
        self._cautions: dict[str, Event] = {}

    def begin(self, now_ns: int) -> None:
        """Nothing is open yet."""
        self._gateway.link_lost(now_ns)
        if (holder := self._door.lock_held_by) is not None:
            fields = {"channel": self._door.settings.channel, "holder": holder}
            self._journal.tell(Event("lock_ignored", Severity.WARNING, fields))

    def before_tick(self, now_ns: int) -> None:
        """Take in what the keeper found."""
        self._keeper.check()
        self._gateway.intake.book.begin_tick()
        if not self._keeper.news:
            return
        match self._keeper.news.popleft():
            case LinkOpened() as opened:
                self._take_opening(opened, now_ns)
            case LinkLost(at_ns, why):
                self._gateway.link_lost(at_ns)
                self._journal.tell(Event("link_lost", Severity.ERROR, {"reason": why}))
            case Unavailable(why):
                self._journal.tell(Event("link_unavailable", Severity.ERROR, {"reason": why}))
            case CarrierChanged(at_ns, present):
                self._gateway.intake.book.note_carrier(Carrier(present, at_ns))

    def _take_opening(self, opened: LinkOpened, now_ns: int) -> None:
        self._gateway.link_opened(now_ns)
        link = LinkStatus(opened.state, opened.at_ns)
        carrier = Carrier(opened.carrier, opened.at_ns)
        self._gateway.intake.book.begin(link, carrier)
        self._door.admit()
        self._journal.tell(Event("link_open", Severity.INFO))
        for caution in interface_warnings(opened, self._door.settings):
            if self._cautions.get(caution.name) != caution:
                self._cautions[caution.name] = caution
                self._journal.tell(caution)

    def after_tick(self, now_ns: int) -> None:
        """Tell what changed."""
        state = self._gateway.link.state
        told = (self._told_state, LinkState.LOST)  # a loss is told with its reason
        if state not in told and self._restraint.admits(now_ns):
            self._tell_state(state)
        dropped = self._door.dropped or 0
        if dropped != self._dropped_before and now_ns >= self._tell_drops_ns:
            self._tell_drops_ns = now_ns + _DROPS_TOLD_EVERY_NS
            self._tell_drops(dropped)

    def _tell_state(self, state: LinkState) -> None:
        before, self._told_state = self._told_state, state
        fields = {"state": state.value, "before": before.value}
        self._journal.tell(Event("link_state", _SEVERITIES.get(state, Severity.ERROR), fields))

    def _tell_drops(self, dropped: int) -> None:
        before, self._dropped_before = self._dropped_before, dropped
        self._journal.tell(Event("frames_dropped", Severity.WARNING, {"frames": dropped - before}))


class _Restraint:
    """Some at once, then one in a while: a link that flickers must not fill the log."""

    def __init__(self) -> None:
        self._left = _CHANGES_AT_ONCE
        self._next_ns = 0

    def admits(self, now_ns: int) -> bool:
        """Whether one more may be told now."""
        if now_ns >= self._next_ns:
            self._left = min(_CHANGES_AT_ONCE, self._left + self._earned(now_ns))
            self._next_ns = now_ns + _CHANGE_EVERY_NS
        admitted = self._left > 0
        self._left -= admitted
        return admitted

    def _earned(self, now_ns: int) -> int:
        return 1 + (now_ns - self._next_ns) // _CHANGE_EVERY_NS
