"""Metrics of the recorder, from the file in which it tells its state."""

from collections.abc import Callable
from operator import attrgetter

from vcu_gateway.exporter.family import Family, GatewayAnswers, Samples, counter, gauge, one, states
from vcu_gateway.recording.recorder_status import STALE_S, RecorderStatus

_DISK_STATES = ("ok", "full", "failing", "stalled")


def _told(reading: GatewayAnswers) -> bool:
    return reading.recorder_age_s is not None and reading.recorder_age_s <= STALE_S


def _of_recorder(read: Callable[[RecorderStatus], Samples]) -> Callable[[GatewayAnswers], Samples]:
    """Samples of the state; none where the recorder does not tell it."""

    def samples(reading: GatewayAnswers) -> Samples:
        return read(reading.recorder) if reading.recorder is not None and _told(reading) else {}

    return samples


def _count(name: str, text: str, field: str = "") -> Family:
    """Counter of a field of the totals; of the same name, where none is given."""
    value = attrgetter(field or name)
    return counter(f"recorder_{name}", text, _of_recorder(lambda status: one(value(status.totals))))


def _gauge(name: str, text: str, field: str = "") -> Family:
    """Gauge of a field of the status, likewise."""
    value = attrgetter(field or name)
    return gauge(f"recorder_{name}", text, _of_recorder(lambda status: one(value(status))))


FAMILIES: tuple[Family, ...] = (
    gauge(
        "recorder_up",
        "1 where the recorder told its state in the last 10 s, else 0; absent where none has run.",
        lambda reading: {} if reading.recorder is None else one(float(_told(reading))),
    ),
    gauge(
        "recorder_connections",
        "Gateways that hand over to the recorder.",
        _of_recorder(lambda status: one(len(status.connections))),
    ),
    gauge(
        "recorder_disk_state",
        "1 for the state of the recordings' disk, 0 for the others.",
        _of_recorder(lambda status: states(_DISK_STATES, [status.disk])),
        "state",
    ),
    _count("written_bytes", "Bytes of recordings written.", "bytes"),
    _count("frames", "Frames recorded."),
    _count("ticks", "Ticks recorded."),
    _count("gaps", "Gaps told in the recordings."),
    _count("frames_lost", "Frames in gaps: not recorded."),
    _count("ticks_lost", "Ticks in gaps: not recorded."),
    _count("syncs", "Calls of fdatasync."),
    _count("sync_failures", "Calls of fdatasync that failed."),
    _count("signing_failures", "Signatures of recordings that could not be made."),
    _gauge(
        "sync_seconds",
        "Longest fdatasync of the last minute; absent before the first.",
        "longest_sync_s",
    ),
    _gauge("waiting_bytes", "Bytes in the recorder's memory that wait for the disk."),
    _gauge("waiting_limit_bytes", "Bytes that may wait; what comes then is a gap.", "memory_bytes"),
    _gauge("drives_bytes", "Bytes of all drives."),
    _gauge(
        "drives_limit_bytes",
        "Bytes that drives may have; the oldest segments go above it.",
        "max_bytes",
    ),
    _gauge("incidents_bytes", "Bytes of incidents that no drive has any more."),
    _gauge("incidents", "Incidents on the disk."),
    _gauge(
        "free_bytes", "Free bytes of the recordings' file system; absent before they are known."
    ),
    _count("removed_segments", "Segments removed for want of room."),
    _count("removed_incidents", "Incidents removed for want of room."),
)
