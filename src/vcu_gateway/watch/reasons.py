"""Reasons why the vehicle does not move or moves less, one line each."""

from collections.abc import Iterator

from rich.text import Text

from vcu_gateway.api.results import Cause, Why
from vcu_gateway.text import narrow_duration
from vcu_gateway.watch.formatting import cell, line, wrapped

_LABEL_COLUMNS = 13
_SINCE_COLUMNS = 13
_EFFECT_STYLES = {"stop": "red", "cut": "bold red", "alarm": "yellow"}
_LIMIT_STYLE = "yellow"
_CODE = "code"  # says nothing that the signal's name and code do not


def reason_lines(why: Why | None, width: int, max_lines: int) -> list[Text]:
    """The reasons, at most `max_lines`; none where there is no reason."""
    reasons = [] if why is None else list(_reasons(why, width))
    if len(reasons) <= max_lines:
        return reasons
    left = len(reasons) - max_lines + 1
    return [*reasons[: max_lines - 1], _row(f"and {left} more", "dim", "", "", width)]


def next_lines(why: Why, width: int) -> list[Text]:
    """The next step, in a line or two."""
    first, *rest = wrapped(why["next_step"], width - _LABEL_COLUMNS, 2)
    return [_row("next", "bold", first, "", width), *(_row("", "", one, "", width) for one in rest)]


def _reasons(why: Why, width: int) -> Iterator[Text]:
    latch = why["latch"]
    if latch is not None:
        text = f"until a {latch['fault_class']} reset: {latch['reason']}"
        yield _row("latched", "bold red", text, narrow_duration(latch["since_ms"]), width)
    for cause in (*why["blocks"], *why["limits"], *why["alarms"]):
        yield _cause(cause, width)
    for sentence in why["waits"]:
        yield _row("wait", "cyan", sentence, "", width)


def _cause(cause: Cause, width: int) -> Text:
    effect = cause["effect"]
    text = f"{cause['subject']} {cause['detail']}".rstrip()
    word = cause["cause"].replace("_", " ")
    if word not in (*text.split(), _CODE):
        text = f"{text}, {word}"
    since = narrow_duration(cause["since_ms"]) + ("" if cause["stands"] else " (gone)")
    return _row(effect, _EFFECT_STYLES.get(effect, _LIMIT_STYLE), text, since, width)


def _row(label: str, style: str, text: str, since: str, width: int) -> Text:
    room = width - _LABEL_COLUMNS - (_SINCE_COLUMNS if since else 0)
    return line(
        cell(label, _LABEL_COLUMNS, style),
        cell(text, room),
        cell(since, _SINCE_COLUMNS, align=">") if since else "",
    )
