"""Traffic on the bus: a second of receiving, without sending."""

import select
import socket
import struct
import time
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.core import j1939
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec
from vcu_gateway.doctor.check_result import (
    CheckResult,
    CheckSubject,
    Outcome,
    Unreadable,
    unreadable,
)

SUBJECT = CheckSubject("bus")
# Room for two frames of the slowest message, 500 ms apart.
_LISTEN_S = 1.2
_MS_PER_S = 1000
_TOO_FEW, _TOO_MANY = 0.5, 1.5
_EFF_FLAG, _NO_DATA = 0x8000_0000, 0x6000_0000
_FRAME_BYTES, _MOST_FRAMES = 16, 20_000
_identifier = struct.Struct("=I")


class ObservedTraffic(NamedTuple):
    """Data frames received, counted by 29-bit identifier.

    Attributes:
        local: frames that a process of this machine sent.
        remote: frames of other nodes.
        duration_s: time of receiving.
    """

    local: Counter[int]
    remote: Counter[int]
    duration_s: float

    def count(self, message: MessageSpec, aliases: tuple[int, ...] = ()) -> int:
        """Frames of a message at any priority, of any sender."""
        keys = {j1939.match_key(one) for one in (message.can_id, *aliases)}
        both = self.local + self.remote
        return sum(count for one, count in both.items() if j1939.match_key(one) in keys)


class TrafficFacts(NamedTuple):
    """Observed and expected traffic.

    Attributes:
        required: messages without which nothing moves.
        gateway_runs: a gateway runs on this machine.
    """

    channel: str
    observed: ObservedTraffic | Unreadable
    protocol: ProtocolSpec
    required: tuple[str, ...]
    gateway_runs: bool


def listen(channel: str, duration_s: float = _LISTEN_S) -> ObservedTraffic | Unreadable:
    """Receive all data frames for `duration_s`; nothing is sent."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((channel,))
            return _received(bus, duration_s)
    except AttributeError:
        return Unreadable("this Python was built without CAN")
    except OSError as error:
        return unreadable(f"cannot listen on {channel}", error)


def _received(bus: socket.socket, duration_s: float) -> ObservedTraffic:
    observed = ObservedTraffic(Counter(), Counter(), duration_s)
    end_s = time.monotonic() + duration_s
    for _ in range(_MOST_FRAMES):
        left_s = end_s - time.monotonic()
        if left_s <= 0 or not select.select([bus], [], [], left_s)[0]:
            return observed
        raw, _, flags, _ = bus.recvmsg(_FRAME_BYTES)
        can_id = _identifier.unpack_from(raw)[0]
        if can_id & _EFF_FLAG and not can_id & _NO_DATA:
            sent_here = flags & socket.MSG_DONTROUTE
            (observed.local if sent_here else observed.remote)[can_id & j1939.ID_MASK] += 1
    return observed._replace(duration_s=duration_s - max(0.0, end_s - time.monotonic()))


def judge(facts: TrafficFacts) -> Iterator[CheckResult]:
    observed = facts.observed
    if isinstance(observed, Unreadable):
        yield SUBJECT.unknown("listen", observed.reason)
    elif not observed.local and not observed.remote:
        what = f"{facts.channel}: no frame was received for {observed.duration_s:g} s"
        remedy = "check that the vehicle is on, bit rate, wiring and termination"
        yield SUBJECT.wrong("silent", what, remedy)
    else:
        yield from SUBJECT.summarise(facts.channel, _checks(facts, observed))


def _checks(facts: TrafficFacts, observed: ObservedTraffic) -> Iterator[Outcome | None]:
    for message in facts.protocol.received_by(OWN_NODE):
        yield _message(facts, observed, message)
    for message in facts.protocol.sent_by(OWN_NODE):
        yield _command(facts, observed, message)


def _message(
    facts: TrafficFacts, observed: ObservedTraffic, message: MessageSpec
) -> Outcome | None:
    aliases = facts.protocol.aliases.items()
    count = observed.count(message, tuple(one for one, name in aliases if name == message.name))
    is_required = message.name in facts.required
    if count == 0:
        return _missing(facts, observed, message, is_required)
    rate_hz = count / observed.duration_s
    wanted_hz = _MS_PER_S / message.period_ms if message.period_ms else 0.0
    if rate_hz >= _TOO_FEW * wanted_hz:
        return f"{message.name} {rate_hz:.0f}/s"
    what = f"{message.name} was received {rate_hz:.1f} times a second instead of {wanted_hz:.0f}"
    return SUBJECT.warning("slow", what, f"check {message.sender}")


def _missing(
    facts: TrafficFacts, observed: ObservedTraffic, message: MessageSpec, is_required: bool
) -> Outcome | None:
    if message.period_ms is None and not is_required:
        return None
    what = f"{message.name} was not received"
    if not is_required:
        return SUBJECT.warning("missing", what, f"check {message.sender}")
    commanded = any(observed.count(one) for one in facts.protocol.sent_by(OWN_NODE))
    if not commanded and message.sender.startswith("PCU"):
        return f"no {message.name} (it answers commands, and none are sent)"
    return SUBJECT.wrong("missing", f"{what}; without it nothing moves", f"check {message.sender}")


def _command(
    facts: TrafficFacts, observed: ObservedTraffic, message: MessageSpec
) -> Outcome | None:
    """Senders of command frames of this kind, at any source address."""
    groups = (
        j1939.group_key(message.can_id),
        j1939.group_key_to(message.can_id, j1939.GLOBAL_ADDRESS),
    )
    remote, local = (
        Counter({one: n for one, n in side.items() if j1939.group_key(one) in groups})
        for side in (observed.remote, observed.local)
    )
    if remote:
        rate_hz = remote.total() / observed.duration_s
        names = ", ".join(f"{one:08X}" for one in sorted(remote))
        what = f"another node on the bus sends {message.name}, {rate_hz:.0f}/s ({names})"
        remedy = "find it and switch it off: two command sources conflict"
        return SUBJECT.wrong("other_sender", what, remedy)
    if not local:
        return None
    expected = observed.duration_s * _MS_PER_S / (message.period_ms or _MS_PER_S)
    own = j1939.match_key(message.can_id)
    foreign = any(j1939.match_key(one) != own for one in local)
    if not facts.gateway_runs or foreign or local.total() > _TOO_MANY * expected:
        what = f"a process of this machine sends {message.name}, and it is not only the gateway"
        return SUBJECT.wrong("other_sender", what, "find it (sudo ss -p -f can) and end it")
    return f"{message.name} sent"
