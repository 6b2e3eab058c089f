"""Bytes of a stream, cut into lines of bounded length."""

MAX_LINE_BYTES = 65_536
"""The longest line, without its newline."""


class LineBuffer:
    """What was received and not yet taken; it holds one chunk more than a line at most."""

    def __init__(self, max_line_bytes: int = MAX_LINE_BYTES) -> None:
        self._max_line_bytes = max_line_bytes
        self._buffer = bytearray()
        self._searched_bytes = 0
        self._newline_at = -1

    def __len__(self) -> int:
        return len(self._buffer)

    @property
    def has_line(self) -> bool:
        """True while a whole line of permitted length can be taken."""
        return 0 <= self._newline_at <= self._max_line_bytes

    @property
    def is_partial(self) -> bool:
        """True while the beginning of a line waits for its end."""
        return self._newline_at < 0 and bool(self._buffer)

    @property
    def is_too_long(self) -> bool:
        """True from the moment the next line cannot be taken any more; it stays so."""
        end = self._newline_at if self._newline_at >= 0 else len(self._buffer)
        return end > self._max_line_bytes

    def feed(self, chunk: bytes) -> None:
        """Add what was received."""
        self._buffer += chunk
        self._search()

    def end(self) -> None:
        """Nothing follows: what is there is the last line."""
        if self.is_partial:
            self.feed(b"\n")

    def take(self) -> bytes:
        """The next line without its newline; only while `has_line`."""
        line = bytes(self._buffer[: self._newline_at])
        del self._buffer[: self._newline_at + 1]
        self._newline_at, self._searched_bytes = -1, 0
        self._search()
        return line

    def _search(self) -> None:
        if self._newline_at < 0:
            self._newline_at = self._buffer.find(b"\n", self._searched_bytes)
            self._searched_bytes = len(self._buffer)
