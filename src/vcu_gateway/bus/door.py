"""Opening, receiving, sending, closing: frames in and out, whatever the interface.

Received frames go to one callable on the Notifier's thread. A failed interface is told once
through `lost`; opening again is the daemon's decision.
"""

import dataclasses
import errno
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Literal

import can

from vcu_gateway.bus.clocks import read_clocks
from vcu_gateway.bus.socketcan import DrainingSocketcanBus
from vcu_gateway.core import j1939
from vcu_gateway.core.clock import arrival_ns
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.output import OutFrame
from vcu_gateway.errors import Problem, UnavailableError

Interface = Literal["socketcan", "virtual", "udp_multicast"]

# The reader wakes this often without frames, so that its life can be told from its counter.
_NOTIFIER_TIMEOUT_S = 0.1
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class BusSettings:
    """What the configuration says of the bus; see config/gateway.yaml."""

    interface: Interface
    channel: str
    kernel_filters: bool = True
    gather_s: float = 0.017
    receive_buffer_bytes: int | None = None


@dataclass(slots=True)
class BusCounters:
    """What passed the door; each counter is written by one thread.

    Attributes:
        refused: frames that could not be sent at once, by errno name.
        receiver_bugs: exceptions of our own receiving code; the frame is lost, the rest goes on.
    """

    received: int = 0
    sent: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    receiver_bugs: int = 0
    last_bug: str = ""


class Door:
    """One bus, open or lost.

    Attributes:
        lost: why the interface failed, as a sentence; None while it is open.
    """

    def __init__(
        self, settings: BusSettings, identifiers: Iterable[int], receive: Callable[[Frame], None]
    ) -> None:
        self._settings = settings
        self._filters = kernel_filters(identifiers) if settings.kernel_filters else None
        self._receive = receive
        self._lock = threading.Lock()
        self._bus: can.BusABC | None = None
        self._notifier: can.Notifier | None = None
        self._dropped_before = 0
        self._grid: tuple[int, int] | None = None
        self.counters = BusCounters()
        self.lost: str | None = "not opened yet"

    @property
    def is_open(self) -> bool:
        """True while nothing has failed since the last opening."""
        return self.lost is None

    @property
    def confirms_sending(self) -> bool:
        """True where our own frames come back once they have left."""
        return self._settings.interface != "udp_multicast"

    @property
    def dropped(self) -> int | None:
        """Frames dropped by the kernel's receive buffer; None where that cannot be known."""
        if self._settings.interface != "socketcan":
            return None
        now = self._bus.dropped if isinstance(self._bus, DrainingSocketcanBus) else 0
        return self._dropped_before + now

    def report(self) -> dict[str, Any]:
        """The counters as plain data."""
        return {**dataclasses.asdict(self.counters), "dropped": self.dropped, "lost": self.lost}

    def open(self) -> None:
        """Open the bus and start receiving.

        Raises UnavailableError, with what to do, where the interface is not there.
        """
        self.close()
        try:
            bus = self._open_bus()
        except (OSError, can.CanError, ImportError) as error:
            raise UnavailableError(_explain(error, self._settings)) from error
        self.lost = None
        self._bus = bus
        if self._grid is not None:
            self.align(*self._grid)
        self._notifier = can.Notifier(bus, [self._listener()], timeout=_NOTIFIER_TIMEOUT_S)

    def _open_bus(self) -> can.BusABC:
        settings = self._settings
        if settings.interface == "socketcan":
            return DrainingSocketcanBus(
                settings.channel,
                self._filters,
                settings.gather_s,
                settings.receive_buffer_bytes,
            )
        own: Any = {"receive_own_messages": True} if settings.interface == "virtual" else {}
        return can.Bus(
            interface=settings.interface,
            channel=settings.channel,
            can_filters=self._filters,
            **own,
        )

    def _listener(self) -> "_Listener":
        stamps_are_monotonic = self._settings.interface == "socketcan"
        return _Listener(self._receive, self.counters, self._on_lost, stamps_are_monotonic)

    def _on_lost(self, why: str) -> None:
        self.lost = why

    def align(self, origin_ns: int, period_ns: int) -> None:
        """Read all that waits shortly before every point of this grid: the ticks."""
        self._grid = (origin_ns, period_ns)
        if isinstance(self._bus, DrainingSocketcanBus):
            self._bus.align(origin_ns, period_ns)

    def send(self, frame: OutFrame) -> bool:
        """Send now or not at all; False, and counted, where the interface did not take it."""
        bus = self._bus
        if bus is None or self.lost is not None:
            return self.withhold("closed")
        try:
            if isinstance(bus, DrainingSocketcanBus):
                bus.send_now(frame.can_id, frame.data)
            else:
                bus.send(can.Message(arbitration_id=frame.can_id, data=frame.data))
        except (OSError, can.CanError) as error:
            return self.withhold(_errno_name(error))
        self.counters.sent += 1
        return True

    def withhold(self, why: str) -> bool:
        """Count a frame that is not sent, by its reason; False."""
        refused = self.counters.refused
        refused[why] = refused.get(why, 0) + 1
        return False

    def close(self) -> None:
        """Stop receiving, then close; nothing happens where it is closed already."""
        with self._lock:
            notifier, self._notifier = self._notifier, None
            bus, self._bus = self._bus, None
        self.lost = self.lost or "closed"
        if notifier is not None:
            notifier.stop()
        if isinstance(bus, DrainingSocketcanBus):
            self._dropped_before += bus.dropped
        if bus is not None:
            bus.shutdown()


