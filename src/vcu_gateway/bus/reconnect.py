"""Reconnector: opens the bus and opens it again, on its own thread, because both wait.

It hands the changes of the link to the ticking thread, in order, and decides nothing else. Faults
of the set-up of an interface that can be used all the same are warnings.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

from vcu_gateway.bus import interface, netlink
from vcu_gateway.bus.connection import BusConnection
from vcu_gateway.bus.interface import Interface, Interfaces
from vcu_gateway.bus.netlink import InterfaceDetails, LinkWatch
from vcu_gateway.bus.settings import BusSettings
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.errors import UnavailableError
from vcu_gateway.units import NS_PER_MS

# While the interface is in use rtnetlink tells of its changes; what it may not tell is seen then.
_LOOK_SELDOM_S = 1.0
_LOOK_OFTEN_S = 0.1
# However many links of the machine change.
_REST_S = 0.01
_READ_WITHIN_S = 0.2
_STEADY_NS = 5_000_000_000
_PAUSE_AT_MOST_NS = 800_000_000
_END_WITHIN_S = 1.0

# A bus without a network interface: always there.
_NO_INTERFACE = Interface(number=0, is_can=True, up=True, carrier=True, tx_queue_frames=0)
_TX_QUEUE_AT_MOST = 4


class LinkOpened(NamedTuple):
    """The bus was opened.

    Attributes:
        at_ns: shortly before; error frames since then count.
        receive_buffer_bytes: what the kernel gave; None where it has none.
    """

    at_ns: int
    interface: Interface
    details: InterfaceDetails
    receive_buffer_bytes: int | None

    @property
    def carrier(self) -> bool:
        """True where there was a carrier; rtnetlink's answer before the flags."""
        carrier = self.details.carrier
        return self.interface.carrier if carrier is None else carrier


class LinkLost(NamedTuple):
    """The interface in use cannot be used any more."""

    at_ns: int
    why: str


class Unavailable(NamedTuple):
    """The bus cannot be opened; once for each reason."""

    why: str


class CarrierChanged(NamedTuple):
    """The interface's carrier came or went.

    Attributes:
        at_ns: when it was seen to be gone, or last seen to be gone still.
    """

    at_ns: int
    present: bool


LinkChange = LinkOpened | LinkLost | Unavailable | CarrierChanged


