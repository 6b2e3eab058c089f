"""Writer of one segment: frames and core lines, a gzip member a second in each file."""

import os
from pathlib import Path

from vcu_gateway import files
from vcu_gateway.drive_format import layout, members


class MemberFile:
    """File of members that only grows; made by this process, never opened again.

    Attributes:
        path: where it is.
        lines: how many whole members of it hold.
        size: bytes of whole members.
    """

    def __init__(self, path: Path) -> None:
        """Make the file; FileExistsError where it is there already."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
        self._descriptor = os.open(path, flags, 0o640)
        self.path = path
        self.lines = self.size = 0

    def append(self, data: bytes, wall_s: int, link: bytes | None = None) -> bytes:
        """Write whole lines as one member, and give its digest; OSError leaves none of it."""
        member = members.packed(data, self.lines, wall_s, link)
        self._write(member)
        self.size += len(member)
        self.lines += data.count(b"\n")
        return members.digest_of(member)

    def _write(self, member: bytes) -> None:
        written = 0
        try:
            while written < len(member):
                written += os.write(self._descriptor, memoryview(member)[written:])
        except OSError:
            if written:  # a disk that is full takes a part
                os.ftruncate(self._descriptor, self.size)
            raise

    def sync(self) -> None:
        os.fdatasync(self._descriptor)

    @property
    def is_in_place(self) -> bool:
        """False where somebody removed it, or its folder."""
        try:
            found = self.path.stat()
        except OSError:
            return False
        return os.path.samestat(found, os.fstat(self._descriptor))

    def close(self) -> None:
        os.close(self._descriptor)


class SegmentWriter:
    """Both files of one segment, and the lines that wait for the next member.

    Frames are written before the core lines that count them.

    Attributes:
        number: of the segment.
        link: digest of the last member written to the drive; None: members are not chained.
        frames: how many it was given; the `f` of the next core line.
        waiting: characters that no member has yet.
    """

    def __init__(self, folder: Path, number: int, link: bytes | None = None) -> None:
        """Make both files; FileExistsError where there is one, else OSError as the disk has it."""
        self.number = number
        self.link = link
        self.frames = self.waiting = 0
        self._frame_text: list[str] = []
        self._core_text: list[str] = []
        self._frames_file = MemberFile(folder / layout.frames_name(number))
        try:
            self._core_file = MemberFile(folder / layout.core_name(number))
            files.sync(folder)
        except OSError:
            self._frames_file.close()
            self._frames_file.path.unlink(missing_ok=True)
            raise

    @property
    def size(self) -> int:
        return self._frames_file.size + self._core_file.size

    @property
    def recorded_frames(self) -> int:
        return self._frames_file.lines

    @property
    def is_in_place(self) -> bool:
        return self._frames_file.is_in_place and self._core_file.is_in_place

    def add(self, core_text: str, frame_text: str = "", frames: int = 0) -> None:
        """Core lines, and that many frame lines before them; each with its line end."""
        self.frames += frames
        self.waiting += len(frame_text) + len(core_text)
        self._frame_text.append(frame_text)
        self._core_text.append(core_text)

    def flush(self, wall_s: int) -> None:
        """Write what waits, a member for each file; OSError leaves what is unwritten waiting."""
        for file, waiting in self._files():
            text = "".join(waiting).encode()
            if text:
                digest = file.append(text, wall_s, self.link)
                self.link = digest if self.link is not None else None
            waiting.clear()
        self.waiting = 0

    def _files(self) -> tuple[tuple[MemberFile, list[str]], ...]:
        return (self._frames_file, self._frame_text), (self._core_file, self._core_text)

    def sync(self) -> None:
        for file, _ in self._files():
            file.sync()

    def close(self) -> None:
        """Close both files; what waits is lost."""
        for file, _ in self._files():
            file.close()
