"""systemd: readiness, watchdog and status over sd_notify; safe frames, kept for `safe_stop`."""

import contextlib
import socket
import time
from collections.abc import Mapping
from pathlib import Path

from vcu_gateway import files
from vcu_gateway.bus.connection import BusConnection
from vcu_gateway.core.calls import CountRestarts
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.restart_state import CountedStart, RestartCounter
from vcu_gateway.units import NS_PER_S, NS_PER_US

NAME = "safe-frames"


def forget(folder: Path) -> None:
    """Remove the file of an earlier process: its frames are not those of this one."""
    with contextlib.suppress(OSError):
        (folder / NAME).unlink(missing_ok=True)


class SafeFrames:
    """File of safe frames: the interface, then one frame a line as identifier#data.

    Written anew when they change: a latched power cut stays one, and a direction is kept. It is
    there from the first frames that were sent to the orderly end.
    """

    def __init__(self, folder: Path, loop: TickLoop) -> None:
        self._folder = folder
        self._loop = loop
        self._basis: object = None
        self._failure_reported = False

    def observe(self, result: TickResult) -> None:
        applied = tuple((one.motor_reverse, one.power_cut) for one in result.commands.values())
        basis = applied, self._loop.gateway.settings
        if result.frames and basis != self._basis and self._written():
            self._basis = basis

    def _written(self) -> bool:
        """Write the file; False, and one event, where that fails: the next tick tries again."""
        path, channel = self._folder / NAME, self._loop.connection.settings.channel
        frames = self._loop.gateway.safe_frames()
        lines = [channel, *(f"{one.can_id:08X}#{one.data.hex().upper()}" for one in frames)]
        try:
            files.replace(path, "\n".join(lines) + "\n")
        except OSError as error:
            if not self._failure_reported:
                fields = {"file": str(path), "reason": error.strerror}
                self._loop.event_log.emit(Event("safe_frames_unwritten", Severity.WARNING, fields))
            self._failure_reported = True
        else:
            self._failure_reported = False
        return not self._failure_reported


class SystemdNotifier:
    """sd_notify messages to the service manager; nothing is sent where there is none.

    Sending never waits and never raises: the ticks must not depend on the manager.

    Attributes:
        watchdog_ns: time without a ping after which the manager kills this process; None: never.
    """

    def __init__(self, environment: Mapping[str, str], own_pid: int) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket = _connected("\0" + address[1:] if address[:1] == "@" else address)
        self.watchdog_ns = _watchdog_ns(environment, own_pid)

    def status(self, sentence: str) -> None:
        self.notify("STATUS=" + " ".join(sentence.split())[:500])

    def notify(self, line: str) -> None:
        """Send one assignment, such as `READY=1`."""
        if self._socket is not None:
            with contextlib.suppress(OSError):  # gone or too busy: the next message may arrive
                self._socket.send(line.encode(), socket.MSG_DONTWAIT)


def _connected(address: str) -> socket.socket | None:
    if not address:
        return None
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
    try:
        manager.connect(address)
    except (OSError, ValueError):
        manager.close()
        return None
    return manager


def _watchdog_ns(environment: Mapping[str, str], own_pid: int) -> int | None:
    """The limit, where it is set for this very process."""
    if environment.get("WATCHDOG_PID", str(own_pid)) != str(own_pid):
        return None
    text = environment.get("WATCHDOG_USEC", "")
    return int(text) * NS_PER_US if text.isascii() and text.isdecimal() and int(text) else None


class ServiceReporter:
    """Reports to the service manager from the ticking thread, after each tick; it never waits.

    `folder` is kept from one start to the next (systemd's RuntimeDirectory); None: nothing is.

    Attributes:
        start: this start; None where starts are not counted.
    """

    def __init__(self, manager: SystemdNotifier, folder: Path | None, loop: TickLoop) -> None:
        self._manager = manager
        self._folder = folder
        self._loop = loop
        self._reader = ReceiverWatchdog(loop.connection)
        self._starts = None if folder is None else RestartCounter(folder)
        self._safe_frames = None if folder is None else SafeFrames(folder, loop)
        self._ready = self._stopping = False
        self._ping_ns = self._status_ns = 0
        self._last_status: object = None
        self.start: CountedStart | None = None

    def begin(self) -> None:
        """Count this start; after too many unexpected ones nothing can be armed."""
        self.start = self._starts.begin() if self._starts is not None else None
        if self.start is not None and self.start.unexpected:
            self._loop.gateway.apply(CountRestarts(self.start.unexpected))
            fields = {"in_this_drive": self.start.unexpected}
            self._loop.event_log.emit(Event("restarted_unexpectedly", Severity.WARNING, fields))

    def observe(self, result: TickResult) -> None:
        """After each tick.

        Raises RuntimeError where the bus is not read any more: the process is to end, and to
        be started again.
        """
        now_ns = time.monotonic_ns()
        if self._safe_frames is not None:
            self._safe_frames.observe(result)
        self._reader.observe()
        if not self._ready:
            self._ready = True
            self._manager.notify("READY=1")
        self._ping(now_ns)
        self._send_status(now_ns)
        if not self._stopping and self._loop.gateway.requests.terminating:
            self._stopping = True
            self._manager.notify("STOPPING=1")

    def _ping(self, now_ns: int) -> None:
        limit_ns = self._manager.watchdog_ns
        if limit_ns is not None and now_ns >= self._ping_ns and self._reader.alive:
            self._ping_ns = now_ns + limit_ns // 4  # more often than systemd asks for
            self._manager.notify("WATCHDOG=1")

    def _send_status(self, now_ns: int) -> None:
        latest, lost = self._loop.latest, self._loop.connection.lost
        if latest is None or now_ns < self._status_ns:
            return
        signature = latest.why_signature, lost
        if signature != self._last_status:
            self._last_status, self._status_ns = signature, now_ns + NS_PER_S
            why = latest.why
            self._manager.status(why.headline() if lost is None else f"{why.mode.value}; {lost}")

    def end(self) -> None:
        """Record an orderly end: the next start begins a new drive.

        The safe frames are kept where they did not leave: `safe_stop` tries again.
        """
        if self._folder is not None and not self._loop.gateway.gave_up:
            forget(self._folder)
        if self._starts is not None:
            self._starts.end()


# The bus is read before every tick. Ticks are counted and not time: a process that stood still did
# not read either.
_TICKS_IN_DOUBT = 10
_TICKS_TO_DEATH = 20


class ReceiverWatchdog:
    """Watchdog of receiving: an open bus must have been read to the end within 20 ticks."""

    def __init__(self, connection: BusConnection) -> None:
        self._connection = connection
        self._drains: int | None = None
        self._still_ticks = 0

    def observe(self) -> None:
        """Check after each tick; RuntimeError where the bus was not read for 20 of them."""
        before, self._drains = self._drains, self._connection.drains
        still = self._drains is not None and self._drains == before
        self._still_ticks = self._still_ticks + 1 if still else 0
        if self._still_ticks >= _TICKS_TO_DEATH:
            raise RuntimeError("the bus is open and not read any more; nothing is received")

    @property
    def alive(self) -> bool:
        """True where the bus was read within the last ten ticks."""
        return self._still_ticks < _TICKS_IN_DOUBT
