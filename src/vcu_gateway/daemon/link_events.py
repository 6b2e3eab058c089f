"""Link events: the reconnector's changes handed to the gateway and emitted as events."""

from vcu_gateway.bus.connection import BusConnection
from vcu_gateway.bus.reconnect import (
    CarrierChanged,
    LinkLost,
    LinkOpened,
    Reconnector,
    Unavailable,
    interface_warnings,
)
from vcu_gateway.core.calls import ChangeCarrier, LoseLink, OpenLink
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.daemon.event_log import EventLog
from vcu_gateway.rate_limit import TokenBucket

_DROPS_EVERY_NS = 10_000_000_000
_CHANGES_AT_ONCE = 10
_CHANGE_EVERY_NS = 2_000_000_000

_SEVERITIES = {LinkState.UP: Severity.INFO, LinkState.WARNING: Severity.WARNING}


class LinkEvents:
    """Hands the gateway one link change before each tick, so that a tick sees every loss.

    A link that was lost and is back between two ticks has been lost for one of them, and
    frames leave on it from the tick on that knows of it.
    """

    def __init__(
        self,
        gateway: Gateway,
        connection: BusConnection,
        reconnector: Reconnector,
        event_log: EventLog,
    ) -> None:
        self._gateway = gateway
        self._connection = connection
        self._reconnector = reconnector
        self._event_log = event_log
        self._reported_state = LinkState.UP
        # So that a flickering link fills no log.
        self._changes = TokenBucket(_CHANGE_EVERY_NS, _CHANGES_AT_ONCE, now_ns=0)
        self._dropped_before = 0
        self._next_drops_ns = 0
        self._warnings: dict[str, Event] = {}

    def begin(self, now_ns: int) -> None:
        """Begin with a lost link: nothing is open yet."""
        self._gateway.apply(LoseLink(now_ns))
        if (holder := self._connection.lock_held_by) is not None:
            fields = {"channel": self._connection.settings.channel, "holder": holder}
            self._event_log.emit(Event("lock_ignored", Severity.WARNING, fields))

    def before_tick(self, now_ns: int) -> None:
        """Hand on the oldest change that the reconnector found; RuntimeError where it has died."""
        self._reconnector.check()
        if not self._reconnector.changes:
            return
        match self._reconnector.changes.popleft():
            case LinkOpened() as opened:
                self._take_opening(opened, now_ns)
            case LinkLost(at_ns, why):
                self._gateway.apply(LoseLink(at_ns))
                self._event_log.emit(Event("link_lost", Severity.ERROR, {"reason": why}))
            case Unavailable(why):
                self._event_log.emit(Event("link_unavailable", Severity.ERROR, {"reason": why}))
            case CarrierChanged(at_ns, present):
                self._gateway.apply(ChangeCarrier(Carrier(present, at_ns)))

    def _take_opening(self, opened: LinkOpened, now_ns: int) -> None:
        link = LinkStatus(opened.state, opened.at_ns)
        carrier = Carrier(opened.carrier, opened.at_ns)
        self._gateway.apply(OpenLink(link, carrier, now_ns))
        self._connection.start_sending()
        self._event_log.emit(Event("link_open", Severity.INFO))
        for warning in interface_warnings(opened, self._connection.settings):
            if self._warnings.get(warning.name) != warning:
                self._warnings[warning.name] = warning
                self._event_log.emit(warning)

    def after_tick(self, now_ns: int) -> None:
        """Emit a changed link state and newly dropped frames, both at a bounded rate."""
        state = self._gateway.link.state
        reported = (self._reported_state, LinkState.LOST)  # a loss is emitted with its reason
        if state not in reported and now_ns >= self._changes.ready_ns:
            self._changes.take(now_ns)
            self._emit_state(state)
        dropped = self._connection.dropped or 0
        if dropped != self._dropped_before and now_ns >= self._next_drops_ns:
            self._next_drops_ns = now_ns + _DROPS_EVERY_NS
            self._emit_drops(dropped)

    def _emit_state(self, state: LinkState) -> None:
        before, self._reported_state = self._reported_state, state
        fields = {"state": state.value, "before": before.value}
        self._event_log.emit(Event("link_state", _SEVERITIES.get(state, Severity.ERROR), fields))

    def _emit_drops(self, dropped: int) -> None:
        before, self._dropped_before = self._dropped_before, dropped
        self._event_log.emit(
            Event("frames_dropped", Severity.WARNING, {"frames": dropped - before})
        )
