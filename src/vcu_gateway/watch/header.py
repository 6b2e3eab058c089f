"""First lines: program, bus and process; mode and reason."""

from rich.text import Text

from vcu_gateway.text import narrow_duration
from vcu_gateway.watch.formatting import cell, line, wrapped
from vcu_gateway.watch.view_model import ViewModel

MODE_STYLES = {
    "starting": "yellow",
    "standby": "cyan",
    "active": "green",
    "fault": "red",
    "stopping": "yellow",
}


_STOP_LINES = 2
_STOP_STYLES = {"cut": "green", "not obeyed": "bold reverse red"}


def title_line(title: str, view: ViewModel, width: int, paused: bool = False) -> Text:
    """Title, bus and process; whether the view is paused."""
    right = Text("PAUSED, space resumes", "reverse bold") if paused else _process(view)
    left = line(Text(title, "bold"), _bus(view))
    return line(cell(left, width - right.cell_len - 1), " ", right)


def _bus(view: ViewModel) -> str:
    if view.health is None:
        return ""
    link = view.health["link"]
    return f"  {link['channel']} ({link['interface']}) {link['state']}"


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
    lines = [line(Text(block, f"bold reverse {style}"), " ", first)]
    return lines + [line(words) for words in rest]


def stop_lines(view: ViewModel, width: int) -> list[Text]:
    """What is known of a latched stop, in two lines at most; none where none is, or it is old."""
    stop = view.state["stop"] if view.state is not None and view.problem is None else None
    if stop is None:
        return []
    style = _STOP_STYLES.get(stop["stage"], "bold yellow")
    words = wrapped(stop["sentence"], width, _STOP_LINES)
    return [line(Text(one, style)) for one in words]


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
