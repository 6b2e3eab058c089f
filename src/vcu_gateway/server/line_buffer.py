"""Line buffer: received bytes, cut into lines, from which a stop is taken before its turn."""

from vcu_gateway.server.stop_requests import MARKS

MAX_LINE_BYTES = 65_536
"""Longest line, without its newline."""


class LineBuffer:
    """Received bytes, cut into lines of bounded length, from which a stop is taken first.

    A stop leaves the lines that wait then, or wait unread in the socket, overtaken.
    """

    def __init__(self, max_line_bytes: int = MAX_LINE_BYTES) -> None:
        self._max_line_bytes = max_line_bytes
        self._buffer = bytearray()
        self._searched_bytes = 0
        self._newline_at = -1
        self._whole_bytes = 0
        self._marks_from = 0
        self._marked = range(0)
        self._overtaken_bytes = 0

    def __len__(self) -> int:
        return len(self._buffer)

    @property
    def has_line(self) -> bool:
        """True while a whole line of permitted length can be taken."""
        return 0 <= self._newline_at <= self._max_line_bytes

    @property
    def is_partial(self) -> bool:
        """True while a line has begun and not ended."""
        return self._newline_at < 0 and bool(self._buffer)

    @property
    def is_too_long(self) -> bool:
        """True from the moment the next line exceeds the length; it stays so."""
        end = self._newline_at if self._newline_at >= 0 else len(self._buffer)
        return end > self._max_line_bytes

    @property
    def is_overtaken(self) -> bool:
        """True where a stop has passed over the next line."""
        return self._overtaken_bytes > 0

    def overtake(self, unread_bytes: int) -> None:
        """Mark all that waits, and so many bytes that are not read yet."""
        self._overtaken_bytes = len(self._buffer) + unread_bytes

    def feed(self, chunk: bytes) -> None:
        newline_at = chunk.rfind(b"\n")
        if newline_at >= 0:
            self._whole_bytes = len(self._buffer) + newline_at + 1
        self._buffer += chunk
        self._search()

    def end(self) -> None:
        """End the stream: buffered bytes are the last line."""
        if len(self._buffer) > self._whole_bytes:
            self.feed(b"\n")

    def take(self) -> bytes:
        """Remove and return the next line without its newline; only while `has_line`."""
        return self._take(range(self._newline_at))

    def next_marked(self) -> bytes | None:
        """The next whole line that may name a stop, each once; None where none is left."""
        buffer, begin, end = self._buffer, self._marks_from, self._whole_bytes
        places = [at for mark in MARKS if (at := buffer.find(mark, begin, end)) >= 0]
        if not places:
            self._marks_from = end
            return None
        begin = buffer.rfind(b"\n", 0, min(places)) + 1
        self._marked = range(begin, buffer.find(b"\n", min(places)))
        self._marks_from = self._marked.stop + 1
        return bytes(buffer[begin : self._marked.stop])

    def take_marked(self) -> None:
        """Remove the line that `next_marked` returned last, before anything else is taken."""
        self._take(self._marked)

    def _take(self, place: range) -> bytes:
        line, taken = bytes(self._buffer[place.start : place.stop]), len(place) + 1
        del self._buffer[place.start : place.stop + 1]
        self._whole_bytes -= taken
        self._marks_from = max(0, self._marks_from - taken)
        self._overtaken_bytes = max(0, self._overtaken_bytes - taken)
        if place.start == 0:
            self._newline_at, self._searched_bytes = -1, 0
            self._search()
        return line

    def _search(self) -> None:
        if self._newline_at < 0:
            self._newline_at = self._buffer.find(b"\n", self._searched_bytes)
            self._searched_bytes = len(self._buffer)
