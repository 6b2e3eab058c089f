"""Datagrams of the tap: what the gateway hands to the recorder, one a tick.

All integers are little endian. A connection begins with HELLO, one JSON object in one or more
parts, and goes on with ticks:

    HELLO  kind 1, format, last part (0 or 1)   3 bytes
           a part of the JSON text, UTF-8
    TICK   kind 2, format, zero                 3 bytes
           sequence, frames, datagrams lost, frames lost   4 x 64 bits
           frames here                          32 bits
           the frames                           14 bytes and the payload each
           core lines, UTF-8, each with its line end
    frame  arrival, ns (signed)                 64 bits
           identifier with Linux's flags        32 bits
           1: echo of an own frame; length      2 bytes

After a tick that may be urgent comes a connection that is empty: the recorder waits no longer.

`sequence` numbers the ticks' datagrams of a gateway from 1, lost ones counted; `frames` is how many
frames it handed on up to the end of this datagram, `frames lost` how many of them in lost ones.
"""

import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

FORMAT = 1
HELLO, TICK = 1, 2

PART_BYTES = 64_000
"""Of a HELLO in one datagram, at most; a socket's send buffer takes three times as much."""

MOST_HELLO_BYTES = 512 << 10
"""Of a whole HELLO; more is no gateway's."""

EXTENDED = 0x8000_0000
REMOTE = 0x4000_0000
ERROR = 0x2000_0000
"""Flags of an identifier, as Linux has them (CAN_EFF_FLAG, CAN_RTR_FLAG, CAN_ERR_FLAG)."""

ID_MASK = 0x1FFF_FFFF

_PREFIX = struct.Struct("<BBB")
_HEADER = struct.Struct("<BBBQQQQI")
_TICK_PREFIX = _PREFIX.pack(TICK, FORMAT, 0)
_FRAME = struct.Struct("<qIBB")
CLASSIC = struct.Struct("<qIBB8s")
"""Record of a frame with eight bytes: arrival, identifier, echo, 8, payload."""
_EIGHT = b"\x08"
_ECHO_AT, _LENGTH_AT = 12, 13
_TRUTH = b"\0\1"
_LONGEST_PAYLOAD_BYTES = 64
_CHECKPOINT = b'{"checkpoint":'
_URGENT = (b'"events":', b'"mode":', b'"estop":', b'"restarted":')


class CoreLineError(ValueError):
    """A core line is not one of this format; the text says why."""


class DatagramError(ValueError):
    """A datagram is not one of this format; the text says why.

    Attributes:
        kind: word for like ones, to count by.
    """

    def __init__(self, what: str, kind: str = "datagram") -> None:
        super().__init__(what)
        self.kind = kind


class FrameRecord(NamedTuple):
    """One frame of a datagram.

    Attributes:
        arrival_ns: on the monotonic clock of the gateway's machine.
        can_id: identifier with Linux's flags.
        own_echo: the gateway's own frame, come back because it has left.
    """

    arrival_ns: int
    can_id: int
    own_echo: bool
    data: bytes


class TickHeader(NamedTuple):
    """Numbers of a tick's datagram, since the start of the gateway's process.

    Attributes:
        sequence: number of the datagram, from 1; lost ones have one too.
        frames: handed on up to the end of this datagram, lost ones counted.
        datagrams_lost, frames_lost: that no datagram brought.
    """

    sequence: int
    frames: int
    datagrams_lost: int
    frames_lost: int


class HelloPart(NamedTuple):
    """A part of the JSON text that begins a connection."""

    last: bool
    text: bytes


class TickParts(NamedTuple):
    """Frames of one tick, still packed, and its core lines: UTF-8, each with its end, or none."""

    header: TickHeader
    frame_count: int
    frames: bytes
    lines: bytes

    @property
    def begins_segment(self) -> bool:
        """True where the state of the core comes first: what follows can be read by itself."""
        return self.lines.startswith(_CHECKPOINT)


def packed_frame(arrival_ns: int, can_id: int, own_echo: bool, data: bytes | bytearray) -> bytes:
    """One frame; `can_id` has Linux's flags."""
    return _FRAME.pack(arrival_ns, can_id, own_echo, len(data)) + data


def packed_tick(header: TickHeader, frames: Iterable[bytes], lines: str) -> bytes:
    """A tick's datagram of packed frames and finished core lines."""
    packed = list(frames)
    begin = _HEADER.pack(TICK, FORMAT, 0, *header, len(packed))
    return b"".join((begin, *packed, lines.encode()))


