"""Files of gzip members: each holds whole lines and says where it stands.

A member is an ordinary one for zcat and every gzip library. Its header's extra field (RFC 1952,
2.3.1.1), subfield `VR`, adds what a reader of a damaged file needs: how many lines of the file
stand before it, how many it has, its size in bytes, and a checksum of the header. So a reader
finds the next whole member after torn, zeroed or damaged bytes, and knows how many lines are
missing between two. A second subfield, `VL`, is its link: the SHA-256 of the member that was
written before it, so that all members of a drive are one chain (`chain`).

    0   1f 8b 08 04   gzip, deflate, extra field
    4   seconds       when its lines were gathered, wall clock; 32 bits, little endian
    8   00 ff         nothing of the compression, unknown system
    10  38 00         length of the extra field: 56; without a link 20 (14 00)
    12  56 52 10 00   `VR`, 16 bytes follow
    16  lines before, lines, size of the member, CRC-32 of the 28 bytes before; 32 bits each
    32  56 4c 20 00   `VL`, 32 bytes follow
    36  link
    68  deflate data, CRC-32 and length of the lines; without a link from byte 32
"""

import errno
import hashlib
import os
import stat
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

_HEADER = struct.Struct("<4sI2sH2sHIIII")
_MAGIC = b"\x1f\x8b\x08\x04"
_SIGNATURE = b"\x00\xff\x14\x00VR\x10\x00"
_LINKED_SIGNATURE = b"\x00\xff\x38\x00VR\x10\x00"
_SIGNATURES = (_LINKED_SIGNATURE, _SIGNATURE)
_SIGNATURE_OFFSET = 8
_CHECKED_BYTES = 28
_LINK_BEGIN = b"VL\x20\x00"
LINK_BYTES = 32
_TRIED_BYTES = 1 << 14
_LINKED_HEADER_BYTES = _HEADER.size + len(_LINK_BEGIN) + LINK_BYTES
NO_LINK = bytes(LINK_BYTES)
"""Link of a drive's first member: there is none before it."""
_TRAILER = struct.Struct("<II")
_GZIP = b"\x1f\x8b\x08"
_RAW_DEFLATE = -15
_ANY_GZIP = 31
_LEVEL, _LEVEL_OF_MUCH = 7, 4
_MUCH_BYTES = 100_000
_MEMORY_LEVEL = 8
_32_BITS = 0xFFFF_FFFF
_SEARCH_BYTES = 1 << 16
_NO_FILE_OF_OURS = (errno.EISDIR, errno.ELOOP, errno.ENXIO, errno.ENOTDIR)
MAX_MEMBER_BYTES = 1 << 24
"""Of one member, and of its lines; more is damage, or an attack on the reader's memory."""


class Member(NamedTuple):
    """One readable member.

    Attributes:
        offset, size: where it stands in the file, bytes.
        first_line: lines of the file before it, those of lost members included.
        lines: how many it has.
        wall_s: when its lines were gathered, seconds since 1970; 0 where it is not known.
        data: its lines, each with its end; empty where they were not asked for.
        link: digest of the member written before it; None where it is not chained.
        digest: SHA-256 of its bytes; None for a member of another program.
    """

    offset: int
    size: int
    first_line: int
    lines: int
    wall_s: int
    data: bytes
    link: bytes | None = None
    digest: bytes | None = None

    def numbered_lines(self) -> Iterator[tuple[int, bytes]]:
        """Each line without its end, from 1; a list of them may not fit into memory."""
        begin, number = 0, self.first_line + 1
        while (end := self.data.find(b"\n", begin)) >= 0:
            yield number, self.data[begin:end]
            begin, number = end + 1, number + 1
        if begin < len(self.data):
            yield number, self.data[begin:]


class MemberDamage(NamedTuple):
    """Bytes of the file that are no readable member.

    Attributes:
        offset, size: where they stand in the file, bytes.
        torn: at the end of the file: what a crash, a power cut or a full disk leaves.
        what: in words, without the place.
        lost_lines: how many are not there, though no byte is damaged; then the size is 0.
    """

    offset: int
    size: int
    torn: bool
    what: str
    lost_lines: int = 0


