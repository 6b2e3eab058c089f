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
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.recording import layout
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.members import NO_LINK, Member, MemberDamage, read_members


class FaultKind(Enum):
    """What is wrong with a recording.

    Attributes:
        TORN: the last bytes of a file are no member: a kill, a power cut or a full disk. No link
            is missing by it.
        MISSING: something that was recorded, or a whole file, is not there.
        CHANGED: something is not what the recorder wrote.
    """

    TORN = "torn"
    MISSING = "missing"
    CHANGED = "changed"


class FileFault(NamedTuple):
    """What is wrong with a file, or with the whole recording where the name is empty."""

    file: str
    what: str
    kind: FaultKind


class Linked(NamedTuple):
    """A member in its place in the order of writing; `member.link` is None where it has none."""

    segment: int
    path: Path
    member: Member


class Break(NamedTuple):
    """A place where the chain does not go on: segment, file, byte, and what is there in words.

    Where it is the beginning, the first segments are not there: removed for room, or by somebody.
    """

    segment: int
    path: Path
    offset: int
    kind: FaultKind
    what: str
    is_beginning: bool = False

    @property
    def fault(self) -> FileFault:
        what = f"from byte {self.offset} on: {self.what}"
        if self.is_beginning:
            what = f"{self.what}: removed for room, or by somebody"
        return FileFault(self.path.name, what, self.kind)


def follow(
    segments: list[SegmentFiles], is_part: bool
) -> tuple[bool, dict[int, bytes], list[FileFault]]:
    """Whether every member has a link, the digest of each segment's last one, and the breaks.

    `is_part`: of an incident, which may begin anywhere in its drive. Files that cannot be read, of
    which `check_segment` says why, are passed by.
    """
    linked, ends, faults = list[bool](), dict[int, bytes](), list[FileFault]()
    with suppress(OSError):
        for part in walk(segments):
            if isinstance(part, Linked):
                linked.append(part.member.link is not None)
                if part.member.digest is not None:
                    ends[part.segment] = part.member.digest
            elif not (is_part and part.is_beginning):
                faults.append(part.fault)
    return all(linked) and bool(linked), ends, faults


def walk(segments: list[SegmentFiles]) -> Iterator[Linked | Break]:
    """Every member of these segments in the order of writing, and where that is broken.

    Nothing is inflated: headers are read and bytes hashed. Members without links come file by
    file. OSError where a file cannot be read; FileNotFoundError also where the recorder removed it
    meanwhile.
    """
    walker = _Walker()
    for files in segments:
        yield from walker.segment(files)


def end(folder: Path) -> Linked | None:
    """The last member that was written: the next one names it; None where there is none."""
    for files in reversed(layout.segments(folder)):
        linked = [part for part in walk([files]) if isinstance(part, Linked)]
        if linked:
            return linked[-1]
    return None


def file_digests(folder: Path) -> dict[str, str]:
    """SHA-256 of the files beside the members, as they are on the disk; absent ones left out."""
    digests = {}
    for name in layout.FILES_BESIDE:
        if (folder / name).is_file():
            with (folder / name).open("rb") as file:
                digests[name] = hashlib.file_digest(file, "sha256").hexdigest()
    return digests


class _MemberFile:
    """One file of a segment: its next member, and the damage and the lines before that."""

    def __init__(self, path: Path, size: int) -> None:
        self.path = path
        self.lines = 0
        self.next: Member | None = None
        self.damage: MemberDamage | None = None
        self._parts = read_members(path, lines_too=False, end=size)
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

    @property
    def missing_lines(self) -> int:
        """How many are missing before the next member; negative where they were there already."""
        return 0 if self.next is None else self.next.first_line - self.lines


