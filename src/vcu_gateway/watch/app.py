"""Textual app of the live view: refresh, keys, emergency stop and disarm."""

import os
from collections.abc import Callable, Sequence
from typing import ClassVar

from rich.segment import Segment
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.color import Color
from textual.filter import LineFilter
from textual.geometry import Size
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widgets import Input, Static

from vcu_gateway.client import ClientError
from vcu_gateway.watch.figures import cell, line
from vcu_gateway.watch.layout import upper_lines
from vcu_gateway.watch.signals import signal_lines
from vcu_gateway.watch.source import ViewModel, ViewSource

REFRESH_HZ = 5.0
_NOTICE_S = 6.0
HINTS = "q quit  space pause  m message  / find  e stop  d disarm  ? help"
NAMES = {"estop": "emergency stop", "disarm": "disarming"}
_QUESTIONS = {
    "estop": "Emergency stop: cut the power of both controllers? Shift-E yes, Esc no",
    "disarm": "Disarm: from active to standby? Shift-D yes, Esc no",
}
HELP = """\
Keys
  q, Ctrl-C       quit; the gateway goes on
  up, down        scroll the signals by a line; PgUp, PgDn by a page
  Home, End       to either end of them
  space, p        freeze the view, and resume
  m, M            only the next message, the one before; all of them at the end
  /               find a part of a name: Enter keeps it, Esc shows all again
  e then E        emergency stop: cuts the power of both controllers
  d then D        disarm: from active to standby
  ?, h            this page, and back

Words
  commanded       what the gateway sent to a controller
  reported        what the controller sends back
  max             a commanded limit
  temp            of the controller / of the motor
  !               the value is not good; the list of signals says why
  good            valid; out of range, saturated, stale and never are not
  foreign         command frames of another sender
  late ms         lateness of the 50 ms ticks: median, 99th percentile, maximum
  old             the gateway is not reachable; these are its last values
"""


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