class _Header(NamedTuple):
    """What the header of a member of ours says; `body`: where its deflate data begins."""

    wall_s: int
    first_line: int
    lines: int
    size: int
    body: int
    link: bytes | None


def digest_of(member: bytes) -> bytes:
    return hashlib.sha256(member).digest()


def packed(data: bytes, first_line: int, wall_s: int, link: bytes | None = None) -> bytes:
    """One member of whole lines, each with its end; `first_line` lines stand before it.

    Filtered: among stamps of nanoseconds most short matches cost more than they save.
    """
    level = _LEVEL if len(data) < _MUCH_BYTES else _LEVEL_OF_MUCH
    deflate = zlib.compressobj(level, zlib.DEFLATED, _RAW_DEFLATE, _MEMORY_LEVEL, zlib.Z_FILTERED)
    body = deflate.compress(data) + deflate.flush()
    linked = b"" if link is None else _LINK_BEGIN + link
    size = _HEADER.size + len(linked) + len(body) + _TRAILER.size
    fields = (_MAGIC, wall_s & _32_BITS, b"\x00\xff", 20 + len(linked), b"VR", 16)
    numbers = (first_line, data.count(b"\n"), size)
    checked = _HEADER.pack(*fields, *numbers, 0)[:_CHECKED_BYTES]
    crc = zlib.crc32(checked).to_bytes(4, "little")
    trailer = _TRAILER.pack(zlib.crc32(data), len(data) & _32_BITS)
    return b"".join((checked, crc, linked, body, trailer))


def read_members(
    path: Path, lines_too: bool = True, end: int | None = None
) -> Iterator[Member | MemberDamage]:
    """Every readable member in order, and between them what is damaged; OSError as `open` has it.

    Without `lines_too` those of ours are not inflated: headers are read and bytes hashed. `end` is
    where the file ends for this reader; None: where it ended when it was opened. Members of other
    programs are read as well; an ordinary gzip file is one member. What is no regular file is
    damage, and nothing waits for it.
    """
    try:
        descriptor = _opened(path)
    except OSError as error:
        if error.errno not in _NO_FILE_OF_OURS and not path.is_symlink():
            raise
        yield MemberDamage(0, 0, False, f"cannot be read: {error.strerror}")
        return
    try:
        size = os.fstat(descriptor).st_size
        end = size if end is None else min(end, size)
        offset = lines = 0
        while offset < end:
            part = _part_at(descriptor, offset, end, lines, lines_too)
            yield part
            offset += part.size
            if isinstance(part, Member):
                lines = part.first_line + part.lines
    finally:
        os.close(descriptor)


def whole_members(
    path: Path | None, damaged: Callable[[MemberDamage], object] = lambda _: None
) -> Iterator[Member]:
    """Every readable member in order; None: the file is not there.

    `damaged` is given what stands between two of them, before the later one, lost lines too.
    OSError as `read_members`.
    """
    lines = 0
    for part in () if path is None else read_members(path):
        if isinstance(part, MemberDamage):
            damaged(part)
            continue
        if (lost := part.first_line - lines) > 0:
            damaged(MemberDamage(part.offset, 0, False, f"{lost} lines are lost", lost))
        lines = part.first_line + part.lines
        yield part


def _opened(path: Path) -> int:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EISDIR, "is no regular file", str(path))
    return descriptor


def _part_at(
    descriptor: int, offset: int, end: int, lines: int, lines_too: bool
) -> Member | MemberDamage:
    header = _header(os.pread(descriptor, _LINKED_HEADER_BYTES, offset))
    if header is None:
        return _foreign_or_damaged(descriptor, offset, end, lines)
    if offset + header.size > end:
        return _damage(descriptor, offset, end, "the last member is cut off")
    is_large = header.size > _TRIED_BYTES
    if lines_too and is_large and not _begins_well(descriptor, offset + header.body):
        return _damage(descriptor, offset, end, f"{header.lines} lines cannot be read")
    member = os.pread(descriptor, header.size, offset)
    data = _inflated(member[header.body :]) if lines_too else b""
    if data is None or (lines_too and data.count(b"\n") != header.lines):
        return _damage(descriptor, offset, end, f"{header.lines} lines cannot be read")
    _, first_line, count, size, _, link = header
    return Member(offset, size, first_line, count, header.wall_s, data, link, digest_of(member))


