"""Reader of recorded drives: what a gateway was given and what it answered, in order.

    drive = open_drive(Path("drives/20261123T180412Z-1f3a9c2e"))
    for record in drive.runs():
        ...

Memory does not grow with the drive. What is missing is a `Gap`; after it a checkpoint follows.
`CauseSpans` says from the events of a drive from when until when each cause counted.
"""

import contextlib
import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.core.causes import HeldCause
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import DataError, MissingInputError, Problem
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc
from vcu_gateway.recording import chain, layout
from vcu_gateway.recording.call_text import settings_of
from vcu_gateway.recording.candump import recorded_frame, recorded_frames
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    CoreRecord,
    FrameRun,
    Gap,
    LineParser,
    Placed,
    TickRecord,
)
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.members import Member, MemberDamage, whole_members
from vcu_gateway.recording.segment import SegmentBegin, is_number, read_begin
from vcu_gateway.strict_yaml import parser

_MOST_PROBLEMS = 5


class _SegmentMembers:
    """Members of one file up to the first damage; that is empty where they came to its end."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.damage = ""

    def __iter__(self) -> Iterator[Member]:
        damages: list[MemberDamage] = []
        for member in whole_members(self.path, damages.append):
            if damages:
                break
            yield member
        if self.path is None:
            self.damage = "a file of the segment is not there"
        elif damages:
            self.damage = f"{self.path.name}: {damages[0].what}"

    def problem(self, error: ValueError, line: int) -> DataError:
        remedy = "vcu-gateway recordings check says what else is damaged"
        return DataError(Problem(str(error), f"{self.path}:{line}", remedy))


class _FrameSource(_SegmentMembers):
    """Frames of a segment, taken in runs of any length."""

    def __init__(self, path: Path | None, distance_ns: int) -> None:
        super().__init__(path)
        self._members = iter(self)
        self._distance_ns = distance_ns
        self._waiting: list[Frame] = []

    def take(self, count: int) -> list[Frame]:
        waiting = self._waiting
        while len(waiting) < count and (member := next(self._members, None)) is not None:
            waiting += self._frames(member)
        taken, self._waiting = waiting[:count], waiting[count:]
        return taken

    def rest(self) -> Iterator[list[Frame]]:
        if self._waiting:
            yield self.take(len(self._waiting))
        for member in self._members:
            yield self._frames(member)

    def _frames(self, member: Member) -> list[Frame]:
        frames = recorded_frames(member.data, self._distance_ns)
        if frames is not None:
            return frames
        return [self._frame(number, line) for number, line in member.numbered_lines()]

    def _frame(self, number: int, line: bytes) -> Frame:
        try:
            return recorded_frame(line.decode(errors="replace"), self._distance_ns)
        except ValueError as error:
            raise self.problem(error, number) from error


class _SegmentReader:
    """Reads one segment after the other; of the latest its number, and its core line so far."""

    def __init__(self, distance_ns: int) -> None:
        self.number = self.line = 0
        self._distance_ns = distance_ns
        self._begun = False
        self._frames = self._ticks = 0  # since the start of the gateway, as far as they were read
        self._damage = ""

    def runs(self, files: SegmentFiles) -> Iterator[FrameRun | CoreRecord]:
        """Gap, checkpoint, and then every run of frames, call and result in order."""
        before, damage_before = self.number, self._damage
        self.number, self.line, self._damage = files.number, 0, ""
        core, source = _SegmentMembers(files.core), _FrameSource(files.frames, self._distance_ns)
        placed = self._placed(core)
        first, second = next(placed, None), next(placed, None)
        if first is None or not isinstance(first.record, Checkpoint):
            yield self._ended(core.damage or f"{core.path}: does not begin with a checkpoint")
            return
        told = second.record if second and isinstance(second.record, Gap) else None
        if self._begun:
            told = self._missing(first.record, damage_before or (told.why if told else ""), before)
        if told is not None:
            yield told
        yield first.record
        self._begun = True
        self._frames, self._ticks = first.record.frames, first.record.ticks
        yield from self._in_order(itertools.chain([second] if second else [], placed), source)
        if not self._damage and (damage := core.damage or source.damage):
            yield self._ended(damage)

    def _ended(self, damage: str) -> Gap:
        """The segment goes on, and its records end here."""
        self._damage = damage
        return Gap(None, None, None, damage)

    def _missing(self, begin: Checkpoint, why: str, before: int) -> Gap | None:
        frames, ticks = begin.frames - self._frames, begin.ticks - self._ticks
        if frames <= 0 and ticks <= 0:
            return None
        if self.number != before + 1:
            why = f"segments {before + 1} to {self.number - 1} are not there"
        return Gap(max(frames, 0), max(ticks, 0), None, why or "it was not recorded")

    def _in_order(
        self, placed: Iterator[Placed], source: _FrameSource
    ) -> Iterator[FrameRun | CoreRecord]:
        taken = 0
        for frames_before, record in placed:
            if taken < frames_before:
                frames = source.take(frames_before - taken)
                yield self._run(frames)
                taken += len(frames)
                if taken < frames_before:
                    yield self._ended(source.damage or "frames are missing")
                    return
            if not isinstance(record, Gap):
                self._ticks += isinstance(record, TickRecord)
                yield record
        for frames in source.rest():
            yield self._run(frames)

    def _run(self, frames: list[Frame]) -> FrameRun:
        self._frames += len(frames)
        return FrameRun(frames)

    def _placed(self, core: _SegmentMembers) -> Iterator[Placed]:
        parser = LineParser()
        for member in core:
            for self.line, line in member.numbered_lines():
                try:
                    yield from parser.records(line.decode(errors="replace"))
                except ValueError as error:
                    raise core.problem(error, self.line) from error


class DriveInfo(NamedTuple):
    """What a gateway said of itself when it began to be recorded.

    Attributes:
        versions: of the program, Python, the kernel and the machine.
        clock: wall time of a frame is arrival_ns + clock.distance_ns.
        settings: in effect when the drive began; those of a checkpoint are later ones.
    """

    run: str
    channel: str
    versions: dict[str, str]
    clock: ClockPair
    settings: Settings
    config: str
    dbc: str


def open_drive(path: Path) -> "Drive":
    """A drive's or an incident's folder, or one file of a segment in it.

    Raises MissingInputError or DataError, with the file and what to do; DataError also where a
    file beside the members is not the one that the recorder wrote: what it says would be of
    another drive.
    """
    folder, only = path, None
    if path.is_file() and (number := layout.segment_number(path.name)) is not None:
        folder, only = path.parent, number
    elif not path.is_dir():
        what = "is no recorded drive" if path.exists() else "is not there"
        remedy = "give a drive's or an incident's folder, or a segment's file in it"
        raise MissingInputError(Problem(what, str(path), remedy))
    info = _info(folder)
    segments = layout.segments(folder)
    compare_with_digests(folder, segments)
    files = [one for one in segments if only in (None, one.number)]
    return Drive(folder, info, tuple(files))


def compare_with_digests(folder: Path, segments: list[SegmentFiles]) -> None:
    """DataError where the first segment's begin names other digests; older ones name none."""
    begin: SegmentBegin | None = None
    for files in segments:
        with contextlib.suppress(OSError):
            begin = begin or read_begin(files.core)
    if begin is None or not begin.files:
        return
    found = chain.file_digests(folder)
    for name in layout.FILES_BESIDE:
        if found.get(name) != begin.files.get(name):
            what = "is not the file that the recorder wrote: the recording names another SHA-256"
            remedy = "vcu-gateway recordings check says what else was changed"
            raise DataError(Problem(what, str(folder / name), remedy))