class _Listener:
    """What the Notifier calls; it never raises."""

    def __init__(
        self,
        receive: Callable[[Frame], None],
        counters: BusCounters,
        lost: Callable[[str], None],
        stamps_are_monotonic: bool,
    ) -> None:
        self._receive = receive
        self._counters = counters
        self._lost = lost
        self._stamps_are_monotonic = stamps_are_monotonic
        self._clocks = read_clocks()

    def __call__(self, message: can.Message) -> None:
        """Hand one frame on."""
        self._counters.received += 1
        stamp_ns = int(message.timestamp * _NS_PER_S)
        self._receive(
            Frame(
                message.arbitration_id,
                message.data,
                stamp_ns if self._stamps_are_monotonic else self._to_monotonic(stamp_ns),
                message.is_extended_id,
                message.is_remote_frame,
                message.is_error_frame,
                not message.is_rx,
            )
        )

    def _to_monotonic(self, stamp_wall_ns: int) -> int:
        before, self._clocks = self._clocks, read_clocks()
        return arrival_ns(stamp_wall_ns, before, self._clocks)

    def on_error(self, error: Exception) -> None:
        """A failed interface is told on; a bug of ours costs its frame and is counted."""
        if isinstance(error, (OSError, can.CanError)):
            self._lost(str(error))
        else:
            self._counters.receiver_bugs += 1
            self._counters.last_bug = repr(error)

    def stop(self) -> None:
        """Nothing to flush."""


def kernel_filters(identifiers: Iterable[int]) -> list[Any]:
    """Filters for exactly these messages, at any priority, extended frames only."""
    keys = sorted({j1939.match_key(can_id) for can_id in identifiers})
    return [{"can_id": key, "can_mask": j1939.MATCH_MASK, "extended": True} for key in keys]


def _errno_name(error: Exception) -> str:
    """ENOBUFS and so on; python-can reports a full queue without a number."""
    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    return errno.errorcode.get(code, str(code)) if code else "ENOBUFS"


def _explain(error: Exception, settings: BusSettings) -> Problem:
    code = getattr(error, "errno", None)
    channel = settings.channel
    if settings.interface == "udp_multicast" and isinstance(error, ImportError):
        remedy = "install the extra: pip install 'vcu-gateway[multicast]'"
    elif settings.interface != "socketcan":
        remedy = "check bus.interface and bus.channel"
    elif code == errno.EAFNOSUPPORT:
        remedy = "this kernel has no CAN; try `vcu-gateway demo`, or a kernel with the can modules"
    elif code == errno.ENODEV:
        remedy = (
            f"for a bench: ip link add dev {channel} type vcan && ip link set {channel} up; "
            f"for an adapter: plug it in and ip link set {channel} up type can bitrate 250000"
        )
    else:
        remedy = f"look at: ip -details link show {channel}"
    return Problem(f"cannot open {settings.interface} {channel}: {error}", remedy=remedy)
