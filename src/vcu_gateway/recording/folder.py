"""Recordings on a disk: drives and incidents by name, and what a list shows of each."""

import contextlib
import errno
import os
import stat
from collections.abc import Iterator, Mapping
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
from vcu_gateway.recording.segment import Losses, last_second, read_begin
from vcu_gateway.units import NS_PER_S

RecordingKind = Literal["drive", "incident"]

_PARENTS: Mapping[RecordingKind, str] = {"drive": layout.DRIVES, "incident": layout.INCIDENTS}


class RecordingPath(NamedTuple):
    """A drive's or an incident's folder."""

    kind: RecordingKind
    path: Path

    @property
    def name(self) -> str:
        return self.path.name


class RecordingFolder:
    """Folder with `drives` and `incidents` in it, as the recorder writes it."""

    def __init__(self, path: Path) -> None:
        """MissingInputError where it is none, NotPermittedError where it may not be read."""
        self.path = path
        with reading(path):
            inside = os.listdir(path)
        if not {layout.DRIVES, layout.INCIDENTS} & set(inside):
            what = "has no recordings in it"
            remedy = "is the recorder on: systemctl status vcu-gateway-recorder.socket"
            raise MissingInputError(Problem(what, str(path), remedy))

    def recordings(self) -> list[RecordingPath]:
        """All drives, then all incidents, the oldest first; links are none."""
        with reading(self.path):
            return [
                RecordingPath(kind, found)
                for kind, parent in _PARENTS.items()
                for found in layout.recorded_folders(self.path / parent)
                if not found.is_symlink()
            ]

    def named(self, name: str) -> RecordingPath:
        """The one of this name; MissingInputError where there is none."""
        known = {found.name: found for found in self.recordings()}
        if name in known:
            return known[name]
        remedy = did_you_mean(name, known) or "vcu-gateway recordings list"
        raise MissingInputError(Problem(f'no drive or incident "{name}"', str(self.path), remedy))


@contextlib.contextmanager
def _disk(path: Path, done: str, if_refused: str, remedy: str = "") -> Iterator[None]:
    """An OSError within becomes a NotPermittedError or a MissingInputError of this path."""
    try:
        yield
    except PermissionError as error:
        problem = Problem(f"may not be {done} by this user", str(path), if_refused)
        raise NotPermittedError(problem) from error
    except OSError as error:
        what = f"cannot be {done}: {error.strerror or error}"
        raise MissingInputError(Problem(what, str(path), remedy)) from error


def reading(path: Path) -> contextlib.AbstractContextManager[None]:
    join = "sudo usermod -aG vcu-gateway-recorder $USER and log in again, or use sudo"
    return _disk(path, "read", join, "recordings lie elsewhere? --folder")


def writing(path: Path) -> contextlib.AbstractContextManager[None]:
    return _disk(path, "changed", "use sudo")


def recording_path(name: str) -> Path:
    """The path of this name; below DEFAULT_FOLDER where nothing of this name lies here.

    NotPermittedError where this user may not look.
    """
    path = Path(name)
    if "/" in name or "." in name or _is_there(path):  # the recorder's names have neither
        return path
    for parent in _PARENTS.values():
        kept = DEFAULT_FOLDER / parent / name
        if _is_there(kept):
            return kept
    return path


def recorded_path(name: str) -> Path | None:
    """The drive, incident or segment of this name; None where it is something else, such as a log.

    NotPermittedError where this user may not look.
    """
    path = recording_path(name)
    beside = path.parent / layout.DRIVE_FILE
    is_segment = layout.segment_number(path.name) is not None and _is_there(beside)
    return path if is_segment or _is_there(path, folder=True) else None


def _is_there(path: Path, folder: bool = False) -> bool:
    with reading(path):
        try:
            found = path.stat()
        except ValueError:  # a null character
            return False
        except OSError as error:
            if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.EINVAL):
                return False
            raise
    return not folder or stat.S_ISDIR(found.st_mode)


class RecordingSummary(NamedTuple):
    """A drive or an incident in a few words.

    Attributes:
        begun_wall_ns: of what is left of it; None where that cannot be read.
        duration_s: its end is known to the second before it; None likewise.
        size_bytes: of its files; those of an incident are on the disk once, with its drive's.
        lost: what gaps tell; None where it cannot be read.
        reasons: why an incident is kept.
        kept: the recorder never removes it.
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
    path, problems = recording.path, list[str]()
    with reading(path):
        files = [path / layout.DRIVE_FILE, *layout.incident_files(path)]
        drive, *incidents = [_described(one, problems) for one in files]
        segments = layout.segments(path)
        cores = [segment.core for segment in segments if segment.core]
        both_ends = (cores[0], cores[-1]) if cores else (None, None)
        first, last = map(read_begin, both_ends)
        end_s = last_second(both_ends[1])
        begun_s = None if first is None else first.wall_ns / NS_PER_S
        channel = drive.get("channel")
        reasons = [str(one.get("what") or one.get("reason")) for one in incidents if one]
        return RecordingSummary(
            recording.kind,
            recording.name,
            layout.plain_reason(channel) if isinstance(channel, str) else None,
            first and first.wall_ns,
            None if begun_s is None or end_s is None else max(0.0, end_s - begun_s),
            len(segments),
            sum(one.lstat().st_size for one in path.iterdir()),
            last and last.lost,
            tuple(map(layout.plain_reason, reasons)),
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