class _Walker:
    """Walks one segment after the other: the latest member, and what the next one may name.

    That is the latest one's digest; behind members without links that of each file's last one.
    """

    def __init__(self) -> None:
        self._last: Linked | None = None
        self._ends: dict[Path, bytes | None] = {}
        self._number = 0
        self._files: list[_MemberFile] = []

    def segment(self, segment: SegmentFiles) -> Iterator[Linked | Break]:
        self._number = segment.number
        sizes = zip(segment.paths, _sizes(segment.paths), strict=True)
        self._files = [_MemberFile(path, size) for path, size in sizes]
        while (found := self._next()) is not None:
            file, member = found
            if not self._precedes(member):
                yield self._broken(file, member)
            elif file.damage is not None:
                yield self._damage(file, file.damage, FaultKind.CHANGED)
            yield self._take(file, member)
        for file in self._files:
            if file.damage is not None:
                yield self._damage(file, file.damage, FaultKind.TORN)

    def _precedes(self, member: Member) -> bool:
        """True where this member's link names the latest one."""
        if self._last is None:
            return member.link in (None, NO_LINK)
        if member.link is None:
            return self._last.member.link is None
        return member.link in self._ends.values()

    def _take(self, file: _MemberFile, member: Member) -> Linked:
        if member.link is not None or self._last is None or self._last.segment != self._number:
            self._ends.clear()
        self._ends[file.path] = member.digest
        self._last = Linked(self._number, file.path, member)
        file.step()
        return self._last

    def _next(self) -> tuple[_MemberFile, Member] | None:
        """The member that names the last one; without one, what is likeliest to come next."""
        nexts = [(file, file.next) for file in self._files if file.next is not None]
        digests = {member.digest for _, member in nexts}

        def unlikely(one: tuple[_MemberFile, Member]) -> tuple[bool, bool, bool, int]:
            file, member = one
            fits, names_other = self._precedes(member), member.link in digests
            return not fits, names_other, file.missing_lines != 0, member.wall_s

        return min(nexts, key=unlikely, default=None)

    def _broken(self, file: _MemberFile, member: Member) -> Break:
        """Why this member does not name the last one."""
        last, number, kind, is_beginning = self._last, self._number, FaultKind.MISSING, False
        for one in self._files:
            if one.damage is not None:
                return self._damage(one, one.damage, FaultKind.CHANGED)
        if last is None:
            is_beginning = number > 1
            before = f"segments before {number} are" if is_beginning else "what came before it is"
            what = f"{before} not there"
        elif member.link is None:
            kind, what = FaultKind.CHANGED, "it has no link, though the members before it have"
        elif last.segment != number:
            what = _between(last.segment, number)
        else:
            return self._broken_inside(file, member, last)
        return Break(number, file.path, member.offset, kind, what, is_beginning)

    def _broken_inside(self, file: _MemberFile, member: Member, last: Linked) -> Break:
        """Why it does not where the last one is of this segment, too."""
        kind = FaultKind.MISSING
        if file.missing_lines > 0:
            what = f"{file.missing_lines} lines before it are missing"
        elif file.missing_lines < 0:
            kind, what = FaultKind.CHANGED, "its lines were there already"
        elif len(self._files) == 1:
            what = "the segment's other file is not there"
        else:
            return self._in_other_file(file, last)
        return Break(self._number, file.path, member.offset, kind, what)

    def _in_other_file(self, file: _MemberFile, last: Linked) -> Break:
        """What is wrong where this file goes on as it should."""
        (other,) = [one for one in self._files if one is not file]
        if other.next is None:
            offset = other.path.stat().st_size
            what = "the end of this file is missing, or the member before was changed: "
            what += f"{last.path.name}, byte {last.member.offset}"
            return Break(self._number, other.path, offset, FaultKind.MISSING, what)
        if other.missing_lines > 0:
            what = f"{other.missing_lines} lines before it are missing"
            return Break(self._number, other.path, other.next.offset, FaultKind.MISSING, what)
        what = "this member was changed: the next one names another"
        return Break(last.segment, last.path, last.member.offset, FaultKind.CHANGED, what)

    def _damage(self, file: _MemberFile, damage: MemberDamage, kind: FaultKind) -> Break:
        file.damage = None
        return Break(self._number, file.path, damage.offset, kind, damage.what)


def _between(before: int, number: int) -> str:
    if number == before + 2:
        return f"segment {before + 1} is not there, or the end of segment {before} was changed"
    if number > before + 2:
        return f"segments {before + 1} to {number - 1} are not there"
    return f"the end of segment {before} is missing, or was changed"


def _sizes(paths: tuple[Path, ...]) -> list[int]:
    """Sizes of both files at one moment, although the recorder may be writing to them."""
    sizes: list[int] = []
    for _ in range(10):
        before, sizes = sizes, [path.stat().st_size for path in paths]
        if before == sizes:
            break
    return sizes
