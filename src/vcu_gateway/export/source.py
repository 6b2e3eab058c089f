"""Recording to be exported: a drive, an incident, one of its files, or a foreign log.

Selection of signals: `--signals GLOB`.
"""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.core.codec import Codec
from vcu_gateway.errors import DataError, MissingInputError, Problem
from vcu_gateway.export.decisions import CoreLines, Decisions
from vcu_gateway.export.frame_store import FrameStore
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, packaged
from vcu_gateway.recording import layout
from vcu_gateway.recording.candump import LineProblems
from vcu_gateway.recording.folder import recorded_path
from vcu_gateway.recording.log import STANDARD_INPUT, open_recording
from vcu_gateway.recording.members import MemberDamage, read_members
from vcu_gateway.recording.reader import compare_with_digests, protocol_of, recorded_aliases
from vcu_gateway.time_window import Window


class Selection:
    """Signals that some patterns ask for; every one where there are no patterns.

    A pattern is compared with `Message.Signal`, with the message and with the signal alone,
    whatever the case.
    """

    def __init__(self, patterns: Iterable[str] = ()) -> None:
        self._patterns = {pattern: pattern.lower() for pattern in patterns}
        self._unused = set(self._patterns)

    def wants(self, table: str, signal: str) -> bool:
        if not self._patterns:
            return True
        names = (f"{table}.{signal}".lower(), table.lower(), signal.lower())
        found = False
        for pattern, lowered in self._patterns.items():
            if any(fnmatchcase(name, lowered) for name in names):
                self._unused.discard(pattern)
                found = True
        return found

    @property
    def unused(self) -> tuple[str, ...]:
        """Patterns that no signal answered to so far."""
        return tuple(sorted(self._unused))


_FRAMES_BETWEEN_LOOKS = 8192
_SHORTEST_CORE_LINE, _SHORTEST_FRAME_LINE = len(b'{"f":0}'), len(b"(1.123456789) a 123#R R")
_BLOCK_BYTES = 1 << 22


class ReadOptions(NamedTuple):
    """How a recording is read.

    Attributes:
        dbc_path: instead of the recording's own or the packaged one.
        aliased: take 0x08F02DE2 for IMU_Attitude.
        report: is given every complaint that is worth telling.
        progress: is given the share that was read, None where nobody knows, and the frames so far.
    """

    window: Window
    report: Callable[[Problem], None]
    progress: Callable[[float | None, int], None]
    dbc_path: Path | None = None
    aliased: bool = True


class Source(NamedTuple):
    """A recording, read.

    Attributes:
        title: its name for people.
        description: drive.json; empty for a foreign log.
        attachments: files that belong to it, by name.
        unreadable: lines that could not be read.
    """

    title: str
    codec: Codec
    store: FrameStore
    decisions: Decisions
    description: Mapping[str, Any]
    attachments: Mapping[str, bytes]
    unreadable: int

    @property
    def start_ns(self) -> int:
        """Stamp of the first frame or tick that is exported."""
        firsts = [rows.first_ns for rows in self.store.rows.values() if rows.first_ns is not None]
        return min([*firsts, *self.decisions.tick_times_ns[:1]], default=0)

    @property
    def end_ns(self) -> int:
        """Stamp of the last frame or tick that is exported."""
        lasts = [rows.last_ns for rows in self.store.rows.values() if rows.last_ns is not None]
        return max([*lasts, *self.decisions.tick_times_ns[-1:]], default=0)


def title(name: str) -> str:
    """Name of a recording for people, and for the file that is made of it."""
    path = Path(name)
    if path.is_dir():
        return path.resolve().name
    if name == STANDARD_INPUT:
        return "recording"
    stem = path.name.removesuffix(".gz")
    if recorded_path(name) is not None:
        return f"{path.resolve().parent.name}-{stem.partition('.')[0]}"
    return stem.rpartition(".")[0] or stem


def read(name: str, options: ReadOptions) -> Source:
    """Read a recording once; MissingInputError, DataError where it cannot be."""
    path = recorded_path(name)
    source = _read_log(name, options) if path is None else _read_drive(path, options)
    summary, ticks_ns = source.store.summary, source.decisions.tick_times_ns
    if not summary.frames and not ticks_ns:
        remedy = "" if source.unreadable else "it is empty"
        raise DataError(Problem("holds no frame that can be read", name, remedy))
    if not (options.window.open or summary.decoded or ticks_ns):
        raise DataError(Problem("has nothing of that time", name, "all times are UTC"))
    return source


