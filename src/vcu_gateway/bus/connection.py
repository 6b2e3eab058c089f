"""Opening, receiving, sending, closing: frames in and out, whatever the interface.

Received frames go to one callable on the Notifier's thread, and right before a tick on the ticking
thread: never on both at once. A failed interface is told once
through `lost`; opening again is the keeper's decision, sending again the ticking thread's.
"""

import dataclasses
import errno
import threading
from collections.abc import Callable, Iterable
from typing import Any

from vcu_gateway.bus.counters import BusCounters
from vcu_gateway.bus.diagnostics import unopened
from vcu_gateway.bus.instance_lock import InstanceLock
from vcu_gateway.bus.receiver import FrameListener
from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.bus.socketcan import DrainingSocketcanBus
from vcu_gateway.core import j1939
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.errors import UnavailableError
from vcu_gateway.python_can import can

__all__ = ["BusConnection", "BusCounters", "BusSettings", "kernel_filters"]

# The reader wakes this often without frames, so that its life can be told from its counter.
_NOTIFIER_TIMEOUT_S = 0.1

# The interface is down or gone, whatever the next attempt would give.
_GONE = {"ENETDOWN", "ENODEV", "ENXIO"}


class _Opening:
    """One bus and its reader, from an opening to its close."""

    def __init__(self, bus: can.BusABC, listener: FrameListener) -> None:
        self.bus = bus
        self._listener = listener
        self._notifier = can.Notifier(bus, [listener], timeout=_NOTIFIER_TIMEOUT_S)

    def read_waiting(self, until_ns: int) -> bool:
        """Hand on what waits in a socket, on the calling thread; it never raises."""
        bus = self.bus
        if isinstance(bus, DrainingSocketcanBus) and bus.may_wait():
            try:
                return bus.read_waiting(until_ns, self._hand_on)
            except (OSError, can.CanError) as error:
                self._listener.on_error(error)
        return True

    def _hand_on(self, message: can.Message) -> None:
        try:
            self._listener(message)
        except Exception as error:  # noqa: BLE001 - as python-can's Notifier does
            self._listener.on_error(error)

    def close(self) -> None:
        """Stop the reader, then close; it takes as long as a wake-up of the reader."""
        self._notifier.stop()
        if isinstance(self.bus, DrainingSocketcanBus):
            self.bus.finish()
        self.bus.shutdown()


