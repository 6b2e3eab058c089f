"""What a list shows of a recording, without reading it whole."""

import os
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.drive_format import layout, lock
from vcu_gateway.drive_format.segment_lines import Losses, SegmentBegin, last_second, read_begin
from vcu_gateway.errors import GatewayError
from vcu_gateway.recordings.folder import RecordingKind, RecordingPath, read_error
from vcu_gateway.units import NS_PER_S


class RecordingSummary(NamedTuple):
    """A drive or an incident in a few words.

    Attributes:
        begun_wall_ns: of what is left of it; None where that cannot be read.
        duration_s: None likewise.
        size_bytes: of its files; those of an incident are on the disk once, with its drive's.
        lost: what gaps tell; None where it cannot be read.
        reasons: why an incident is kept.
        kept: the recorder never removes it.
        is_written: a recorder is writing it.
        problems: what cannot be read of it.
    """

    kind: RecordingKind
    name: str
    channel: str | None
    begun_wall_ns: int | None
    duration_s: float | None
    segments: int
    size_bytes: int
    lost: Losses | None
    reasons: tuple[str, ...]
    kept: bool
    is_written: bool
    problems: tuple[str, ...]


def summarise(recording: RecordingPath) -> RecordingSummary:
    """The summary; NotPermittedError or MissingInputError where the folder cannot be read."""
    try:
        return _summarise(recording)
    except OSError as error:
        raise read_error(error, recording.path) from error


def _summarise(recording: RecordingPath) -> RecordingSummary:
    path, problems = recording.path, list[str]()
    described = _described(path / layout.DRIVE_FILE, problems)
    reasons = [_described(one, problems) for one in layout.incident_files(path)]
    segments = layout.segments(path)
    cores = [segment.core for segment in segments if segment.core]
    first, last = (read_begin(core) for core in (cores[0], cores[-1])) if cores else (None, None)
    return RecordingSummary(
        recording.kind,
        recording.name,
        _channel(described),
        first and first.wall_ns,
        _duration_s(first, cores),
        len(segments),
        _size_bytes(path),
        last and last.lost,
        tuple(
            layout.plain_reason(str(one.get("what") or one.get("reason"))) for one in reasons if one
        ),
        (path / layout.KEEP_FILE).exists(),
        lock.is_held(path),
        tuple(problems),
    )


def _described(path: Path, problems: list[str]) -> dict[str, Any]:
    try:
        return layout.read_description(path)
    except GatewayError as error:
        problems.append(str(error))
        return {}


def _channel(described: dict[str, Any]) -> str | None:
    channel = described.get("channel")
    return layout.plain_reason(channel) if isinstance(channel, str) else None


def _duration_s(first: SegmentBegin | None, cores: list[Path]) -> float | None:
    """From the begin of what is left to its last readable member."""
    end_s = last_second(cores[-1]) if cores else None
    if first is None or end_s is None:
        return None
    return max(0.0, end_s - first.wall_ns / NS_PER_S)


def _size_bytes(folder: Path) -> int:
    with os.scandir(folder) as entries:
        return sum(entry.stat(follow_symlinks=False).st_size for entry in entries)
