"""Recordings on a disk: drives and incidents by name, and what a list shows of each."""

import errno
import os
import stat
from pathlib import Path
from typing import Any, Literal, NamedTuple

from vcu_gateway.errors import (
    GatewayError,
    MissingInputError,
    NotPermittedError,
    Problem,
    did_you_mean,
)
from vcu_gateway.recording import layout
from vcu_gateway.recording.layout import DEFAULT_FOLDER
from vcu_gateway.recording.segment import Losses, SegmentBegin, last_second, read_begin
from vcu_gateway.units import NS_PER_S

RecordingKind = Literal["drive", "incident"]

_PARENTS: tuple[tuple[RecordingKind, str], ...] = (
    ("drive", layout.DRIVES),
    ("incident", layout.INCIDENTS),
)


class RecordingPath(NamedTuple):
    """A drive's or an incident's folder."""

    kind: RecordingKind
    path: Path

    @property
    def name(self) -> str:
        return self.path.name


class RecordingFolder:
    """Folder with `drives` and `incidents` in it, as the recorder writes it.

    Attributes:
        path: where it is.
    """

    def __init__(self, path: Path) -> None:
        """MissingInputError where it is none, NotPermittedError where it may not be read."""
        self.path = path
        try:
            inside = os.listdir(path)
        except OSError as error:
            raise read_error(error, path) from error
        if not {layout.DRIVES, layout.INCIDENTS} & set(inside):
            what = "has no recordings in it"
            remedy = "is the recorder on: systemctl status vcu-gateway-recorder.socket"
            raise MissingInputError(Problem(what, str(path), remedy))

    def recordings(self) -> list[RecordingPath]:
        """All drives, then all incidents, the oldest first; links are none."""
        try:
            return [
                RecordingPath(kind, found)
                for kind, parent in _PARENTS
                for found in layout.recorded_folders(self.path / parent)
                if not found.is_symlink()
            ]
        except OSError as error:
            raise read_error(error, self.path) from error

    def named(self, name: str) -> RecordingPath:
        """The one of this name; MissingInputError where there is none."""
        known = {found.name: found for found in self.recordings()}
        if name in known:
            return known[name]
        remedy = did_you_mean(name, known) or "vcu-gateway recordings list"
        raise MissingInputError(Problem(f'no drive or incident "{name}"', str(self.path), remedy))


def read_error(error: OSError, path: Path) -> GatewayError:
    if isinstance(error, PermissionError):
        remedy = "sudo usermod -aG vcu-gateway-recorder $USER and log in again, or use sudo"
        return NotPermittedError(Problem("may not be read by this user", str(path), remedy))
    what = f"cannot be read: {error.strerror or error}"
    return MissingInputError(Problem(what, str(path), "recordings lie elsewhere? --folder"))


def write_error(error: OSError, path: Path) -> GatewayError:
    if isinstance(error, PermissionError):
        what, remedy = "may not be changed by this user", "use sudo"
        return NotPermittedError(Problem(what, str(path), remedy))
    return MissingInputError(Problem(f"cannot be changed: {error.strerror or error}", str(path)))


_NOT_THERE = (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.EINVAL)


def recording_path(name: str) -> Path:
    """The path of this name; below DEFAULT_FOLDER where nothing of this name lies here.

    NotPermittedError where this user may not look.
    """
    path = Path(name)
    if "/" in name or "." in name or _is_there(path):  # the recorder's names have neither
        return path
    for part in (layout.DRIVES, layout.INCIDENTS):
        kept = DEFAULT_FOLDER / part / name
        if _is_there(kept):
            return kept
    return path


def recorded_path(name: str) -> Path | None:
    """The drive, incident or segment of this name; None where it is something else, such as a log.

    NotPermittedError where this user may not look.
    """
    path = recording_path(name)
    if _is_there(path, folder=True):
        return path
    beside = path.parent / layout.DRIVE_FILE
    if layout.segment_number(path.name) is not None and _is_there(beside):
        return path
    return None


def _is_there(path: Path, folder: bool = False) -> bool:
    try:
        found = path.stat()
    except ValueError:  # a null character
        return False
    except OSError as error:
        if error.errno in _NOT_THERE:
            return False
        raise read_error(error, path) from error
    return not folder or stat.S_ISDIR(found.st_mode)


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
        layout.is_held(path),
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
