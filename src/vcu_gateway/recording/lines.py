"""Reader of text lines that counts them and bounds their length."""

from collections.abc import Iterator
from functools import partial
from typing import TextIO

_LONGEST_CHARACTERS = 8192


class LineReader:
    """Iterator over the lines of a text file, with the number of the current one.

    Of a line beyond 8192 characters only the beginning is given, so that a file without
    line ends cannot fill the memory.

    Attributes:
        number: of the latest line, from 1; 0 before the first.
    """

    def __init__(self, file: TextIO) -> None:
        self.number = 0
        self._file = file
        self._pieces = self._walk()

    def __iter__(self) -> Iterator[str]:
        return self._pieces

    def __next__(self) -> str:
        return next(self._pieces)

    def close(self) -> None:
        self._file.close()

    def _walk(self) -> Iterator[str]:
        at_start = True
        for piece in iter(partial(self._file.readline, _LONGEST_CHARACTERS), ""):
            if at_start:
                self.number += 1
                yield piece
            at_start = piece.endswith("\n")
