"""Lines above the signals, by the terminal's size: title, mode, reasons, figures."""

from collections.abc import Iterator

from rich.text import Text

from vcu_gateway.api.results import Cause, Why
from vcu_gateway.text import narrow_duration
from vcu_gateway.watch import figures
from vcu_gateway.watch.figures import cell, line, wrapped
from vcu_gateway.watch.source import ViewModel

MODE_STYLES = {
    "starting": "yellow",
    "standby": "cyan",
    "active": "green",
    "fault": "red",
    "stopping": "yellow",
}
_STOP_LINES = 2
_STOP_STYLES = {"cut": "green", "not obeyed": "bold reverse red"}
_LABEL_COLUMNS = 13
_SINCE_COLUMNS = 13
_EFFECT_STYLES = {"stop": "red", "cut": "bold red", "alarm": "yellow"}
_LIMIT_STYLE = "yellow"
_CODE = "code"  # says nothing that the signal's name and code do not
_CAP = "cap"  # its cause is a key of the configuration, and its detail says what it limits
TALL_LINES = 32
"""From here on there is room for more than the needed."""

_GAP = 2
_WIDE_COLUMNS = figures.TABLE_COLUMNS + _GAP + figures.PANEL_COLUMNS
_SENTENCE_LINES, _SENTENCE_LINES_TALL = 3, 6
_REASON_LINES, _REASON_LINES_TALL = 4, 10
_PANEL_LINES = 13


def title_line(title: str, view: ViewModel, width: int, paused: bool = False) -> Text:
    """Title, bus, drive mode and process; whether the view is paused."""
    right = Text("PAUSED, space resumes", "reverse bold") if paused else _process(view)
    left = line(Text(title, "bold"), _bus(view), _drive_mode(view))
    return line(cell(left, width - right.cell_len - 1), " ", right)


def _bus(view: ViewModel) -> str:
    if view.health is None:
        return ""
    link = view.health["link"]
    return f"  {link['channel']} ({link['interface']}) {link['state']}"


def _drive_mode(view: ViewModel) -> str:
    mode = view.tuning["drive_mode"] if view.tuning is not None and view.problem is None else None
    if mode is None:
        return ""
    waits = "" if mode["requested"] == mode["current"] else f", {mode['requested']} waits"
    return f"  drive mode {mode['current']}{waits}"


def _process(view: ViewModel) -> Text:
    health = view.health
    if health is None:
        return Text()
    return Text(f"pid {health['pid']}  up {narrow_duration(health['uptime_ms'])}", "dim")


def mode_lines(view: ViewModel, width: int, max_lines: int, sentence: str = "") -> list[Text]:
    """Mode and summary, below them a sentence, the gateway's own by default, in so many lines.

    Where there is no summary the sentence is beside the mode: the gateway is older, or away.
    """
    mark, style, own = _mode_and_sentence(view)
    block = f" {mark} "
    summary = view.why.get("summary", "") if view.why and not view.problem else ""
    first, *rest = wrapped(summary or sentence or own, width, max_lines, len(block) + 1)
    if summary and (left := max_lines - 1 - len(rest)) > 0:
        rest += wrapped(sentence or own, width, left)
    return [line(Text(block, f"bold reverse {style}"), " ", first), *map(line, rest)]


def stop_lines(view: ViewModel, width: int) -> list[Text]:
    """What is known of a latched stop, in two lines at most; none where none is, or it is old."""
    stop = view.state["stop"] if view.state is not None and view.problem is None else None
    if stop is None:
        return []
    style = _STOP_STYLES.get(stop["stage"], "bold yellow")
    return [line(Text(one, style)) for one in wrapped(stop["sentence"], width, _STOP_LINES)]


def _mode_and_sentence(view: ViewModel) -> tuple[str, str, str]:
    state, why, problem = view.state, view.why, view.problem
    if problem is not None:
        since = problem.since.strftime("%H:%M:%S")
        below = "; below are its last values" if state is not None else ""
        return "NOT REACHABLE", "red", f"since {since}, trying again: {problem.sentence}{below}"
    if why is None or state is None:
        return "CONNECTING", "yellow", "waiting for the gateway's first answer"
    mode = state["mode"]
    sentence = why["sentence"].removeprefix(f"{why['mode']}; ")
    return mode.upper(), MODE_STYLES[mode], sentence


def pedal_lines(view: ViewModel, width: int) -> list[Text]:
    """What the pedals on CAN say and why they are not believed; none where there are none."""
    found = view.tuning.get("pedals") if view.tuning is not None and view.problem is None else None
    if found is None:
        return []
    style = _LIMIT_STYLE if found["doubts"] else "bold"
    return [_row("pedals", style, found["sentence"], "", width)]


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
    if effect != _CAP and word not in (*text.split(), _CODE):
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


def upper_lines(
    title: str, view: ViewModel, width: int, height: int, paused: bool = False
) -> list[Text]:
    """Header, reasons, controllers and bus: 20 lines at most in 80 x 24."""
    tall = height >= TALL_LINES
    gap = [Text()] if tall else []
    return [
        title_line(title, view, width, paused),
        *_explanation(view, width, tall),
        *gap,
        *_figures(view, width, tall),
        *gap,
    ]


def _explanation(view: ViewModel, width: int, tall: bool) -> list[Text]:
    """Mode, summary and reasons; where room is short, what to do in place of the long sentence."""
    why = view.why
    if why is None or view.problem is not None:
        return mode_lines(view, width, _SENTENCE_LINES)
    stop = stop_lines(view, width)
    most = (_REASON_LINES_TALL if tall else _REASON_LINES) - len(stop[1:])
    pedals = pedal_lines(view, width)
    if not tall:
        most -= len(pedals)
    reasons = reason_lines(why, width, most)
    if not reasons:
        return mode_lines(view, width, _SENTENCE_LINES) + stop + pedals
    if not tall:
        sentence = f"next: {why['next_step']}"
        mode = mode_lines(view, width, _SENTENCE_LINES, sentence)
        most -= max(0, len(mode) + len(stop) - _SENTENCE_LINES)
        return mode + stop + reason_lines(why, width, most) + pedals
    mode = mode_lines(view, width, _SENTENCE_LINES_TALL)
    return [*mode, *stop, Text(), *reasons, *next_lines(why, width), *pedals]


def _figures(view: ViewModel, width: int, tall: bool) -> list[Text]:
    """Controllers above the bus, or beside it where the terminal is wide."""
    wide = width >= _WIDE_COLUMNS
    old = view.problem is not None
    left = figures.controller_lines(view.state, tall, old)
    if not wide:
        return _faded(left + figures.short_lines(view.health), old)
    room = width - figures.TABLE_COLUMNS - _GAP
    right = figures.panel_lines(view.health, room)[: max(len(left), _PANEL_LINES)]
    lines = [
        line(_at(left, row, figures.TABLE_COLUMNS), " " * _GAP, _at(right, row, room))
        for row in range(max(len(left), len(right)))
    ]
    return _faded(lines, old)


def _at(lines: list[Text], row: int, width: int) -> Text:
    return cell(lines[row] if row < len(lines) else "", width)


def _faded(lines: list[Text], old: bool) -> list[Text]:
    return [Text(one.plain, "dim") for one in lines] if old else lines
