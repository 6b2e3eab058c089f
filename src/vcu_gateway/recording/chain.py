"""Chain of a recording's members: each names the one that was written before it by its SHA-256.

The members of all segments of a drive are one row, in the order in which they were written: in a
segment those of the frames' file and of the core lines' file take turns as their links say.

    0001.core   A             link: zeros
    0001.frames B             link: digest of A
    0001.core   C             link: digest of B
    0002.core   D             link: digest of C

So what follows a member proves it: nobody changes, removes, adds or moves one without making
every later one anew. What nothing follows is proved by nothing: whether the end is there, the
closing record says, and who made the whole chain, a signature.

`walk` finds the order with the links alone. Where neither file has the member that names the last
one, the chain is broken; it goes on from the one that is likeliest to be next.
"""

import hashlib
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.recording import layout
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.members import NO_LINK, Member, MemberDamage, read_members

_MOST_LOOKS = 10


class BreakKind(Enum):
    """What a place is where the chain does not go on.

    Attributes:
        BEGINNING: the first segments are not there: removed for room, or by somebody.
        MISSING: members are missing before this place.
        CHANGED: a member was changed, or there are bytes that no recorder wrote.
        UNCHAINED: from here on members have no links, though those before had.
        TORN: the end of a file is no member: a crash, a full disk. No link is missing by it.
    """

    BEGINNING = "beginning"
    MISSING = "missing"
    CHANGED = "changed"
    UNCHAINED = "unchained"
    TORN = "torn"


class Linked(NamedTuple):
    """A member in its place in the order of writing; `member.link` is None where it has none."""

    segment: int
    path: Path
    member: Member


class Break(NamedTuple):
    """A place where the chain does not go on: segment, file, byte, and what is there in words."""

    segment: int
    path: Path
    offset: int
    kind: BreakKind
    what: str


def walk(
    folder: Path, *, lines_too: bool = False, segments: list[SegmentFiles] | None = None
) -> Iterator[Linked | Break]:
    """Every member of a drive or incident in the order of writing, and where that is broken.

    Without `lines_too` nothing is inflated: headers are read and bytes hashed. `segments`: those
    to walk; None: all of the folder. Members without links come file by file. OSError where a
    file cannot be read; FileNotFoundError also where the recorder removed it meanwhile.
    """
    last = _Latest()
    for files in layout.segments(folder) if segments is None else segments:
        yield from _SegmentWalk(files, lines_too, last).walk()


def end(folder: Path) -> Linked | None:
    """The last member that was written: the next one names it; None where there is none."""
    for files in reversed(layout.segments(folder)):
        found = None
        for part in walk(folder, segments=[files]):
            found = part if isinstance(part, Linked) else found
        if found is not None:
            return found
    return None


def file_digests(folder: Path) -> dict[str, str]:
    """SHA-256 of the files beside the members, as they are on the disk; absent ones left out."""
    paths = [folder / name for name in layout.FILES_BESIDE]
    return {path.name: _sha256(path) for path in paths if path.is_file()}


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _Latest:
    """How far the walk has come.

    Attributes:
        member: the latest; None before the first.
        ends: digests that the next one may name: that of `member`; behind members without links
            that of each file's last one.
    """

    def __init__(self) -> None:
        self.member: Linked | None = None
        self.ends: dict[Path, bytes | None] = {}

    @property
    def is_chained(self) -> bool:
        return self.member is not None and self.member.member.link is not None

    def precedes(self, member: Member) -> bool:
        """True where this member's link names the latest one."""
        if self.member is None:
            return member.link in (None, NO_LINK)
        if member.link is None:
            return not self.is_chained
        return member.link in self.ends.values()

    def take(self, linked: Linked) -> None:
        before = self.member
        if linked.member.link is not None or before is None or before.segment != linked.segment:
            self.ends.clear()
        self.member = linked
        self.ends[linked.path] = linked.member.digest


class _MemberFile:
    """One file of a segment: its next member, and the damage before that."""

    def __init__(self, path: Path, size: int, lines_too: bool) -> None:
        self.path = path
        self.lines = 0
        self.next: Member | None = None
        self.damage: MemberDamage | None = None
        self._parts = read_members(path, lines_too, size)
        self.step()

    def step(self) -> None:
        if self.next is not None:
            self.lines = self.next.first_line + self.next.lines
        self.next = None
        for part in self._parts:
            if isinstance(part, Member):
                self.next = part
                return
            self.damage = self.damage or part