def packed_hello(hello: Mapping[str, Any]) -> Iterator[bytes]:
    text = json.dumps(hello, separators=(",", ":")).encode()
    for start in range(0, len(text), PART_BYTES):
        last = start + PART_BYTES >= len(text)
        yield _PREFIX.pack(HELLO, FORMAT, last) + text[start : start + PART_BYTES]


def unpack(datagram: bytes) -> HelloPart | TickParts:
    """What a datagram holds; DatagramError where it is damaged or of another format."""
    if len(datagram) < _PREFIX.size:
        raise DatagramError(f"a datagram of {len(datagram)} bytes is too short")
    kind, number, last = _PREFIX.unpack_from(datagram)
    if number != FORMAT:
        raise DatagramError(f"the format is {number}, and this version reads {FORMAT}")
    if kind == HELLO and last in (0, 1):
        return HelloPart(bool(last), datagram[_PREFIX.size :])
    if kind == TICK and last == 0:
        return tick_parts(datagram)
    raise DatagramError(f"kind {kind} with {last} is neither a HELLO nor a tick")


def tick_parts(datagram: bytes) -> TickParts:
    """A tick's datagram with its frames as they are; DatagramError as `unpack`."""
    if not datagram.startswith(_TICK_PREFIX):
        raise DatagramError("it is no tick of this format")
    if len(datagram) < _HEADER.size:
        raise DatagramError(f"a tick of {len(datagram)} bytes is too short")
    *numbers, count = _HEADER.unpack_from(datagram)[_PREFIX.size :]
    end = _end_of_frames(datagram, count)
    lines = datagram[end:]
    if lines and not lines.endswith(b"\n"):
        raise DatagramError("the last core line has no end")
    return TickParts(TickHeader(*numbers), count, datagram[_HEADER.size : end], lines)


def _end_of_frames(datagram: bytes, count: int) -> int:
    """Where the frames end; quick where each has eight bytes, as nearly all do."""
    end = _HEADER.size + count * CLASSIC.size
    lengths = datagram[_HEADER.size + _LENGTH_AT : end : CLASSIC.size]
    echoes = datagram[_HEADER.size + _ECHO_AT : end : CLASSIC.size]
    if end <= len(datagram) and lengths == _EIGHT * count and not echoes.translate(None, _TRUTH):
        return end
    place = _HEADER.size
    for number in range(1, count + 1):
        if place + _FRAME.size > len(datagram):
            raise DatagramError(f"it ends in frame {number} of {count}")
        length, own_echo = datagram[place + _LENGTH_AT], datagram[place + _ECHO_AT]
        place += _FRAME.size + length
        if place > len(datagram) or length > _LONGEST_PAYLOAD_BYTES or own_echo not in _TRUTH:
            raise DatagramError(f"frame {number} of {count} is damaged")
    return place


def frame_records(packed: bytes) -> Iterator[FrameRecord]:
    place = 0
    while place < len(packed):
        arrival_ns, can_id, own_echo, length = _FRAME.unpack_from(packed, place)
        data_at = place + _FRAME.size
        place = data_at + length
        yield FrameRecord(arrival_ns, can_id, own_echo != 0, packed[data_at:place])


def may_be_urgent(lines: bytes) -> bool:
    """False where no core line in these bytes needs to be on the disk at once; seldom wrong."""
    return any(word in lines for word in _URGENT)


class HelloText:
    """JSON object of a HELLO, gathered from its parts."""

    def __init__(self) -> None:
        self._text = bytearray()

    @property
    def size(self) -> int:
        return len(self._text)

    def take(self, part: HelloPart) -> Mapping[str, Any] | None:
        """Take a part; the object with the last one, else None. DatagramError where it is none."""
        if self.size + len(part.text) > MOST_HELLO_BYTES:
            raise DatagramError(f"a HELLO of more than {MOST_HELLO_BYTES} bytes", "hello")
        self._text += part.text
        if not part.last:
            return None
        text, self._text = self._text, bytearray()
        try:
            hello = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise DatagramError(f"the HELLO is no JSON: {str(error)[:100]}", "hello") from error
        if not isinstance(hello, dict) or hello.get("format") != FORMAT:
            raise DatagramError("the HELLO has no format that this version reads", "hello")
        return hello