def _header(data: bytes) -> _Header | None:
    """Header of a member of ours; None for anything else."""
    if len(data) < _HEADER.size or not data.startswith(_MAGIC):
        return None
    _, wall_s, *_, first_line, count, size, crc = _HEADER.unpack_from(data)
    signature = data[_SIGNATURE_OFFSET:16]
    if signature not in _SIGNATURES or zlib.crc32(data[:_CHECKED_BYTES]) != crc:
        return None
    body, link = _HEADER.size, None
    if signature == _LINKED_SIGNATURE:
        body, link = _LINKED_HEADER_BYTES, data[_HEADER.size + len(_LINK_BEGIN) :]
        if len(data) < body or data[_HEADER.size : body - LINK_BYTES] != _LINK_BEGIN:
            return None
    if not body + _TRAILER.size < size <= MAX_MEMBER_BYTES:
        return None
    return _Header(wall_s, first_line, count, size, body, link)


def _begins_well(descriptor: int, body: int) -> bool:
    """False where deflate data is damaged at its begin: what claims to be large is not read."""
    piece = os.pread(descriptor, _TRIED_BYTES, body)
    try:
        zlib.decompressobj(_RAW_DEFLATE).decompress(piece, MAX_MEMBER_BYTES)
    except zlib.error:
        return False
    return True


def _inflated(body: bytes) -> bytes | None:
    """The lines of deflate data with its trailer; None where they are damaged."""
    inflate = zlib.decompressobj(_RAW_DEFLATE)
    try:
        data = inflate.decompress(body, MAX_MEMBER_BYTES)
    except zlib.error:
        return None
    if not inflate.eof or len(inflate.unused_data) != _TRAILER.size:
        return None
    crc, length = _TRAILER.unpack(inflate.unused_data)
    return data if (zlib.crc32(data), len(data) & _32_BITS) == (crc, length) else None


def _foreign_or_damaged(
    descriptor: int, offset: int, end: int, lines: int
) -> Member | MemberDamage:
    start = os.pread(descriptor, _HEADER.size, offset)
    if start.startswith(_GZIP) and start[_SIGNATURE_OFFSET:16] not in _SIGNATURES:
        inflate = zlib.decompressobj(_ANY_GZIP)
        read = _inflated_in_pieces(descriptor, offset, inflate)
        if read is not None:
            data, size = read
            return Member(offset, size, lines, data.count(b"\n"), 0, data)
    zeros = "zeros" if not start.strip(b"\0") else "bytes"
    return _damage(descriptor, offset, end, f"{zeros} that are no member")


def _inflated_in_pieces(
    descriptor: int, offset: int, inflate: "zlib._Decompress"
) -> tuple[bytes, int] | None:
    """Lines and size of a gzip member of unknown length; None where it is damaged."""
    pieces: list[bytes] = []
    room, place = MAX_MEMBER_BYTES, offset
    while not inflate.eof and room > 0:
        piece = os.pread(descriptor, _SEARCH_BYTES, place)
        try:
            pieces.append(inflate.decompress(inflate.unconsumed_tail + piece, room))
        except zlib.error:
            return None
        place, room = place + len(piece), room - len(pieces[-1])
        if not piece and not inflate.eof:
            return None
    size = place - offset - len(inflate.unused_data)
    return (b"".join(pieces), size) if inflate.eof else None


def _damage(descriptor: int, offset: int, end: int, what: str) -> MemberDamage:
    """From here to the next whole member of ours, or to the end of the file."""
    found = _next_member(descriptor, offset + 1, end)
    return MemberDamage(offset, found - offset, found == end, what)


def _next_member(descriptor: int, start: int, end: int) -> int:
    """Where the next member of ours begins; `end` where none does."""
    place = start
    while place < end:
        piece = os.pread(descriptor, _SEARCH_BYTES, place)
        found = piece.find(_MAGIC)
        while found >= 0:
            if _header(os.pread(descriptor, _LINKED_HEADER_BYTES, place + found)) is not None:
                return place + found
            found = piece.find(_MAGIC, found + 1)
        if len(piece) < _SEARCH_BYTES:
            break
        place += len(piece) - len(_MAGIC) + 1
    return end
