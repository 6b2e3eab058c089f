"""View model as plain text, for a pipe or a file."""

from collections.abc import Iterator

from rich.text import Text

from vcu_gateway.api.results import Message, Signal, State
from vcu_gateway.watch import bus, controllers, header, reasons
from vcu_gateway.watch.formatting import ABSENT, marked, number, rate_text, value_text, wrapped
from vcu_gateway.watch.view_model import ViewModel

_COLUMNS = 120
_MOST_LINES = 12
_NO_BREAK_SPACE = "\u00a0"


def plain(title: str, view: ViewModel) -> str:
    """The whole view model; ends with a line feed."""
    lines = [
        header.title_line(title, view, _COLUMNS),
        *_sentence(view),
        *reasons.reason_lines(view.why, _COLUMNS, _MOST_LINES),
        *controllers.controller_lines(view.state, roomy=True),
        *bus.short_lines(view.health),
    ]
    shown = [line.plain.rstrip() for line in lines]
    if view.state is not None:
        shown += _messages(view.state)
    return "\n".join(shown) + "\n"


def _sentence(view: ViewModel) -> list[Text]:
    """The gateway's summary and its own sentence, whole; or why there is none."""
    if view.why is None or view.problem is not None:
        return header.mode_lines(view, _COLUMNS, _MOST_LINES)
    sentences = view.why.get("summary"), view.why["sentence"]
    return [Text(part) for one in sentences if one for part in wrapped(one, _COLUMNS, _MOST_LINES)]


def _messages(state: State) -> Iterator[str]:
    yield f"{'received':<20}{'age ms':>7}{'Hz':>7}  signals"
    for name, message in state["messages"].items():
        age = number(message["age_ms"]) if message["age_ms"] is not None else "never"
        begin = f"{name:<20}{age:>7}{rate_text(message) or ABSENT:>7}  "
        first, *rest = wrapped(_signals(message), _COLUMNS - len(begin), _MOST_LINES)
        yield _spaced(begin + first)
        yield from (_spaced(" " * len(begin) + more) for more in rest)


def _signals(message: Message) -> str:
    """Quantities, and codes that are not 0: what a person looks for."""
    return ", ".join(
        f"{name} {_value(signal)}".replace(" ", _NO_BREAK_SPACE)
        for name, signal in message["signals"].items()
        if signal["value"] is not None and (signal["unit"] or signal["raw"])
    )


def _value(signal: Signal) -> str:
    return marked(f"{value_text(signal)} {signal['unit']}".rstrip(), signal).plain


def _spaced(line: str) -> str:
    return line.replace(_NO_BREAK_SPACE, " ").rstrip()