class BusConnection:
    """One bus, open or lost.

    Opening, closing and their waiting belong to one thread at a time; `read_waiting`, `send` and
    `admit` to the ticking thread; `lose` may come from any.

    Attributes:
        lost: why the interface cannot be used, as a sentence; None while it is open.
        on_lost: called on the thread that noticed, once for each opening.
    """

    def __init__(
        self,
        settings: BusSettings,
        identifiers: Iterable[int],
        receive: Callable[[Frame], None],
        groups: Iterable[int] = (),
    ) -> None:
        self.settings = settings
        self._filters = kernel_filters(identifiers, groups) if settings.kernel_filters else None
        self._receive = receive
        self._opening: _Opening | None = None
        self._admitted: can.BusABC | None = None
        self._sending = threading.Lock()
        self._grid: tuple[int, int] | None = None
        self._claim: InstanceLock | None = None
        self.counters = BusCounters()
        self.lost: str | None = "not opened yet"
        self.on_lost: Callable[[], None] = _nobody_asked

    @property
    def is_open(self) -> bool:
        """True while nothing has failed since the last opening."""
        return self.lost is None

    @property
    def dropped(self) -> int | None:
        """Frames that arrived and were never read; None where that cannot be known."""
        return self.counters.dropped if self.settings.interface == "socketcan" else None

    @property
    def receive_buffer_bytes(self) -> int | None:
        """What the kernel gave, in the measure of what is asked; None where it has none."""
        bus = self._opening and self._opening.bus
        return bus.receive_buffer_bytes if isinstance(bus, DrainingSocketcanBus) else None

    @property
    def reader_wakes(self) -> int | None:
        """Counts on while the reader lives; None where nothing is open or the bus cannot tell."""
        bus = self._opening and self._opening.bus
        return bus.wakes if self.is_open and isinstance(bus, DrainingSocketcanBus) else None

    def report(self) -> dict[str, Any]:
        """The counters as plain data."""
        return {**dataclasses.asdict(self.counters), "dropped": self.dropped, "lost": self.lost}

    def claim(self) -> None:
        """Be the only gateway on this interface of the machine, until `release`.

        Raises UnavailableError where another gateway is.
        """
        if self._claim is None and self.settings.interface == "socketcan":
            self._claim = InstanceLock(self.settings.channel)

    @property
    def lock_held_by(self) -> str | None:
        """Who has the interface's lock without a right to it; None where nobody is in the way."""
        return None if self._claim is None else self._claim.passed_by

    def answer_claims(self) -> None:
        """Let others ask who has the lock; called now and then."""
        if self._claim is not None:
            self._claim.answer()

    def release(self) -> None:
        """Let another gateway have the interface."""
        claim, self._claim = self._claim, None
        if claim is not None:
            claim.release()

    def open(self) -> None:
        """Open the bus and start receiving; nothing is sent before `admit`.

        Raises UnavailableError, with what to do, where the interface is not there.
        """
        self.close()
        try:
            bus = self._open_bus()
        except (OSError, can.CanError, ImportError) as error:
            raise UnavailableError(unopened(error, self.settings)) from error
        if self._grid is not None and isinstance(bus, DrainingSocketcanBus):
            bus.align(*self._grid)
        self.lost = None
        self._opening = _Opening(bus, self._listener(bus))

    def _open_bus(self) -> can.BusABC:
        settings = self.settings
        if settings.interface == "socketcan":
            return DrainingSocketcanBus(
                settings.channel,
                self._filters,
                settings.gather_s,
                settings.receive_buffer_bytes,
                self.counters,
            )
        if settings.interface == "udp_multicast":
            from vcu_gateway.bus.multicast import EchoingMulticastBus

            return EchoingMulticastBus(settings.channel, self._filters, self.counters)
        return can.Bus(
            interface=settings.interface,
            channel=settings.channel,
            can_filters=self._filters,
            receive_own_messages=True,
        )

    def _listener(self, bus: can.BusABC) -> FrameListener:
        def lost(why: str) -> None:
            if self._opening is None or self._opening.bus is bus:
                self.lose(why)  # the word of a reader that was closed does not count

        stamps_are_monotonic = self.settings.interface == "socketcan"
        return FrameListener(self._receive, self.counters, lost, stamps_are_monotonic)

    def align(self, origin_ns: int, period_ns: int) -> None:
        """Read all that waits shortly before every point of this grid: the ticks."""
        self._grid = (origin_ns, period_ns)
        if self._opening is not None and isinstance(self._opening.bus, DrainingSocketcanBus):
            self._opening.bus.align(origin_ns, period_ns)

    def read_waiting(self, until_ns: int) -> bool:
        """Take in what arrived until this time; on the ticking thread, right before a tick.

        Also what came before the interface was lost. Only where frames wait in a socket of ours
        (socketcan); elsewhere the reader has every frame as soon as it is there. False where the
        reader has something in its hands and could not be waited for: nothing was taken in.
        """
        opening = self._opening
        return opening is None or opening.read_waiting(until_ns)

    def admit(self) -> None:
        """Send on what is open from now on."""
        opening = self._opening
        self._admitted = opening.bus if opening is not None and self.is_open else None

    def lose(self, why: str) -> None:
        """The interface cannot be used any more: nothing is sent on it again."""
        if self.lost is None:
            self.lost = why
            self.on_lost()

    def send(self, frame: OutFrame) -> bool:
        """Send now or not at all; False, and counted, where the interface did not take it.

        It never waits, not for another thread either: a door that is being closed is closed.
        """
        if self.lost is not None or not self._sending.acquire(blocking=False):
            return self.withhold("closed")
        try:
            bus = self._admitted
            if bus is None:
                return self.withhold("closed")
            _hand_over(bus, frame)
        except (OSError, can.CanError) as error:
            return self._not_sent(error)
        finally:
            self._sending.release()
        self.counters.sent += 1
        return True

    def _not_sent(self, error: Exception) -> bool:
        name = _errno_name(error)
        if name in _GONE:
            # The kernel tells it once, to whoever asks first: the reader may never hear of it.
            self.lose(f"Failed to send: {error}")
        return self.withhold(name)

    def withhold(self, why: str) -> bool:
        """Count a frame that is not sent, by its reason; False."""
        refused = self.counters.refused
        refused[why] = refused.get(why, 0) + 1
        return False

    def close(self, why: str = "closed") -> None:
        """Stop receiving, then close; nothing happens where it is closed already."""
        self.lost = self.lost or why
        with self._sending:
            self._admitted = None
        opening, self._opening = self._opening, None
        if opening is not None:
            opening.close()


def _hand_over(bus: can.BusABC, frame: OutFrame) -> None:
    if isinstance(bus, DrainingSocketcanBus):
        bus.send_now(frame.can_id, frame.data)
    else:
        bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data))


def _nobody_asked() -> None:
    """Nobody wants to know of a loss."""


def kernel_filters(identifiers: Iterable[int], groups: Iterable[int] = ()) -> list[Any]:
    """Filters for exactly these messages, at any priority, extended frames only.

    `groups` are `j1939.group_key`s that pass whoever sent them.
    """
    whole = set(groups)
    keys = {j1939.match_key(can_id) for can_id in identifiers}
    keys = {key for key in keys if j1939.group_key(key) not in whole}
    masked = [(key, j1939.MATCH_MASK) for key in keys] + [(key, j1939.GROUP_MASK) for key in whole]
    return [{"can_id": key, "can_mask": mask, "extended": True} for key, mask in sorted(masked)]


def _errno_name(error: Exception) -> str:
    """ENOBUFS and so on; python-can reports a full queue without a number.

    EAGAIN is a full queue too: our own share of it.
    """
    code: int = getattr(error, "errno", None) or getattr(error, "error_code", None) or errno.ENOBUFS
    return errno.errorcode.get(errno.ENOBUFS if code == errno.EAGAIN else code, str(code))
