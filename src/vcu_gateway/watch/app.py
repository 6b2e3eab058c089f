"""The view on a terminal: filled a few times a second, and its keys."""

import os
from collections.abc import Callable, Sequence
from typing import ClassVar

from rich.segment import Segment
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.color import Color
from textual.events import Resize
from textual.filter import LineFilter
from textual.widgets import Input, Static

from vcu_gateway.watch import keys
from vcu_gateway.watch.formatting import cell, line
from vcu_gateway.watch.layout import upper_lines
from vcu_gateway.watch.lines_widget import LinesWidget
from vcu_gateway.watch.signals import signal_lines
from vcu_gateway.watch.view_model import SourceRefusedError, ViewModel, ViewSource

REFRESH_HZ = 5.0
_TOLD_S = 6.0


class Colourless(LineFilter):
    """Takes every colour out; bold, dim and reverse stay."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """The same text without colour."""
        del background
        return [
            Segment(text, style.without_color if style else None, control)
            for text, style, control in segments
        ]


class WatchApp(App[None]):
    """One picture, again and again.

    Args:
        source: where the picture comes from.
        title: what is shown, for the first line.
        over: True when the view is to end by itself.
        refresh_hz: looks at the source a second.
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
        over: Callable[[], bool] = lambda: False,
        refresh_hz: float = REFRESH_HZ,
    ) -> None:
        super().__init__(ansi_color=True)
        self.animation_level = "none"
        self._source = source
        self._heading = title
        self._over = over
        self._refresh_s = 1 / refresh_hz
        self._picture = ViewModel()
        self._paused = False
        self._filter = ""
        self._asked = ""
        self._told = ""
        # Held here: at the end a timer may still fire when the screen has no widgets any more.
        self._upper, self._signals, self._keys = (
            LinesWidget("upper"),
            LinesWidget("signals"),
            LinesWidget("hints"),
        )
        self._find = Input(id="find", placeholder="part of a name; Enter keeps it, Esc ends it")
        self._help = Static(keys.HELP, id="help", markup=False)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """NO_COLOR means none at all, not shades of grey."""
        return [Colourless()] if os.environ.get("NO_COLOR") else []

    def compose(self) -> ComposeResult:
        """Help or page, the signals, and the line of keys or of the text to find."""
        yield from (self._help, self._upper, self._signals, self._keys, self._find)

    def on_mount(self) -> None:
        """Begin to look."""
        self.screen.set_focus(self._signals)
        self._forgetting = self.set_timer(_TOLD_S, self._forget)
        self.set_interval(self._refresh_s, self._look)
        self._look()

    def _look(self) -> None:
        if self._over():
            self.exit()
        elif self._paused:
            self._show_hints()
        else:
            self._picture = self._source.latest()
            self._show()

    def on_resize(self, event: Resize) -> None:
        """Lay everything out again."""
        del event
        self._show()

    def _show(self) -> None:
        width, height = self.size
        page = upper_lines(self._heading, self._picture, width, height, self._paused)
        old = self._picture.trouble is not None
        rows = signal_lines(self._picture.state, width, self._filter, old)
        self._upper.styles.height = len(page)
        self._upper.show(page)
        self._signals.show(rows)
        self._show_hints()

    def _show_hints(self) -> None:
        where = self._signals.where()
        room = self.size.width - len(where) - 1
        hints = line(cell(self._hints(), room), " ", where)
        self._keys.show([hints])

    def _hints(self) -> Text:
        if self._asked:
            return Text(keys.confirmation(self._asked), "bold reverse")
        if self._told:
            return Text(self._told, "bold")
        if self._filter:
            return Text(f"only {self._filter}: Esc shows all, m the next message, / find another")
        return Text(keys.HINTS, "dim")

    # Keys

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """While a text to find is written, most keys are letters of it."""
        del parameters
        if self._find.display:
            return action in ("quit", "keep", "leave")
        return action != "keep"

    def action_end(self) -> None:
        """Quit."""
        self.exit()

    def action_pause(self) -> None:
        """Let the picture stand still, or go on."""
        self._paused = not self._paused
        self._show()

    def action_step(self, step: int) -> None:
        """Show the next message alone; all of them after the last."""
        state = self._picture.state
        choices = ["", *(state["messages"] if state else ())]
        now = choices.index(self._filter) if self._filter in choices else 0
        self._show_only(choices[(now + step) % len(choices)])

    def _show_only(self, wanted: str) -> None:
        self._filter = wanted
        self._signals.scroll_home(animate=False)
        self._show()

    def action_find(self) -> None:
        """Ask for a text to find."""
        self._keys.display, self._find.display = False, True
        self._find.value = ""
        # At once: focus() comes after the next keys.
        self.screen.set_focus(self._find)

    def on_input_changed(self, event: Input.Changed) -> None:
        """Show what has it in its name while it is written."""
        self._show_only(event.value.strip())

    def action_keep(self) -> None:
        """Keep what was found."""
        self._keys.display, self._find.display = True, False
        self.screen.set_focus(self._signals)

    def action_leave(self) -> None:
        """End whatever was begun: question, help, finding, filter."""
        self._asked = self._told = ""
        self._show_help(False)
        self.action_keep()
        self._show_only("")

    def action_help(self) -> None:
        """Show what the keys do, or end that."""
        self._show_help(not self._help.display)

    def _show_help(self, shown: bool) -> None:
        self._help.display = shown
        self._upper.display = self._signals.display = not shown
        if not shown:
            self.screen.set_focus(self._signals)

    # Stopping

    def action_ask(self, what: str) -> None:
        """Ask before stopping: a key is pressed easily."""
        self._say("", asked=what)

    def action_confirm(self, what: str) -> None:
        """Stop, if that was asked for a moment ago."""
        if self._asked == what:
            self._say(f"{keys.NAMES[what]} ...")
            self.run_worker(lambda: self._stop(what), thread=True)

    def _stop(self, what: str) -> None:
        request = {"estop": self._source.estop, "disarm": self._source.disarm}[what]
        try:
            request()
        except SourceRefusedError as refusal:
            answer = f"{keys.NAMES[what]} not granted: {refusal}"
        else:
            answer = f"{keys.NAMES[what]} granted"
        self.call_from_thread(lambda: self._say(answer, self._asked))

    def _say(self, words: str, asked: str = "") -> None:
        self._told, self._asked = words, asked
        self._forgetting.stop()  # that of the words before
        self._forgetting = self.set_timer(_TOLD_S, self._forget)
        self._show_hints()

    def _forget(self) -> None:
        self._asked = self._told = ""
        self._show_hints()