class Colourless(LineFilter):
    """Line filter for NO_COLOR: removes colours; bold, dim and reverse stay."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        del background
        return [
            Segment(text, style.without_color if style else None, control)
            for text, style, control in segments
        ]


class WatchApp(App[None]):
    """Live view of one source.

    Args:
        source: polled `refresh_hz` times a second.
        title: name of the program, for the first line.
        finished: True once the view is to end by itself.
        refresh_hz: refreshes a second.
        notes: lines below the title.
    """

    ENABLE_COMMAND_PALETTE = False
    ALLOW_SELECT = False
    CSS = """
    * { background: ansi_default; color: ansi_default; }
    #signals { height: 1fr; }
    #help { height: auto; }
    #hints, #find { dock: bottom; height: 1; border: none; padding: 0; }
    #find, #help { display: none; }
    """
    # With priority: the keys are handled in the order in which they come, also fast ones.
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(key, action, priority=True)
        for key, action in (
            ("ctrl+c,ctrl+q", "quit"),
            ("q", "end"),
            ("space,p", "pause"),
            ("m", "step(1)"),
            ("M", "step(-1)"),
            ("slash", "find"),
            ("enter", "keep"),
            ("escape", "leave"),
            ("question_mark,h", "help"),
            ("e", "ask('estop')"),
            ("E", "confirm('estop')"),
            ("d", "ask('disarm')"),
            ("D", "confirm('disarm')"),
        )
    ]

    def __init__(
        self,
        source: ViewSource,
        title: str = "vcu-gateway",
        finished: Callable[[], bool] = lambda: False,
        refresh_hz: float = REFRESH_HZ,
        notes: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        super().__init__(ansi_color=True)
        self.animation_level = "none"
        self._source = source
        self._program_title = title
        self._finished = finished
        self._refresh_s = 1 / refresh_hz
        self._notes = notes
        self._view = ViewModel()
        self._paused = False
        self._filter = ""
        self._pending = ""
        self._notice = ""
        # Held here: at the end a timer may still fire when the screen has no widgets any more.
        self._upper, self._signals = LinesWidget("upper"), LinesWidget("signals")
        self._keys = LinesWidget("hints")
        self._find = Input(id="find", placeholder="part of a name; Enter keeps it, Esc ends it")
        self._help = Static(HELP, id="help", markup=False)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """NO_COLOR means none at all, not shades of grey."""
        return [Colourless()] if os.environ.get("NO_COLOR") else []

    def compose(self) -> ComposeResult:
        yield from (self._help, self._upper, self._signals, self._keys, self._find)

    def on_mount(self) -> None:
        self.screen.set_focus(self._signals)
        self._notice_timer = self.set_timer(_NOTICE_S, self._clear_notice)
        self.set_interval(self._refresh_s, self._refresh_view)
        self._refresh_view()

    def _refresh_view(self) -> None:
        if self._finished():
            self.exit()
        elif self._paused:
            self._show_hints()
        else:
            self._view = self._source.latest()
            self._show()

    def on_resize(self) -> None:
        self._show()

    def _show(self) -> None:
        width, height = self.size
        upper = upper_lines(self._program_title, self._view, width, height, self._paused)
        upper[1:1] = [cell(note, width) for note in self._notes()]
        old = self._view.problem is not None
        rows = signal_lines(self._view.state, width, self._filter, old)
        self._upper.styles.height = len(upper)
        self._upper.show(upper)
        self._signals.show(rows)
        self._show_hints()

    def _show_hints(self) -> None:
        position = self._signals.position()
        room = self.size.width - len(position) - 1
        hints = line(cell(self._hints(), room), " ", position)
        self._keys.show([hints])

    def _hints(self) -> Text:
        if self._pending:
            return Text(_QUESTIONS[self._pending], "bold reverse")
        if self._notice:
            return Text(self._notice, "bold")
        if self._filter:
            return Text(f"only {self._filter}: Esc shows all, m the next message, / find another")
        return Text(HINTS, "dim")

    # Keys

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """While a search text is typed, most keys are letters of it."""
        del parameters
        if self._find.display:
            return action in ("quit", "keep", "leave")
        return action != "keep"

    def action_end(self) -> None:
        self.exit()

    def action_pause(self) -> None:
        self._paused = not self._paused
        self._show()

    def action_step(self, step: int) -> None:
        """Show the next message alone; all of them after the last."""
        state = self._view.state
        choices = ["", *(state["messages"] if state else ())]
        now = choices.index(self._filter) if self._filter in choices else 0
        self._set_filter(choices[(now + step) % len(choices)])

    def _set_filter(self, text: str) -> None:
        self._filter = text
        self._signals.scroll_home(animate=False)
        self._show()

    def action_find(self) -> None:
        self._keys.display, self._find.display = False, True
        self._find.value = ""
        # At once: focus() comes after the next keys.
        self.screen.set_focus(self._find)

    def on_input_changed(self, event: Input.Changed) -> None:
        self._set_filter(event.value.strip())

    def action_keep(self) -> None:
        self._keys.display, self._find.display = True, False
        self.screen.set_focus(self._signals)

    def action_leave(self) -> None:
        self._pending = self._notice = ""
        self._show_help(False)
        self.action_keep()
        self._set_filter("")

    def action_help(self) -> None:
        self._show_help(not self._help.display)

    def _show_help(self, shown: bool) -> None:
        self._help.display = shown
        self._upper.display = self._signals.display = not shown
        if not shown:
            self.screen.set_focus(self._signals)

    # Stopping

    def action_ask(self, what: str) -> None:
        self._show_notice("", pending=what)

    def action_confirm(self, what: str) -> None:
        if self._pending == what:
            self._show_notice(f"{NAMES[what]} ...")
            self.run_worker(lambda: self._send_request(what), thread=True)

    def _send_request(self, what: str) -> None:
        try:
            self._source.request(what)
        except ClientError as refusal:
            answer = f"{NAMES[what]} not granted: {refusal}"
        else:
            answer = f"{NAMES[what]} granted"
        self.call_from_thread(lambda: self._show_notice(answer, self._pending))

    def _show_notice(self, notice: str, pending: str = "") -> None:
        self._notice, self._pending = notice, pending
        self._notice_timer.stop()  # of the notice before
        self._notice_timer = self.set_timer(_NOTICE_S, self._clear_notice)
        self._show_hints()

    def _clear_notice(self) -> None:
        self._pending = self._notice = ""
        self._show_hints()