class _SegmentWalk:
    """Walk of one segment."""

    def __init__(self, files: SegmentFiles, lines_too: bool, last: _Latest) -> None:
        paths = files.paths
        self._number = files.number
        self._last = last
        self._files = [
            _MemberFile(path, size, lines_too)
            for path, size in zip(paths, _sizes(paths), strict=True)
        ]

    def walk(self) -> Iterator[Linked | Break]:
        while (found := self._next()) is not None:
            file, member = found
            if not self._last.precedes(member):
                yield self._broken(file, member)
            elif file.damage is not None:
                yield self._damage(file, file.damage, BreakKind.CHANGED)
            linked = Linked(self._number, file.path, member)
            self._last.take(linked)
            file.step()
            yield linked
        for file in self._files:
            if file.damage is not None:
                yield self._damage(file, file.damage, BreakKind.TORN)

    def _next(self) -> tuple[_MemberFile, Member] | None:
        """The member that names the last one; without one, what is likeliest to come next."""
        nexts = [(file, file.next) for file in self._files if file.next is not None]
        digests = {member.digest for _, member in nexts}

        def unlikely(one: tuple[_MemberFile, Member]) -> tuple[bool, bool, bool, int]:
            file, member = one
            fits = self._last.precedes(member)
            goes_on = member.first_line == file.lines
            return not fits, member.link in digests, not goes_on, member.wall_s

        return min(nexts, key=unlikely, default=None)

    def _broken(self, file: _MemberFile, member: Member) -> Break:
        """Why this member does not name the last one."""
        last = self._last.member
        for one in self._files:
            if one.damage is not None:
                return self._damage(one, one.damage, BreakKind.CHANGED)
        if last is None:
            before = f"segments before {self._number} are not there"
            if self._number > 1:
                return self._at(file, member, BreakKind.BEGINNING, before)
            return self._at(file, member, BreakKind.MISSING, "what came before it is not there")
        if member.link is None:
            what = "it has no link, though the members before it have"
            return self._at(file, member, BreakKind.UNCHAINED, what)
        if last.segment != self._number:
            return self._at(file, member, BreakKind.MISSING, self._between(last.segment))
        return self._inside(file, member, last)

    def _between(self, before: int) -> str:
        if self._number == before + 2:
            return f"segment {before + 1} is not there, or the end of segment {before} was changed"
        if self._number > before + 2:
            return f"segments {before + 1} to {self._number - 1} are not there"
        return f"the end of segment {before} is missing, or was changed"

    def _inside(self, file: _MemberFile, member: Member, last: Linked) -> Break:
        if (missing := member.first_line - file.lines) > 0:
            return self._at(
                file, member, BreakKind.MISSING, f"{missing} lines before it are missing"
            )
        if missing < 0:
            return self._at(file, member, BreakKind.CHANGED, "its lines were there already")
        for other in self._files:
            if other.next is None and other is not file:
                offset = other.path.stat().st_size
                what = "the end of this file is missing, or the member before was changed: "
                what += f"{last.path.name}, byte {last.member.offset}"
                return Break(self._number, other.path, offset, BreakKind.MISSING, what)
            if other.next is not None and other.next.first_line > other.lines:
                missing = other.next.first_line - other.lines
                what = f"{missing} lines before it are missing"
                return self._at(other, other.next, BreakKind.MISSING, what)
        if len(self._files) == 1:
            return self._at(
                file, member, BreakKind.MISSING, "the segment's other file is not there"
            )
        what = "this member was changed: the next one names another"
        return Break(last.segment, last.path, last.member.offset, BreakKind.CHANGED, what)

    def _at(self, file: _MemberFile, member: Member, kind: BreakKind, what: str) -> Break:
        return Break(self._number, file.path, member.offset, kind, what)

    def _damage(self, file: _MemberFile, damage: MemberDamage, kind: BreakKind) -> Break:
        file.damage = None
        return Break(self._number, file.path, damage.offset, kind, damage.what)


def _sizes(paths: tuple[Path, ...]) -> list[int]:
    """Sizes of both files at one moment, although the recorder may be writing to them."""
    sizes = [path.stat().st_size for path in paths]
    for _ in range(_MOST_LOOKS):
        again = [path.stat().st_size for path in paths]
        if again == sizes:
            break
        sizes = again
    return sizes
