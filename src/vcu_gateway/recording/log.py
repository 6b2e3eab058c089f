"""Recording of any format, opened by its name."""

import codecs
import contextlib
import gzip
import importlib.util
import io
import os
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import PurePath
from typing import IO, cast

from vcu_gateway.errors import MissingInputError, Problem, UnavailableError
from vcu_gateway.recording import candump
from vcu_gateway.recording.candump import LineProblems, LineReader, RecordedFrame
from vcu_gateway.text import Progress

STANDARD_INPUT = "-"
"""The name that stands for candump text on standard input."""

_CANDUMP = ".log"


class Recording:
    """One recording, read once from beginning to end; live, while frames may still come.

    Its size is as it is stored, and 0 where it is not known. Of candump text it has blocks, too.
    """

    def __init__(
        self,
        name: str,
        stored: IO[bytes],
        suffix: str,
        packed: bool,
        report: Callable[[Problem], None],
        *,
        live: bool = False,
    ) -> None:
        self.name = name
        self.size_bytes = 0 if live else os.fstat(stored.fileno()).st_size
        self.live = live
        self._stored = stored
        self._plain = cast(IO[bytes], gzip.GzipFile(fileobj=stored)) if packed else stored
        self._suffix = suffix
        self._lines: LineReader | None = None
        is_text = self.is_candump = suffix == _CANDUMP
        if not is_text:
            from vcu_gateway.recording import formats

            is_text = suffix in formats.TEXT
        if is_text:
            # Bytes that are no text make their line a damaged one, not the file unreadable.
            text = io.TextIOWrapper(self._plain, encoding="utf-8-sig", errors="replace")
            self._lines = LineReader(text)
        between = ":" if self._lines else ", frame "
        self.problems = LineProblems(lambda position: f"{name}{between}{position}", report)

    def __iter__(self) -> Iterator[RecordedFrame]:
        lines = self._lines
        if lines is not None and self.is_candump:
            try:
                yield from candump.frames(lines, self.problems)
            except (OSError, EOFError, zlib.error) as error:
                raise self.problems.failure(lines.number, error) from error
            return
        from vcu_gateway.recording import formats

        content: formats.Content = self._plain if self._suffix in formats.BINARY else self.name
        yield from formats.frames(self._suffix, lines or content, self.problems)

    def watched(self, progress: Progress) -> Iterable[RecordedFrame]:
        """The frames, with a line of progress where a person waits for a file."""
        if self.live:
            return self
        return progress.over(self, lambda count: progress.show_frames(self.share_read(), count))

    def blocks(self, size_bytes: int) -> Iterator[tuple[int, bytes]]:
        """Whole lines of candump text, and how many stand before them.

        Instead of iterating: either gives the recording once. A line that is longer than a block
        comes in pieces.
        """
        lines, rest = 0, b""
        while block := self._block(size_bytes, lines):
            text = rest + block
            if not lines:
                text = text.removeprefix(codecs.BOM_UTF8)
            end = text.rfind(b"\n") + 1 or len(text)
            yield lines, text[:end]
            lines, rest = lines + text.count(b"\n", 0, end), text[end:]
        if rest:
            yield lines, rest

    def _block(self, size_bytes: int, lines: int) -> bytes:
        try:
            return self._plain.read(size_bytes)
        except (OSError, EOFError, zlib.error) as error:
            raise self.problems.failure(lines, error) from error

    def share_read(self) -> float | None:
        """How much of the file was read, 0..1; None where nobody knows."""
        if not self.size_bytes or self._stored.closed:
            return None
        return min(1.0, self._stored.tell() / self.size_bytes)


@contextlib.contextmanager
def open_recording(name: str, report: Callable[[Problem], None]) -> Iterator[Recording]:
    """Open a recording, for `with`; `report` is given every complaint that is worth telling.

    Raises MissingInputError where it cannot be read or nobody knows its format,
    UnavailableError where that format needs a package that is not installed. Iterating
    raises DataError where the contents are damaged beyond reading on.
    """
    if name == STANDARD_INPUT:
        if sys.stdin is None:  # closed by who started this program
            raise MissingInputError(Problem("is closed", "standard input"))
        yield Recording("standard input", sys.stdin.buffer, _CANDUMP, False, report, live=True)
        return
    path = PurePath(name)
    packed = path.suffix.lower() == ".gz"
    suffix = PurePath(path.stem if packed else path).suffix.lower()
    try:
        stored = open(name, "rb")  # noqa: PTH123, SIM115 - as it was named; closed below
    except OSError as error:
        problem = Problem(f"cannot be read: {error.strerror or error}", name)
        raise MissingInputError(problem) from error
    with stored:
        _check_format(name, suffix, packed)
        yield Recording(name, stored, suffix, packed, report)


def _check_format(name: str, suffix: str, packed: bool) -> None:
    if suffix == _CANDUMP:
        return
    from vcu_gateway.recording import formats

    if suffix not in formats.SUFFIXES:
        what = f"{suffix} is no known format" if suffix else "has no suffix to tell its format"
        known = ", ".join(formats.SUFFIXES)
        remedy = f"known are {known}, and most of them with .gz; candump text is .log"
        raise MissingInputError(Problem(what, name, remedy))
    if packed and suffix not in (*formats.TEXT, *formats.BINARY):
        raise MissingInputError(Problem(f"{suffix} cannot be read packed", name, "gunzip it first"))
    if suffix == ".mf4" and importlib.util.find_spec("asammdf") is None:
        remedy = "pip install 'vcu-gateway[mf4]'"
        raise UnavailableError(Problem("reading .mf4 needs the package asammdf", name, remedy))
