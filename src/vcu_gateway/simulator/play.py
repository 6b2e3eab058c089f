"""The simulated vehicle on a bus: the only part of it that knows python-can and the clock."""

import errno
import os
import select
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from vcu_gateway.core import j1939
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.python_can import can
from vcu_gateway.simulator.nodes import NodeFrame, Nodes
from vcu_gateway.units import NS_PER_S

# The longest wait, so that stopping never takes longer.
_LONGEST_WAIT_NS = 50_000_000
# Trouble is over when none has come for this long; a flickering queue is reported once.
_TROUBLE_OVER_NS = 1_000_000_000

# The frame is lost and the bus may come back; any other error means that it is gone.
_PASSING_ERRNOS = {errno.ENOBUFS, errno.ENETDOWN, errno.EAGAIN}
_FULL_BUFFER_TEXT = "Transmit buffer full"  # python-can raises this one without a number


@dataclass(slots=True)
class Played:
    """Counts of one run on the bus.

    Attributes:
        sent: frames by message; received: commands by message.
        lost: frames that the bus did not take, by reason.
    """

    sent: Counter[str] = field(default_factory=Counter)
    received: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    duration_s: float = 0.0


def open_bus(interface: str, channel: str, listen_to: Iterable[int]) -> can.BusABC:
    """Open a bus that wakes us for these extended identifiers only, whatever their priority.

    UnavailableError where there is no such bus.
    """
    filters: can.typechecking.CanFilters = [
        {"can_id": j1939.match_key(can_id), "can_mask": j1939.MATCH_MASK, "extended": True}
        for can_id in listen_to
    ]
    # Error frames pass the kernel's identifier filters, so they are switched off apart.
    options: dict[str, Any] = {"ignore_rx_error_frames": True} if interface == "socketcan" else {}
    try:
        return can.Bus(channel, interface, ignore_config=True, can_filters=filters, **options)
    except (can.CanError, NotImplementedError, OSError, ValueError) as error:
        raise _unavailable(interface, channel, error) from error


def play(
    bus: can.BusABC,
    nodes: Nodes,
    *,
    stop: threading.Event,
    duration_s: float | None = None,
    log: can.Listener | None = None,
    note: Callable[[str], None] = lambda _: None,
) -> Played:
    """Send what is due and hand commands in, until `stop` is set or duration_s is over.

    The nodes' time is the monotonic clock. A frame that the bus does not take is counted and
    forgotten; `note` is called when that begins and when it is over. `log` is given every frame
    that was sent or received. UnavailableError where
    the bus has gone away.
    """
    player = _Player(bus, nodes, log, note, _descriptor(bus))
    begin_ns = time.monotonic_ns()
    end_ns = None if duration_s is None else begin_ns + int(duration_s * NS_PER_S)
    now_ns = begin_ns
    while not stop.is_set() and (end_ns is None or now_ns < end_ns):
        player.send_due(now_ns)
        until_ns = min(nodes.next_due_ns(), now_ns + _LONGEST_WAIT_NS)
        player.receive_until(until_ns if end_ns is None else min(until_ns, end_ns))
        now_ns = time.monotonic_ns()
    player.played.duration_s = (now_ns - begin_ns) / NS_PER_S
    return player.played


@dataclass(slots=True)
class _Player:
    _bus: can.BusABC
    _nodes: Nodes
    _log: can.Listener | None
    _note: Callable[[str], None]
    _descriptor: int | None
    _trouble_at_ns: int | None = None
    played: Played = field(default_factory=Played)

    def send_due(self, now_ns: int) -> None:
        for frame in self._nodes.due(now_ns):
            message = can.Message(
                arbitration_id=frame.can_id, data=frame.data, timestamp=time.time(), is_rx=False
            )
            try:
                # Without a time-out: a full queue must lose the frame, not hold up the next.
                self._bus.send(message)
            except (can.CanError, OSError) as error:
                self.played.lost[self._trouble(error)] += 1
            else:
                self._sent(frame, message, now_ns)

    def receive_until(self, until_ns: int) -> None:
        """Wait for one frame until then, and take it in."""
        try:
            message = self._wait((until_ns - time.monotonic_ns()) / NS_PER_S)
        except (can.CanError, OSError) as error:
            self._trouble(error)
            return
        if message is None or message.is_error_frame or message.is_remote_frame:
            return
        if not message.is_extended_id:
            return
        name = self._nodes.receive(message.arbitration_id, message.data, time.monotonic_ns())
        if name is not None:
            self.played.received[name] += 1
            if self._log is not None:
                message.is_rx = True  # on a vcan python-can takes local frames for our own
                self._log.on_message_received(message)

    def _wait(self, timeout_s: float) -> can.Message | None:
        """One frame, or None in time.

        python-can counts its time-outs on the wall clock, and sleeps for an hour when that is
        set back an hour; so the waiting is done here wherever there is a descriptor.
        """
        timeout_s = max(0.0, timeout_s)
        if self._descriptor is None:
            return self._bus.recv(timeout_s)
        readable, _, _ = select.select([self._descriptor], [], [], timeout_s)
        return self._bus.recv(0) if readable else None

    def _sent(self, frame: NodeFrame, message: can.Message, now_ns: int) -> None:
        self.played.sent[frame.message] += 1
        if self._log is not None:
            self._log.on_message_received(message)
        trouble_at_ns = self._trouble_at_ns
        if trouble_at_ns is not None and now_ns - trouble_at_ns > _TROUBLE_OVER_NS:
            self._trouble_at_ns = None
            self._note("the bus takes frames again")

    def _trouble(self, error: Exception) -> str:
        """Report trouble of the bus; UnavailableError where the bus is gone."""
        number = _errno(error)
        if _FULL_BUFFER_TEXT in str(error):
            number = errno.ENOBUFS
        reason = str(error) if number is None else os.strerror(number)
        if number not in _PASSING_ERRNOS:
            raise UnavailableError(Problem(f"the bus has gone: {reason}")) from error
        if self._trouble_at_ns is None:
            self._note(f"the bus takes no frames: {reason}; trying on")
        self._trouble_at_ns = time.monotonic_ns()
        return reason


def _descriptor(bus: can.BusABC) -> int | None:
    """File descriptor to wait on; None on a bus without one."""
    try:
        descriptor = bus.fileno()
    except NotImplementedError:
        return None
    return descriptor if descriptor >= 0 else None


def _errno(error: BaseException) -> int | None:
    """The system's number behind an error of python-can, or None."""
    if isinstance(error, OSError):
        return error.errno
    if isinstance(error, can.CanError) and error.error_code is not None:
        return error.error_code
    return _errno(error.__cause__) if error.__cause__ is not None else None


def _unavailable(interface: str, channel: str, error: Exception) -> UnavailableError:
    what = f"cannot open {interface} {channel}: {error}"
    number = _errno(error)
    if number == errno.ENODEV and interface == "socketcan":
        remedy = f"`ip link add dev {channel} type vcan && ip link set {channel} up` makes one"
    elif number == errno.EAFNOSUPPORT:
        remedy = "this kernel has no CAN; --interface udp_multicast --channel 239.74.163.2 works"
    else:
        remedy = ""
    return UnavailableError(Problem(what, remedy=remedy))