def _read_log(name: str, options: ReadOptions) -> Source:
    path = options.dbc_path or packaged("vcu.dbc")
    aliases = DEFAULT_ALIASES if options.aliased else {}
    codec = Codec(dbc.with_aliases(dbc.load(path), aliases))
    store = FrameStore(codec, options.window)
    with open_recording(name, options.report) as recording:
        if recording.is_candump:
            for first_line, text in recording.blocks(_BLOCK_BYTES):
                store.add_lines(text, first_line, recording.problems)
                options.progress(recording.share_read(), store.summary.frames)
        else:
            for count, recorded in enumerate(recording, 1):
                store.add(recorded)
                if count % _FRAMES_BETWEEN_LOOKS == 0:
                    options.progress(recording.share_read(), count)
        unreadable = recording.problems.unreadable
    decisions = Decisions(options.window)
    attached = {path.name: path.read_bytes()}
    return Source(title(name), codec, store, decisions, {}, attached, unreadable)


def _read_drive(path: Path, options: ReadOptions) -> Source:
    folder = path if path.is_dir() else path.parent
    description = layout.read_description(folder / layout.DRIVE_FILE)
    segments = layout.segments(folder)
    compare_with_digests(folder, segments)
    attached = _attachments(folder)
    config = attached.get(layout.CONFIG_FILE, b"").decode(errors="replace")
    aliases = recorded_aliases(config) if options.aliased else {}
    codec = Codec(protocol_of(options.dbc_path or folder / layout.DBC_FILE, aliases))
    store, decisions = FrameStore(codec, options.window), Decisions(options.window)
    if not path.is_dir():
        segments = [one for one in segments if path in one.paths]
    if not segments:
        raise MissingInputError(Problem("has no segment of a recording", str(folder)))
    core = CoreLines(decisions, description, codec, folder / layout.DRIVE_FILE)
    reader = _DriveReader(store, core, options)
    reader.read(segments)
    unreadable = reader.unreadable + core.unreadable
    return Source(title(str(path)), codec, store, decisions, description, attached, unreadable)


def _attachments(folder: Path) -> dict[str, bytes]:
    """Configuration, DBC and descriptions, as far as they are there."""
    files = [folder / name for name in (layout.CONFIG_FILE, layout.DBC_FILE, layout.DRIVE_FILE)]
    files += layout.incident_files(folder)
    found = {}
    for path in files:
        with contextlib.suppress(OSError):
            found[path.name] = layout.read_small(path)
    return found


class _DriveReader:
    def __init__(self, store: FrameStore, core: CoreLines, options: ReadOptions) -> None:
        self._store, self._core, self._options = store, core, options
        self.unreadable = 0

    def read(self, segments: list[layout.SegmentFiles]) -> None:
        sizes = [sum(path.lstat().st_size for path in one.paths) for one in segments]
        for number, segment in enumerate(segments):
            if number and segment.number != segments[number - 1].number + 1:
                self._core.gap(f"no segment before {segment.number:04d}")
            if segment.core is not None:
                for first_line, text in self._texts(segment.core, _SHORTEST_CORE_LINE):
                    self._core.add(text, self._damaged(segment.core, first_line))
            if segment.frames is not None:
                problems = LineProblems(_places(segment.frames), self._options.report)
                for first_line, text in self._texts(segment.frames, _SHORTEST_FRAME_LINE):
                    self._store.add_lines(text, first_line, problems)
                self.unreadable += problems.unreadable
            share = sum(sizes[: number + 1]) / max(1, sum(sizes))
            self._options.progress(share, self._store.summary.frames)

    def _damaged(self, path: Path, first_line: int) -> Callable[[int, str], None]:
        def told(number: int, what: str) -> None:
            self._options.report(Problem(what, f"{path}:{first_line + number}"))

        return told

    def _texts(self, path: Path, shortest_line: int) -> Iterator[tuple[int, bytes]]:
        for member in read_members(path):
            if isinstance(member, MemberDamage):
                end = "the end of what was written" if member.torn else "read on behind it"
                where = f"{path}, byte {member.offset}"
                self._options.report(Problem(f"{member.size} bytes: {member.what}", where, end))
            elif member.lines * shortest_line > len(member.data):
                what = f"{member.lines} lines that are too short for any of a recording"
                self._options.report(Problem(what, f"{path}, byte {member.offset}"))
                self.unreadable += member.lines
            else:
                yield member.first_line, member.data


def _places(path: Path) -> Callable[[int], str]:
    return lambda position: f"{path}:{position}"
