"""Forger of recordings, written from docs/recordings-format.md alone: one change, told in words.

forgery = forge(drive, seed)
forgery.what       "bit 3 of byte 811 of 0001.core.jsonl.gz"
forgery.is_anew    the whole chain was computed anew behind the change
"""

import gzip
import hashlib
import json
import random
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

BESIDE = ("drive.json", "config.yaml", "vcu.dbc")


class Forgery(NamedTuple):
    """What was done to a drive."""

    what: str
    is_anew: bool = False
    is_stripped: bool = False


class Piece(NamedTuple):
    """A member: file, its bytes, and its lines."""

    path: Path
    packed: bytes
    lines: bytes

    @property
    def link(self) -> bytes:
        return self.packed[36:68]


def pieces_of(path: Path) -> list[Piece]:
    """Members by the sizes that their headers say."""
    data, place, found = path.read_bytes(), 0, []
    while place < len(data):
        size = int.from_bytes(data[place + 24 : place + 28], "little")
        packed = data[place : place + size]
        found.append(Piece(path, packed, gzip.decompress(packed)))
        place += size
    return found


def in_order(drive: Path) -> list[Piece]:
    """All members of a whole drive in the order of writing."""
    waiting = {piece.link: piece for path in drive.glob("*.gz") for piece in pieces_of(path)}
    link, found = bytes(32), []
    while link in waiting:
        found.append(waiting.pop(link))
        link = hashlib.sha256(found[-1].packed).digest()
    return found


def member(lines: bytes, before: int, second: bytes, link: bytes | None) -> bytes:
    """A member as the page says; without a link as older recorders wrote."""
    deflate = zlib.compressobj(6, zlib.DEFLATED, -15)
    body = deflate.compress(lines) + deflate.flush()
    extra = b"" if link is None else b"VL\x20\x00" + link
    size = 32 + len(extra) + len(body) + 8
    header = b"\x1f\x8b\x08\x04" + second + b"\x00\xff" + struct.pack("<H", 20 + len(extra))
    header += b"VR\x10\x00" + struct.pack("<III", before, lines.count(b"\n"), size)
    header += struct.pack("<I", zlib.crc32(header))
    return header + extra + body + struct.pack("<II", zlib.crc32(lines), len(lines))


def written_anew(drive: Path, pieces: list[Piece], chained: bool = True) -> None:
    """Write every member again, each with the right link, count and checksums."""
    link, before = bytes(32), dict.fromkeys(drive.glob("*.gz"), 0)
    for path in before:
        path.write_bytes(b"")
    for piece in pieces:
        packed = member(
            piece.lines, before[piece.path], piece.packed[4:8], link if chained else None
        )
        with piece.path.open("ab") as file:
            file.write(packed)
        before[piece.path] += piece.lines.count(b"\n")
        link = hashlib.sha256(packed).digest()


def content(drive: Path) -> dict[str, bytes]:
    """What there is to read in a drive, whatever holds it; torn and damaged parts as they are."""
    found = {}
    for path in sorted(drive.iterdir()):
        data = path.read_bytes()
        try:
            found[path.name] = gzip.decompress(data) if path.suffix == ".gz" else data
        except (OSError, EOFError, zlib.error):
            found[path.name] = data
    return found


# Changes of bytes, by somebody who knows nothing of the format, or by a bad disk.


def flipped(drive: Path, rng: random.Random) -> Forgery:
    path, data, place = _some_byte(drive, rng)
    bit = rng.randrange(8)
    data[place] ^= 1 << bit
    path.write_bytes(data)
    return Forgery(f"bit {bit} of byte {place} of {path.name}")


def zeroed(drive: Path, rng: random.Random) -> Forgery:
    path, data, place = _some_byte(drive, rng)
    count = rng.choice((1, 16, 512))
    data[place : place + count] = bytes(len(data[place : place + count]))
    path.write_bytes(data)
    return Forgery(f"{count} zeros at byte {place} of {path.name}")


def cut(drive: Path, rng: random.Random) -> Forgery:
    path, data, place = _some_byte(drive, rng)
    end = rng.choice((len(data), min(len(data), place + rng.randrange(1, 400))))
    path.write_bytes(data[:place] + data[end:])
    return Forgery(f"bytes {place} to {end} of {path.name} cut out")


def inserted(drive: Path, rng: random.Random) -> Forgery:
    path, data, place = _some_byte(drive, rng)
    more = rng.randbytes(rng.randrange(1, 100))
    path.write_bytes(data[:place] + more + data[place:])
    return Forgery(f"{len(more)} bytes put in at {place} of {path.name}")


def _some_byte(drive: Path, rng: random.Random) -> tuple[Path, bytearray, int]:
    path = rng.choice(sorted(path for path in drive.iterdir() if path.stat().st_size))
    data = bytearray(path.read_bytes())
    return path, data, rng.randrange(len(data))


# Changes of pieces.


def removed(drive: Path, rng: random.Random) -> Forgery:
    path = rng.choice(sorted(drive.iterdir()))
    path.unlink()
    return Forgery(f"{path.name} removed")


def segment_removed(drive: Path, rng: random.Random) -> Forgery:
    number = rng.choice(sorted(path.name[:4] for path in drive.glob("*.gz")))
    for path in drive.glob(f"{number}.*.gz"):
        path.unlink()
    return Forgery(f"segment {number} removed")