def _info(folder: Path) -> DriveInfo:
    path = folder / layout.DRIVE_FILE
    described = layout.read_description(path)
    try:
        return DriveInfo(
            run=described["run"],
            channel=layout.plain_reason(described["channel"]),
            versions=dict(described["versions"]),
            clock=clock_of(described),
            settings=settings_of(described["settings"]),
            config=_text(folder / layout.CONFIG_FILE),
            dbc=_text(folder / layout.DBC_FILE),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        version = described.get("versions", {})
        what = f"cannot be used ({type(error).__name__}: {error}); written by {version}"
        raise DataError(Problem(what, str(path))) from error


def protocol_of(dbc_path: Path, aliases: Mapping[int, str]) -> ProtocolSpec:
    """DBC of a drive, with further identifiers; DataError where no gateway can drive with it."""
    protocol = dbc.load(dbc_path)
    if unmet := dbc.unmet(protocol, lambda *_: str(dbc_path)):
        raise DataError(*unmet[:_MOST_PROBLEMS])
    return dbc.with_aliases(protocol, aliases)


def recorded_aliases(config: str) -> Mapping[int, str]:
    """Further identifiers of messages in a recorded configuration, whatever wrote it.

    The usual ones where it says none, or cannot be used.
    """
    values = parser.read(config).value
    section = values.get("protocol") if isinstance(values, dict) else None
    aliases: Any = section.get("aliases") if isinstance(section, dict) else None
    try:
        return {int(str(key), 0): str(name) for key, name in aliases.items()}
    except (AttributeError, ValueError):
        return DEFAULT_ALIASES


def clock_of(described: Mapping[str, Any]) -> ClockPair:
    """Both clocks of a drive.json; KeyError, TypeError or ValueError where they are none."""
    stamps = [described["clock"][key] for key in ("monotonic_ns", "wall_ns")]
    if not all(map(is_number, stamps)):
        raise ValueError("a clock is no number of nanoseconds")
    return ClockPair(*stamps)


def _text(path: Path) -> str:
    try:
        return layout.read_small(path).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise MissingInputError(Problem(f"cannot be read: {error}", str(path))) from error


@dataclass
class Drive:
    """A recorded drive, or the part of one that is in a folder; its segments by number."""

    folder: Path
    info: DriveInfo
    segments: tuple[SegmentFiles, ...]
    _read: _SegmentReader | None = None

    def runs(self, first_segment: int | None = None) -> Iterator[FrameRun | CoreRecord]:
        """Every run of frames, call and result in order, from this segment on.

        Raises DataError where a line is whole and wrong.
        """
        reader = _SegmentReader(self.info.clock.distance_ns)
        for files in self.segments:
            if first_segment is None or files.number >= first_segment:
                self._read = reader
                yield from reader.runs(files)

    @property
    def protocol(self) -> ProtocolSpec:
        """The DBC beside it, with the aliases of its configuration; DataError as `protocol_of`."""
        return protocol_of(self.folder / layout.DBC_FILE, recorded_aliases(self.info.config))

    @property
    def place(self) -> str:
        """Core line up to which records were given last, as file:line."""
        if self._read is None:
            return str(self.folder)
        return f"{self.folder / layout.core_name(self._read.number)}:{self._read.line}"


class CauseKey(NamedTuple):
    """What makes a cause one, as in the core: two causes may have the same subject and effect."""

    cause: str
    subject: str
    effect: str

    def __str__(self) -> str:
        return f"{self.subject} ({self.cause}): {self.effect}"

    @property
    def title(self) -> str:
        """Subject and effect; of a curve its key, as several curves are over the same quantity."""
        curve = self.cause.startswith("curves.")
        return f"{self.cause if curve else self.subject}: {self.effect}"


@dataclass
class CauseSpan:
    """Time for which a cause counted; `ended_ns` is None where it still does at the end."""

    key: CauseKey
    detail: str
    began_ns: int
    ended_ns: int | None = None


class CauseSpans:
    """Builds the spans of a recording, or of one side of a comparison; only the first `most`."""

    def __init__(self, most: int | None = None) -> None:
        self.spans: list[CauseSpan] = []
        self._most = most
        self._open: dict[CauseKey, CauseSpan] = {}

    @property
    def effects(self) -> frozenset[str]:
        return frozenset(key.effect for key in self._open)

    def stand(self, held: Iterable[HeldCause], now_ns: int) -> None:
        """At a checkpoint these causes count: those that did go on, all others have ended."""
        findings = [one.finding for one in held]
        details = {CauseKey(f.cause, f.subject, f.effect.value): f.detail for f in findings}
        for key in self._open.keys() - details.keys():
            self._end(key, now_ns)
        for key, detail in details.items():
            self._begin(key, detail, now_ns)

    def event(self, name: str, fields: Mapping[str, object], now_ns: int) -> None:
        """Take in an event; those of other names than a cause's change nothing."""
        key = CauseKey(*(str(fields.get(part, "")) for part in CauseKey._fields))
        if name == "cause_began":
            self._begin(key, str(fields.get("detail", "")), now_ns)
        elif name == "cause_ended":
            self._end(key, now_ns)

    def end(self, now_ns: int) -> None:
        """Nothing is known of what follows: every cause ends here."""
        for key in tuple(self._open):
            self._end(key, now_ns)

    def _begin(self, key: CauseKey, detail: str, now_ns: int) -> None:
        if key in self._open:
            return
        span = self._open[key] = CauseSpan(key, detail, now_ns)
        if self._most is None or len(self.spans) < self._most:
            self.spans.append(span)

    def _end(self, key: CauseKey, now_ns: int) -> None:
        span = self._open.pop(key, None)
        if span is not None:
            span.ended_ns = now_ns