class Reconnector:
    """Opens the connection when its interface is there, and again after every loss.

    Looks at the interface when rtnetlink or a reader reports a change, once a second in any case,
    and ten times a second while it cannot be used. One that was steady is opened at once; one
    that keeps failing is given pauses from `pause_ms`, doubling up to 0.8 s.

    Attributes:
        changes: link changes, for the ticking thread to take from the left.
        tried: set after the first look.
    """

    def __init__(
        self,
        connection: BusConnection,
        pause_ms: int,
        look: Callable[[], Interface | None] | None = None,
        name_of: Callable[[int], str | None] | None = None,
        details: Callable[[str], InterfaceDetails] = netlink.details,
    ) -> None:
        self._connection = connection
        self._interfaces = Interfaces()
        self._look = look or self._look_at_channel
        self._name_of = name_of or self._interfaces.name_of
        self._details = details
        self._pause_ns = self._first_pause_ns = pause_ms * NS_PER_MS
        self._next_ns = 0
        self._opened_ns = self._looked_ns = 0
        self._opened: Interface | None = None
        self._last_number: int | None = None
        self._reported_problem: str | None = None
        self._watch = LinkWatch()
        self._ended = False
        self._thread = threading.Thread(target=self._work, name="reconnector", daemon=True)
        self.changes: deque[LinkChange] = deque()
        self.tried = threading.Event()
        connection.on_lost = self._watch.wake

    def _look_at_channel(self) -> Interface | None:
        settings = self._connection.settings
        if settings.interface != "socketcan":
            return _NO_INTERFACE
        return self._interfaces.look(settings.channel)

    # The thread.

    def start(self) -> None:
        self._watch.open()
        lock = self._connection.instance_lock
        if lock is not None and (descriptor := lock.descriptor) is not None:
            self._watch.watch(descriptor)
        self._thread.start()

    def stop(self) -> None:
        """Close the connection and end; called when nothing is to be sent any more."""
        self._ended = True
        self._watch.wake()
        if self._thread.ident is not None:
            self._thread.join(_END_WITHIN_S)
        if not self._thread.is_alive():
            self._watch.close()

    def check(self) -> None:
        """Raise RuntimeError where the thread has died of a bug: the bus would stay closed."""
        if self._thread.ident is not None and not self._thread.is_alive() and not self._ended:
            raise RuntimeError("the reconnector has died; its exception is on stderr")

    def _work(self) -> None:
        while not self._ended:
            self.step(time.monotonic_ns())
            if (lock := self._connection.instance_lock) is not None:
                lock.answer()
            self.tried.set()
            time.sleep(_REST_S)
            self._watch.wait(self._look_within_s())
        self._connection.close()
        self._interfaces.close()

    def _look_within_s(self) -> float:
        opened = self._opened
        is_used = opened is not None and opened.carrier and self._watch.is_told
        return _LOOK_SELDOM_S if is_used else _LOOK_OFTEN_S

    # One look.

    def step(self, now_ns: int) -> None:
        """Look once; report a loss or a carrier, open where that is due."""
        found = self._look()
        if self._opened is not None:
            self._check(self._opened, found, now_ns)
        if self._opened is None:
            self._try_to_open(found, now_ns)
        self._looked_ns = now_ns

    def _check(self, opened: Interface, found: Interface | None, now_ns: int) -> None:
        channel = self._connection.settings.channel
        why = interface.left(opened, found, channel, self._name_of)
        if why is not None or not self._connection.is_open:
            self._give_up(why or self._connection.lost or "closed", now_ns)
        elif found is not None and found.carrier != opened.carrier:
            self._opened = found
            at_ns = self._looked_ns if found.carrier else now_ns
            self.changes.append(CarrierChanged(at_ns, found.carrier))

    def _give_up(self, why: str, now_ns: int) -> None:
        self._connection.mark_lost(why)
        self._connection.lost = why
        self._opened = None
        self.changes.append(LinkLost(now_ns, why))
        if now_ns - self._opened_ns >= _STEADY_NS:
            self._pause_ns, self._next_ns = self._first_pause_ns, now_ns
        if not self._ended:
            self._connection.wait_until_read(_READ_WITHIN_S)
        self._connection.close()

    def _try_to_open(self, found: Interface | None, now_ns: int) -> None:
        gone = found is None and self._last_number is not None
        renamed_to = self._name_of(self._last_number or 0) if gone else None
        if problem := interface.unfit(found, self._connection.settings, renamed_to):
            self._report_unavailable(str(problem))
        elif found is not None and now_ns >= self._next_ns:
            self._next_ns = now_ns + self._pause_ns
            self._pause_ns = min(2 * self._pause_ns, max(_PAUSE_AT_MOST_NS, self._first_pause_ns))
            self._open(found, now_ns)

    def _open(self, found: Interface, now_ns: int) -> None:
        try:
            self._connection.open()
        except UnavailableError as error:
            self._report_unavailable(str(error))
            return
        self._opened, self._last_number = found, found.number
        self._opened_ns, self._reported_problem = now_ns, None
        details = InterfaceDetails()
        if self._connection.settings.interface == "socketcan":
            details = self._details(self._connection.settings.channel)
        buffer_bytes = self._connection.receive_buffer_bytes
        self.changes.append(LinkOpened(now_ns, found, details, buffer_bytes))

    def _report_unavailable(self, why: str) -> None:
        self._connection.lost = why
        if why != self._reported_problem:
            self._reported_problem = why
            self.changes.append(Unavailable(why))


def interface_warnings(opened: LinkOpened, settings: BusSettings) -> Iterator[Event]:
    """Warnings about an interface that was opened, each with the command that fixes it."""
    details, link = opened.details, f"ip link set {settings.channel}"
    frames = opened.interface.tx_queue_frames
    if frames > _TX_QUEUE_AT_MOST and details.queue_is_used is not False:
        # Frames that wait there are stale when they leave.
        command = f"{link} txqueuelen {_TX_QUEUE_AT_MOST}"
        yield _warning("tx_queue_long", command, frames=frames)
    asked, given = settings.receive_buffer_bytes, opened.receive_buffer_bytes
    if asked is not None and given is not None and given < asked:
        command = f"sysctl -w net.core.rmem_max={asked}"
        yield _warning("receive_buffer_small", command, asked_bytes=asked, given_bytes=given)
    found, wanted = details.bit_rate_bit_s, settings.bit_rate_bit_s
    if None not in (found, wanted) and found != wanted:
        # Only an interface that is down takes a bit rate.
        command = f"{link} down && {link} up type can bitrate {wanted}"
        yield _warning("bit_rate_differs", command, wanted_bit_s=wanted, found_bit_s=found)
    if details.state is not None and details.driver_echoes is False:
        # The kernel sends our frames back then, unasked.
        reason = "the driver confirms nothing: only the controllers' answers tell that frames left"
        yield Event("echo_unproven", Severity.WARNING, {"reason": reason})


def _warning(name: str, command: str, **fields: object) -> Event:
    return Event(name, Severity.WARNING, {**fields, "command": command})
