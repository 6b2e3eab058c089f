"""One run as a service: what the service manager and the next run are to know."""

import time
from pathlib import Path

from vcu_gateway.core.events import Event, Severity
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.schedule import Tick
from vcu_gateway.core.why import Explanation
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.restarts import CountedStart, RestartCounter
from vcu_gateway.daemon.safe_frames import SafeFrames
from vcu_gateway.daemon.systemd import SystemdNotifier
from vcu_gateway.daemon.watchdog import ReceiverWatchdog

_PINGS_IN_LIMIT = 4
_STATUS_EVERY_NS = 1_000_000_000


class ServiceReporter:
    """Tells from the ticking thread, after each tick; it never waits.

    `folder` is kept from one start to the next (systemd's RuntimeDirectory); None: nothing is.

    Attributes:
        start: this start; None where starts are not counted.
    """

    def __init__(self, manager: SystemdNotifier, folder: Path | None, daemon: TickLoop) -> None:
        self._manager = manager
        self._daemon = daemon
        self._reader = ReceiverWatchdog(daemon.door)
        self._starts = None if folder is None else RestartCounter(folder)
        self._safe_frames = None
        if folder is not None:
            channel, gateway = daemon.door.settings.channel, daemon.gateway
            self._safe_frames = SafeFrames(folder, channel, gateway, daemon.journal)
        self._ready = self._stopping = False
        self._ping_ns = self._status_ns = 0
        self._told: object = None
        self.start: CountedStart | None = None

    def begin(self) -> None:
        """Count this start; where too many came unexpected, nothing can be armed."""
        self.start = self._starts.begin() if self._starts is not None else None
        if self.start is not None and self.start.unexpected:
            self._daemon.gateway.restarted(self.start.unexpected)
            fields = {"in_this_drive": self.start.unexpected}
            self._daemon.journal.tell(Event("restarted_unexpectedly", Severity.WARNING, fields))

    def observe(self, tick: Tick, result: TickResult) -> None:
        """After each tick.

        Raises RuntimeError where the receiving thread is dead: the process is to end, and to
        be started again.
        """
        now_ns = time.monotonic_ns()
        if self._safe_frames is not None:
            self._safe_frames.observe(tick, result)
        self._reader.observe()
        if not self._ready:
            self._ready = True
            self._manager.ready()
        self._ping(now_ns)
        self._tell_status(now_ns)
        self._tell_stopping()

    def _ping(self, now_ns: int) -> None:
        limit_ns = self._manager.watchdog_ns
        if limit_ns is not None and now_ns >= self._ping_ns and self._reader.alive:
            self._ping_ns = now_ns + limit_ns // _PINGS_IN_LIMIT
            self._manager.alive()

    def _tell_status(self, now_ns: int) -> None:
        latest, lost = self._daemon.latest, self._daemon.door.lost
        if latest is None or now_ns < self._status_ns:
            return
        signature = latest.why.signature(), lost
        if signature != self._told:
            self._told, self._status_ns = signature, now_ns + _STATUS_EVERY_NS
            self._manager.status(_status(latest.why, lost))

    def _tell_stopping(self) -> None:
        if not self._stopping and self._daemon.gateway.requests.terminating:
            self._stopping = True
            self._manager.stopping()

    def end(self) -> None:
        """The run ended in order: the next one begins a new drive."""
        if self._safe_frames is not None:
            self._safe_frames.end()
        if self._starts is not None:
            self._starts.end()


def _status(why: Explanation, lost: str | None) -> str:
    return why.headline() if lost is None else f"{why.mode.value}; {lost}"
