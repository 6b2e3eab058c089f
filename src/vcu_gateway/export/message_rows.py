"""Frames of one message as they were recorded: 16 bytes each, on the disk where they are many."""

import os
import tempfile
from array import array
from collections.abc import Iterator
from typing import IO, Any, NamedTuple

from vcu_gateway.core.codec import MessageCodec
from vcu_gateway.core.spec import FRAME_LENGTH_BYTES
from vcu_gateway.errors import Problem, UnavailableError

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
        return [self.payloads[at : at + FRAME_LENGTH_BYTES] for at in self._places]

    def decoded(self, message: MessageCodec, part: int) -> list[tuple[Any, ...]]:
        """Each frame's values (part 0) or raw codes (part 1), by signal."""
        decode, length, payloads = message.decode, FRAME_LENGTH_BYTES, self.payloads
        frames = [decode(payloads[at : at + length])[part] for at in self._places]
        return list(zip(*frames, strict=True))

    @property
    def _places(self) -> range:
        return range(0, len(self.payloads), FRAME_LENGTH_BYTES)


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
