"""Events: handed to subscribers and counted; those of a latched CUT and of the link."""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime

from vcu_gateway.bus import reconnect
from vcu_gateway.bus.connection import BusConnection
from vcu_gateway.core.calls import ChangeCarrier, LoseLink, OpenLink
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.stop import GAP_NS, Stop, StopStage
from vcu_gateway.rate_limit import TokenBucket
from vcu_gateway.units import NS_PER_S

_ENTRIES = 200


@dataclass(slots=True)
class LoggedEvent:
    """One event with its fields, counted; times of the monotonic clock in ns."""

    event: Event
    count: int
    first_ns: int
    last_ns: int
    last_wall_s: float

    def last_time(self) -> str:
        """Wall-clock time of the last one, ISO 8601, UTC."""
        return datetime.fromtimestamp(self.last_wall_s, UTC).isoformat(timespec="milliseconds")


class EventLog:
    """The latest events; one that happens again with the same severity and fields is counted.

    Belongs to the ticking thread.

    Attributes:
        forgotten: entries that made room for later ones.
    """

    def __init__(self) -> None:
        self._entries: OrderedDict[tuple[str, int, str], LoggedEvent] = OrderedDict()
        self._subscribers: list[Callable[[Event], None]] = []
        self.forgotten = 0

    def subscribe(self, take: Callable[[Event], None]) -> None:
        """Hand it each event as it happens, on the ticking thread; it neither waits nor raises."""
        self._subscribers.append(take)

    def emit(self, event: Event) -> None:
        for take in self._subscribers:
            take(event)
        key = (event.name, event.severity, repr(sorted(event.fields.items())))
        now_ns, wall_s = time.monotonic_ns(), time.time()
        entry = self._entries.setdefault(key, LoggedEvent(event, 0, now_ns, now_ns, wall_s))
        entry.count += 1
        entry.last_ns, entry.last_wall_s = now_ns, wall_s
        self._entries.move_to_end(key)
        if len(self._entries) > _ENTRIES:
            self._entries.popitem(last=False)
            self.forgotten += 1

    def latest(self, limit: int) -> Iterable[LoggedEvent]:
        """The latest `limit` entries, the latest last."""
        return list(self._entries.values())[-limit:]


class StopEvents:
    """Emits `stop_stage` where the stage changes, or lasts for longer than it should."""

    def __init__(self, event_log: EventLog) -> None:
        self._event_log = event_log
        self._told: tuple[int, StopStage, Severity] | None = None

    def after_tick(self, stop: Stop | None, now_ns: int) -> None:
        """Once a tick, with the stop as it was known then; None where no CUT was latched."""
        if stop is None:
            self._told = None
            return
        severity = _severity(stop, now_ns)
        if self._told == (told := (stop.latched_ns, stop.stage, severity)):
            return
        self._told = told
        fields = {"stage": stop.stage.value, "sentence": stop.sentence()}
        self._event_log.emit(Event("stop_stage", severity, fields))


def _severity(stop: Stop, now_ns: int) -> Severity:
    """WARNING where frames should be on the bus, or controllers should have answered, by now."""
    if stop.stage is StopStage.NOT_OBEYED:
        return Severity.CRITICAL
    waits_long = now_ns - stop.latched_ns > GAP_NS
    if stop.overdue or (waits_long and stop.stage in (StopStage.LATCHED, StopStage.SENT)):
        return Severity.WARNING
    return Severity.INFO


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
        reconnector: reconnect.Reconnector,
        event_log: EventLog,
    ) -> None:
        self._gateway = gateway
        self._connection = connection
        self._reconnector = reconnector
        self._event_log = event_log
        self._reported_state = LinkState.UP
        # One in 2 s, and ten at once: a flickering link fills no log.
        self._changes = TokenBucket(2 * NS_PER_S, burst=10, now_ns=0)
        self._reported_drops = self._next_drops_ns = 0
        self._warnings: dict[str, Event] = {}

    def begin(self, now_ns: int) -> None:
        """Begin with a lost link: nothing is open yet."""
        self._gateway.apply(LoseLink(now_ns))
        lock = self._connection.instance_lock
        if lock is not None and lock.passed_by is not None:
            fields = {"channel": self._connection.settings.channel, "holder": lock.passed_by}
            self._event_log.emit(Event("lock_ignored", Severity.WARNING, fields))

    def before_tick(self, now_ns: int) -> None:
        """Hand on the oldest change that the reconnector found; RuntimeError where it has died."""
        self._reconnector.check()
        if not self._reconnector.changes:
            return
        match self._reconnector.changes.popleft():
            case reconnect.LinkOpened() as opened:
                self._take_opening(opened, now_ns)
            case reconnect.LinkLost(at_ns, why):
                self._gateway.apply(LoseLink(at_ns))
                self._event_log.emit(Event("link_lost", Severity.ERROR, {"reason": why}))
            case reconnect.Unavailable(why):
                self._event_log.emit(Event("link_unavailable", Severity.ERROR, {"reason": why}))
            case reconnect.CarrierChanged(at_ns, present):
                self._gateway.apply(ChangeCarrier(Carrier(present, at_ns)))

    def _take_opening(self, opened: reconnect.LinkOpened, now_ns: int) -> None:
        link = LinkStatus(opened.details.state or LinkState.UP, opened.at_ns)
        carrier = Carrier(opened.carrier, opened.at_ns)
        self._gateway.apply(OpenLink(link, carrier, now_ns))
        self._connection.start_sending()
        self._event_log.emit(Event("link_open", Severity.INFO))
        for warning in reconnect.interface_warnings(opened, self._connection.settings):
            if self._warnings.get(warning.name) != warning:
                self._warnings[warning.name] = warning
                self._event_log.emit(warning)

    def after_tick(self, now_ns: int) -> None:
        """Emit a changed link state and newly dropped frames, both at a bounded rate."""
        before, state = self._reported_state, self._gateway.link.state
        # A loss is emitted with its reason.
        if state not in (before, LinkState.LOST) and self._changes.taken(now_ns):
            self._reported_state = state
            changed = {"state": state.value, "before": before.value}
            severity = _SEVERITIES.get(state, Severity.ERROR)
            self._event_log.emit(Event("link_state", severity, changed))
        dropped = self._connection.dropped or 0
        if dropped != self._reported_drops and now_ns >= self._next_drops_ns:
            self._next_drops_ns = now_ns + 10 * NS_PER_S
            fields = {"frames": dropped - self._reported_drops}
            self._reported_drops = dropped
            self._event_log.emit(Event("frames_dropped", Severity.WARNING, fields))
