"""Scrollable widget of styled lines; only changed lines are redrawn."""

from collections.abc import Sequence

from rich.text import Text
from textual.geometry import Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from vcu_gateway.watch.formatting import line


class LinesWidget(ScrollView):
    """Shows lines of text; scrolls where there are more than fit."""

    DEFAULT_CSS = "LinesWidget { scrollbar-size: 0 0; }"

    def __init__(self, name: str) -> None:
        super().__init__(id=name)
        self._lines: list[Text] = []

    def show(self, lines: Sequence[Text]) -> None:
        # As spans: Rich forgets the style of a whole text, in comparing and in drawing.
        before, self._lines = self._lines, [line(text) for text in lines]
        self.virtual_size = Size(self.size.width, len(lines))
        for row in range(max(len(before), len(lines))):
            if before[row : row + 1] != self._lines[row : row + 1]:
                self.refresh_line(row)

    def position(self) -> str:
        """Range of the visible lines as `1-20/80`; empty where all are visible."""
        count, top, height = len(self._lines), round(self.scroll_y), self.size.height
        return f"{top + 1}-{min(top + height, count)}/{count}" if count > height > 0 else ""

    def render_line(self, y: int) -> Strip:
        width, row = self.size.width, y + round(self.scroll_y)
        if row >= len(self._lines):
            return Strip.blank(width)
        return Strip(self._lines[row].render(self.app.console)).adjust_cell_length(width)
