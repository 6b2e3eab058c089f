"""Line of each key and item of a document, so that an error can say where."""

from collections.abc import Sequence

Path = tuple[str | int, ...]


class LineMap:
    """Line of each key and item, by its path in the document."""

    def __init__(self) -> None:
        self._lines: dict[Path, int] = {}

    def add(self, path: Path, line: int) -> None:
        self._lines[path] = line

    def line(self, path: Sequence[str | int]) -> int | None:
        """The line of the longest known beginning of this path, or None."""
        known = tuple(path)
        while known and known not in self._lines:
            known = known[:-1]
        return self._lines.get(known)

    def where(self, file: str, path: Sequence[str | int]) -> str:
        """file:line, or the file alone where the line is not known."""
        line = self.line(path)
        return file if line is None else f"{file}:{line}"
