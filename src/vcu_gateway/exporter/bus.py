"""What the bus carried: frames, messages and the link."""

from vcu_gateway.core.link import LinkState
from vcu_gateway.exporter.family import NS_PER_S, Instant, Samples, by, counter, gauge, one, states

_USUAL_UNSENT = ("closed", "late", "unread", "ENOBUFS")
"""Exposed before the first of them, so that the first one counts as an increase."""


def _rejected(at: Instant) -> Samples:
    return by({reason.value: n for reason, n in dict(at.gateway.intake.rejected).items()})


def _unsent(at: Instant) -> Samples:
    return by(dict.fromkeys(_USUAL_UNSENT, 0) | at.daemon.door.counters.refused)


def _message_frames(at: Instant) -> Samples:
    found = {spec.name: at.snapshot.latest(spec.name) for spec in at.snapshot.messages}
    return by({name: latest.frame_count if latest else 0 for name, latest in found.items()})


def _marked_frames(at: Instant) -> Samples:
    found = {spec.name: at.snapshot.latest(spec.name) for spec in at.snapshot.messages}
    return by({name: latest.marked_count if latest else 0 for name, latest in found.items()})


def _ages(at: Instant) -> Samples:
    ages_ns = {spec.name: at.snapshot.age_ns(spec.name) for spec in at.snapshot.messages}
    return by({name: age / NS_PER_S for name, age in ages_ns.items() if age is not None})


def _stale(at: Instant) -> Samples:
    return by({spec.name: float(at.snapshot.stale(spec.name)) for spec in at.snapshot.messages})


FAMILIES = (
    counter(
        "frames_received",
        "Frames that the kernel handed over, own ones that came back included.",
        lambda at: one(at.daemon.door.counters.received),
    ),
    counter("frames_rejected", "Received frames not decoded, by reason.", _rejected, "reason"),
    counter(
        "frames_out_of_order",
        "Received frames older than the one of their kind before them; judged, not kept.",
        lambda at: one(at.gateway.intake.store.out_of_order),
    ),
    counter(
        "frames_unjudged",
        "Received frames of which a late tick found more than it could judge.",
        lambda at: one(at.gateway.intake.store.unjudged),
    ),
    counter(
        "frames_dropped",
        "Frames dropped by the kernel's receive buffer; absent where that cannot be known.",
        lambda at: one(at.daemon.door.dropped),
    ),
    counter(
        "receiver_bugs",
        "Exceptions of the receiving code; each cost one frame.",
        lambda at: one(at.daemon.door.counters.receiver_bugs),
    ),
    counter(
        "frames_sent",
        "Command frames that the kernel took.",
        lambda at: one(at.daemon.door.counters.sent),
    ),
    counter("frames_unsent", "Command frames not sent, by reason.", _unsent, "reason"),
    counter(
        "frames_confirmed",
        "Own command frames that came back because they had left.",
        lambda at: by(at.gateway.intake.confirmed),
        "controller",
    ),
    counter(
        "frames_foreign",
        "Command frames of another sender.",
        lambda at: by(at.gateway.intake.foreign_commands),
        "controller",
    ),
    counter(
        "frames_blocked",
        "Command frames that the gate replaced, by the rule that they broke;"
        " absent before the first.",
        lambda at: by(at.gateway.output.gate.blocked),
        "rule",
    ),
    counter("message_frames", "Frames taken of each message.", _message_frames, "message"),
    counter(
        "message_marked_frames",
        "Frames of each message with a signal out of range or saturated.",
        _marked_frames,
        "message",
    ),
    gauge(
        "message_age_seconds",
        "Time since the kernel's arrival stamp of the latest frame; absent before the first.",
        _ages,
        "message",
    ),
    gauge(
        "message_stale",
        "1 where the message is too old or never came, else 0.",
        _stale,
        "message",
    ),
    gauge(
        "link_state",
        "1 for the state that the bus interface is in, 0 for the others.",
        lambda at: states(LinkState, [at.gateway.link.state]),
        "state",
    ),
    gauge(
        "link_state_seconds",
        "How long the bus interface has been in its state.",
        lambda at: one(at.since_s(at.gateway.link.since_ns)),
    ),
)
"""Everything that tells of the bus."""
