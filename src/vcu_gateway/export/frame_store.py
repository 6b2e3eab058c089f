"""Frames of a recording, sorted by message; whole blocks of candump lines at once.

Frames of one message as they were recorded: 16 bytes each, on the disk where they are many.
"""

import io
import os
import tempfile
from array import array
from collections.abc import Iterator
from typing import IO, Any, NamedTuple

from vcu_gateway.core.codec import Codec, MessageCodec, Reason
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.spec import FRAME_LENGTH_BYTES
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.recording import candump
from vcu_gateway.recording.candump import LineProblems, LineReader, RecordedFrame
from vcu_gateway.recording.decoded import Summary
from vcu_gateway.time_window import Window

_STAMP_BYTES = 8
CHUNK_ROWS = 1 << 16
"""Rows that are held in memory at once."""


class RowChunk(NamedTuple):
    """Some frames of one message, in the recording's order.

    Attributes:
        times_ns: the recording's stamps.
        payloads: eight bytes a frame, joined.
    """

    times_ns: "array[int]"
    payloads: bytes

    def frames(self) -> list[bytes]:
        places = range(0, len(self.payloads), FRAME_LENGTH_BYTES)
        return [self.payloads[at : at + FRAME_LENGTH_BYTES] for at in places]

    def decoded(self, message: MessageCodec, part: int) -> list[tuple[Any, ...]]:
        """Each frame's values (part 0) or raw codes (part 1), by signal."""
        decode = message.decode
        return list(zip(*[decode(frame)[part] for frame in self.frames()], strict=True))


class MessageRows:
    """Every frame of one message; beyond 65,536 they wait in an unnamed file.

    Attributes:
        count: frames so far.
        first_ns, last_ns: stamps of the first and the last of them; None without.
    """

    def __init__(self, message: MessageCodec) -> None:
        self.message = message
        self.count = 0
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self._times_ns = array("q")
        self._payloads = bytearray()
        self._spilled: IO[bytes] | None = None
        self._chunks: list[int] = []

    def add(self, times_ns: list[int], payloads: bytes) -> None:
        """Take in one frame or more, eight bytes of payload each."""
        if self.first_ns is None:
            self.first_ns = times_ns[0]
        self.last_ns = times_ns[-1]
        self._times_ns.extend(times_ns)
        self._payloads += payloads
        self.count += len(times_ns)
        if len(self._times_ns) >= CHUNK_ROWS:
            self._spill()

    def _spill(self) -> None:
        try:
            if self._spilled is None:
                self._spilled = tempfile.TemporaryFile()  # noqa: SIM115 - close() does
            self._spilled.write(self._times_ns.tobytes())
            self._spilled.write(self._payloads)
            self._spilled.flush()
        except OSError as error:
            what = f"frames cannot wait here: {error.strerror or error}"
            remedy = "set TMPDIR to a folder with room, 16 bytes for each frame"
            raise UnavailableError(Problem(what, tempfile.gettempdir(), remedy)) from error
        self._chunks.append(len(self._times_ns))
        self._times_ns = array("q")
        self._payloads.clear()

    def chunks(self) -> Iterator[RowChunk]:
        if self._spilled is not None:
            handle, place = self._spilled.fileno(), 0
            for rows in self._chunks:  # several readers may be at different places
                times_ns = array("q", os.pread(handle, rows * _STAMP_BYTES, place))
                place += rows * _STAMP_BYTES
                yield RowChunk(times_ns, os.pread(handle, rows * FRAME_LENGTH_BYTES, place))
                place += rows * FRAME_LENGTH_BYTES
        if self._times_ns:
            yield RowChunk(self._times_ns, bytes(self._payloads))

    def close(self) -> None:
        if self._spilled is not None:
            self._spilled.close()


_KEPT_IDENTIFIERS = 4096


class FrameStore:
    """Every decodable frame inside the window, by message.

    Attributes:
        rows: by message name, of every message of the protocol.
        summary: what became of the frames.
        channel: the first frame's.
    """

    def __init__(self, codec: Codec, window: Window) -> None:
        self.rows = {name: MessageRows(one) for name, one in codec.by_name.items()}
        self.summary = Summary()
        self.channel: str | None = None
        self._begun = False
        self._codec = codec
        self._window = window
        self._pending: dict[bytes, _Entry] = {}

    def close(self) -> None:
        for rows in self.rows.values():
            rows.close()

    def add(self, recorded: RecordedFrame) -> None:
        frame = recorded.frame
        self._begin(frame.arrival_ns, recorded.channel)
        found = self._codec.find(frame)
        if not self._window.holds(frame.arrival_ns):
            self.summary.passed_over += 1
        elif isinstance(found, Reason):
            self.summary.reject(found, frame.can_id)
        elif recorded.fd:
            self.summary.reject_fd()
        else:
            self._keep(self.rows[found.spec.name], [frame.arrival_ns], bytes(frame.data))

    def _keep(self, rows: MessageRows, times_ns: list[int], payloads: bytes) -> None:
        self.summary.decoded[rows.message.spec.name] += len(times_ns)
        rows.add(times_ns, payloads)

    def _begin(self, stamp_ns: int, channel: str | None) -> None:
        if not self._begun:
            self._begun, self.channel = True, channel
            self._window.bounds_ns(stamp_ns)

    def add_lines(self, text: bytes, first_line: int, problems: LineProblems) -> None:
        """Take in whole lines of candump text; `first_line` stand before them."""
        quick = candump.quick_lines(text)
        if quick is not None:
            if quick[0]:
                self._add_matches(*quick)
            return
        reader = LineReader(io.StringIO(text.decode("utf-8", "replace")))
        reader.number = first_line
        for recorded in candump.frames(reader, problems):
            self.add(recorded)

    def _add_matches(self, found: list[tuple[bytes, ...]], factor: int) -> None:
        stamps = [int(match[0] + match[1]) * factor for match in found]
        self._begin(stamps[0], found[0][2].decode("utf-8", "replace"))
        if not self._window.open:
            kept = [i for i, stamp in enumerate(stamps) if self._window.holds(stamp)]
            self.summary.passed_over += len(found) - len(kept)
            found, stamps = [found[i] for i in kept], [stamps[i] for i in kept]
        pending = self._pending
        for stamp, match in zip(stamps, found, strict=True):
            entry = pending.get(match[3]) or self._entry(match[3])
            entry.times_ns.append(stamp)
            entry.data.append(match[4])
        self._take_pending()

    def _entry(self, identifier: bytes) -> "_Entry":
        frame = Frame(int(identifier, 16), bytes(FRAME_LENGTH_BYTES), 0)
        entry = self._pending[identifier] = _Entry(frame.can_id, self._codec.find(frame), [], [])
        return entry

    def _take_pending(self) -> None:
        for entry in self._pending.values():
            if isinstance(entry.found, Reason):
                for _ in entry.times_ns:
                    self.summary.reject(entry.found, entry.can_id)
            elif entry.times_ns:
                payloads = bytes.fromhex(b"".join(entry.data).decode())
                self._keep(self.rows[entry.found.spec.name], entry.times_ns, payloads)
            entry.times_ns.clear()
            entry.data.clear()
        if len(self._pending) > _KEPT_IDENTIFIERS:
            self._pending.clear()


class _Entry(NamedTuple):
    """Frames of one identifier in the block that is being read."""

    can_id: int
    found: MessageCodec | Reason
    times_ns: list[int]
    data: list[bytes]