def exchanged(drive: Path, rng: random.Random) -> Forgery:
    one, other = rng.sample(sorted(drive.iterdir()), 2)
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    return Forgery(f"{one.name} and {other.name} exchanged")


def member_moved(drive: Path, rng: random.Random) -> Forgery:
    path = rng.choice(sorted(drive.glob("*.gz")))
    pieces = [piece.packed for piece in pieces_of(path)]
    where = rng.randrange(len(pieces))
    what = rng.choice(("removed", "doubled", "moved"))
    taken = pieces.pop(where)
    if what == "doubled":
        pieces[where:where] = [taken, taken]
    if what == "moved":
        pieces.insert(rng.randrange(len(pieces) + 1), taken)
    path.write_bytes(b"".join(pieces))
    return Forgery(f"member {where} of {path.name} {what}")


def tail_removed(drive: Path, rng: random.Random) -> Forgery:
    pieces = in_order(drive)
    left = rng.randrange(1, len(pieces))
    for path in drive.glob("*.gz"):
        packed = [piece.packed for piece in pieces[:left] if piece.path == path]
        path.write_bytes(b"".join(packed)) if packed else path.unlink()
    return Forgery(f"the last {len(pieces) - left} members removed")


# Changes of what is said, with right checksums.

WORDS: tuple[tuple[str, str, str], ...] = (
    ("core", r'"ok": \[true', '"ok": [false'),
    ("core", r'"why": "active', '"why": "standby'),
    ("core", r'"0008A7D0", "00', '"0008A7D0", "01'),
    ("core", r'"tick": 1', '"tick": 2'),
    ("core", r'"checkpoint": {}', '"checkpoint": {"a": 1}'),
    ("core", r'"closes": true', '"closes": false'),
    ("frames", r"#00", "#01"),
    ("frames", r"\(17", "(16"),
    ("frames", r" T\n", " R\n"),
    ("frames", r"can0", "can1"),
)


def _said(drive: Path, rng: random.Random) -> tuple[str, list[Piece]]:
    """One word of one member changed."""
    pieces = in_order(drive)
    kind, before, after = rng.choice(WORDS)
    chosen = [
        (number, piece)
        for number, piece in enumerate(pieces)
        if kind in piece.path.name and re.search(before, piece.lines.decode())
    ]
    number, piece = rng.choice(chosen)
    places = list(re.finditer(before, piece.lines.decode()))
    place = rng.choice(places)
    text = piece.lines.decode()
    lines = (text[: place.start()] + after + text[place.end() :]).encode()
    pieces[number] = piece._replace(lines=lines)
    return f"{before} to {after} in member {number}, {piece.path.name}", pieces


def said(drive: Path, rng: random.Random) -> Forgery:
    what, pieces = _said(drive, rng)
    (number,) = (
        i for i, (one, two) in enumerate(zip(pieces, in_order(drive), strict=True)) if one != two
    )
    piece = pieces[number]
    own = pieces_of(piece.path)
    where = [one.packed for one in own].index(piece.packed)
    before = sum(one.lines.count(b"\n") for one in own[:where])
    packed = [one.packed for one in own]
    packed[where] = member(piece.lines, before, piece.packed[4:8], piece.link)
    piece.path.write_bytes(b"".join(packed))
    return Forgery(what)


def said_anew(drive: Path, rng: random.Random) -> Forgery:
    what, pieces = _said(drive, rng)
    written_anew(drive, pieces)
    return Forgery(f"{what}, and the chain made anew", is_anew=True)


def beside(drive: Path, rng: random.Random) -> Forgery:
    path = drive / rng.choice(BESIDE)
    path.write_bytes(path.read_bytes() + rng.choice((b"\n", b" ", b"\n# more\n")))
    return Forgery(f"{path.name} changed")


def beside_anew(drive: Path, rng: random.Random) -> Forgery:
    pieces, name = in_order(drive), beside(drive, rng).what.split()[0]
    digest = hashlib.sha256((drive / name).read_bytes()).hexdigest()
    pattern = rb'("' + re.escape(name.encode()) + rb'": ")[0-9a-f]{64}'
    changed = [
        piece._replace(lines=re.sub(pattern, rb"\g<1>" + digest.encode(), piece.lines))
        for piece in pieces
    ]
    written_anew(drive, changed)
    return Forgery(f"{name} changed, and the chain made anew", is_anew=True)


def stripped(drive: Path, rng: random.Random) -> Forgery:
    what, pieces = _said(drive, rng)
    kept = []
    for piece in pieces:
        lines = [json.loads(line) for line in piece.lines.splitlines()] if _is_core(piece) else []
        for line in lines:
            for key in ("segment", "files"):
                line.get("begin", {}).pop(key, None)
        text = "".join(json.dumps(line) + "\n" for line in lines).encode()
        kept.append(piece._replace(lines=text) if lines else piece)
    written_anew(drive, kept, chained=False)
    return Forgery(f"{what}, and the chain taken off", is_stripped=True)


def _is_core(piece: Piece) -> bool:
    return "core" in piece.path.name


KINDS: tuple[Callable[[Path, random.Random], Forgery], ...] = (
    flipped,
    zeroed,
    cut,
    inserted,
    removed,
    segment_removed,
    exchanged,
    member_moved,
    tail_removed,
    said,
    said_anew,
    beside,
    beside_anew,
    stripped,
)


def forge(drive: Path, seed: int) -> Forgery:
    """Change this drive as the seed says."""
    rng = random.Random(seed)
    return KINDS[seed % len(KINDS)](drive, rng)
