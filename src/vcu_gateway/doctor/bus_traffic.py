"""Is anybody talking? One second of listening on the bus, without a sound."""

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
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome
from vcu_gateway.doctor.procfs import Unreadable, refused

SUBJECT = CheckSubject("bus")
# Room for two frames of the slowest message, 500 ms apart.
_LISTEN_S = 1.2
_MS_PER_S = 1000
_TOO_FEW, _TOO_MANY = 0.5, 1.5
_EFF_FLAG, _NO_DATA = 0x8000_0000, 0x6000_0000
_FRAME_BYTES, _MOST_FRAMES = 16, 20_000
_identifier = struct.Struct("=I")


class ObservedTraffic(NamedTuple):
    """What was on the bus.

    Attributes:
        local: identifiers (29 bits) of frames that a process of this machine sent, counted.
        remote: those of all others.
        duration_s: how long it was listened to.
    """

    local: Counter[int]
    remote: Counter[int]
    duration_s: float

    def count(self, message: MessageSpec, aliases: tuple[int, ...] = ()) -> int:
        """Frames of a message at any priority, whoever sent them."""
        keys = {j1939.match_key(one) for one in (message.can_id, *aliases)}
        both = self.local + self.remote
        return sum(count for one, count in both.items() if j1939.match_key(one) in keys)


class TrafficFacts(NamedTuple):
    """What was heard, and what the protocol lets expect.

    Attributes:
        required: messages without which nothing moves.
        gateway_runs: a gateway on this machine was found otherwise.
    """

    channel: str
    heard: ObservedTraffic | Unreadable
    protocol: ProtocolSpec
    required: tuple[str, ...]
    gateway_runs: bool


def listen(channel: str, duration_s: float = _LISTEN_S) -> ObservedTraffic | Unreadable:
    """All data frames of so long; nothing is sent, and nobody's frames are lost by it."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((channel,))
            return _gathered(bus, duration_s)
    except AttributeError:
        return Unreadable("this Python was built without CAN")
    except OSError as error:
        return refused(f"cannot listen on {channel}", error)


def _gathered(bus: socket.socket, duration_s: float) -> ObservedTraffic:
    heard = ObservedTraffic(Counter(), Counter(), duration_s)
    end_s = time.monotonic() + duration_s
    for _ in range(_MOST_FRAMES):
        left_s = end_s - time.monotonic()
        if left_s <= 0 or not select.select([bus], [], [], left_s)[0]:
            return heard
        raw, _, flags, _ = bus.recvmsg(_FRAME_BYTES)
        can_id = _identifier.unpack_from(raw)[0]
        if can_id & _EFF_FLAG and not can_id & _NO_DATA:
            sent_here = flags & socket.MSG_DONTROUTE
            (heard.local if sent_here else heard.remote)[can_id & j1939.ID_MASK] += 1
    return heard._replace(duration_s=duration_s - max(0.0, end_s - time.monotonic()))


def judge(facts: TrafficFacts) -> Iterator[CheckResult]:
    """What to say of it."""
    heard = facts.heard
    if isinstance(heard, Unreadable):
        yield SUBJECT.unknown("listen", heard.reason)
    elif not heard.local and not heard.remote:
        what = f"{facts.channel}: nobody said anything for {heard.duration_s:g} s"
        yield SUBJECT.wrong(
            "silent", what, "is the vehicle on? check bit rate, wiring, termination"
        )
    else:
        yield from SUBJECT.summed(facts.channel, _checks(facts, heard))


def _checks(facts: TrafficFacts, heard: ObservedTraffic) -> Iterator[Outcome | None]:
    for message in facts.protocol.received_by(OWN_NODE):
        yield _message(facts, heard, message)
    for message in facts.protocol.sent_by(OWN_NODE):
        yield _command(facts, heard, message)


def _message(facts: TrafficFacts, heard: ObservedTraffic, message: MessageSpec) -> Outcome | None:
    aliases = facts.protocol.aliases.items()
    count = heard.count(message, tuple(one for one, name in aliases if name == message.name))
    is_required = message.name in facts.required
    if count == 0:
        return _missing(facts, heard, message, is_required)
    rate_hz = count / heard.duration_s
    period_ms = message.period_ms
    expected = heard.duration_s * _MS_PER_S / period_ms if period_ms else 0.0
    if period_ms is None or count >= _TOO_FEW * expected:
        return f"{message.name} {rate_hz:.0f}/s"
    what = f"{message.name} came {rate_hz:.1f} times a second, not {_MS_PER_S / period_ms:.0f}"
    return SUBJECT.warning("slow", what, f"look at {message.sender}")


def _missing(
    facts: TrafficFacts, heard: ObservedTraffic, message: MessageSpec, is_required: bool
) -> Outcome | None:
    if message.period_ms is None and not is_required:
        return None
    what = f"{message.name} was not heard"
    if not is_required:
        return SUBJECT.warning("missing", what, f"look at {message.sender}")
    commanded = any(heard.count(one) for one in facts.protocol.sent_by(OWN_NODE))
    if not commanded and message.sender.startswith("PCU"):
        return f"no {message.name} (it answers commands, and nobody sends any)"
    return SUBJECT.wrong(
        "missing", f"{what}; without it nothing moves", f"look at {message.sender}"
    )


def _command(facts: TrafficFacts, heard: ObservedTraffic, message: MessageSpec) -> Outcome | None:
    groups = (
        j1939.group_key(message.can_id),
        j1939.group_key_to(message.can_id, j1939.GLOBAL_ADDRESS),
    )
    remote, local = (
        Counter({one: n for one, n in side.items() if j1939.group_key(one) in groups})
        for side in (heard.remote, heard.local)
    )
    return _senders(facts, heard, message, remote, local)


def _senders(
    facts: TrafficFacts,
    heard: ObservedTraffic,
    message: MessageSpec,
    remote: Counter[int],
    local: Counter[int],
) -> Outcome | None:
    """What commands of this kind, whatever sender they name, say; by identifier."""
    if remote:
        rate_hz = remote.total() / heard.duration_s
        names = ", ".join(f"{one:08X}" for one in sorted(remote))
        what = f"another node on the bus sends {message.name}, {rate_hz:.0f}/s ({names})"
        return SUBJECT.wrong("other_sender", what, "find it and switch it off: two would fight")
    if not local:
        return None
    expected = heard.duration_s * _MS_PER_S / (message.period_ms or _MS_PER_S)
    own = j1939.match_key(message.can_id)
    strange = any(j1939.match_key(one) != own for one in local)
    if not facts.gateway_runs or strange or local.total() > _TOO_MANY * expected:
        what = f"a process of this machine sends {message.name}, and it is not the gateway alone"
        return SUBJECT.wrong("other_sender", what, "find it (sudo ss -p -f can) and end it")
    return f"{message.name} sent"
