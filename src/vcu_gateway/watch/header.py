"""The first lines: what runs where, its mode, and why."""

from rich.text import Text

from vcu_gateway.watch.formatting import cell, duration, line, wrapped
from vcu_gateway.watch.view_model import ViewModel

MODE_STYLES = {
    "starting": "yellow",
    "standby": "cyan",
    "active": "green",
    "fault": "red",
    "stopping": "yellow",
}


def title_line(title: str, picture: ViewModel, width: int, paused: bool = False) -> Text:
    """What is shown, the bus, and the process; whether the picture stands still."""
    right = Text("PAUSED, space goes on", "reverse bold") if paused else _process(picture)
    left = line(Text(title, "bold"), _where(picture))
    return line(cell(left, width - right.cell_len - 1), " ", right)


def _where(picture: ViewModel) -> str:
    if picture.health is None:
        return ""
    link = picture.health["link"]
    return f"  {link['channel']} ({link['interface']}) {link['state']}"


def _process(picture: ViewModel) -> Text:
    health = picture.health
    if health is None:
        return Text()
    return Text(f"pid {health['pid']}  up {duration(health['uptime_ms'])}", "dim")


def mode_lines(picture: ViewModel, width: int, most: int, sentence: str = "") -> list[Text]:
    """The mode and a sentence, the gateway's own by default, in at most so many lines."""
    mark, style, own = _told(picture)
    block = f" {mark} "
    first, *rest = wrapped(sentence or own, width, most, len(block) + 1)
    lines = [line(Text(block, f"bold reverse {style}"), " ", first)]
    return lines + [line(words) for words in rest]


def _told(picture: ViewModel) -> tuple[str, str, str]:
    state, why, trouble = picture.state, picture.why, picture.trouble
    if trouble is not None:
        since = trouble.since.strftime("%H:%M:%S")
        below = "; below is what it said last" if state is not None else ""
        return "NOT REACHABLE", "red", f"since {since}, trying again: {trouble.sentence}{below}"
    if why is None or state is None:
        return "CONNECTING", "yellow", "waiting for the gateway's first answer"
    mode = state["mode"]
    sentence = why["sentence"].removeprefix(f"{why['mode']}; ")
    return mode.upper(), MODE_STYLES[mode], sentence
