"""CSV for a spreadsheet: a row each 50 ms, with the value of every signal at that moment."""

import csv
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import groupby
from typing import TextIO

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.spec import SignalSpec
from vcu_gateway.export.decisions import MODES
from vcu_gateway.export.source import Selection, Source
from vcu_gateway.export.tables import COMMAND, GATEWAY, LatestFrames
from vcu_gateway.recording.decoded import decimals
from vcu_gateway.text import DATE_TIME, utc
from vcu_gateway.units import NS_PER_MS, NS_PER_S

PERIOD_MS = 50
_KEPT_CODES = 8192
_DATE_TIME_MS = f"{DATE_TIME}.%f"


class _SignalColumn:
    """Column of one signal; its texts are kept, as they follow from the raw codes alone."""

    def __init__(self, message: str, index: int, signal: SignalSpec) -> None:
        unit = f" [{signal.unit}]" if signal.unit else ""
        self.head = f"{message}.{signal.name}{unit}"
        self.message = message
        self._index, self._signal = index, signal
        self._decimals = decimals(signal)
        self._kept_text = lru_cache(_KEPT_CODES)(self._text)

    def text(self, decoded: Decoded | None) -> str:
        if decoded is None:
            return ""
        return self._kept_text(decoded.raws[self._index], decoded.values[self._index])

    def _text(self, raw: int, value: float) -> str:
        """Name of the code, or the value with the decimals that the signal can have."""
        return self._signal.names.get(raw) or repr(round(value, self._decimals) + 0)


_TextBetween = Callable[[int, int], str]
"""Text of what the gateway decided, behind one row's moment up to the next one's."""


def write(source: Source, selection: Selection, out: TextIO) -> None:
    """Write the table; a cell is empty where nothing came yet, or only what is stale."""
    decided = list(_decision_columns(source, selection))
    signals = signal_columns(source, selection)
    latest = {
        name: LatestFrames(source.store.rows[name]) for name in {one.message for one in signals}
    }
    writer = csv.writer(out, lineterminator="\n")
    heads = [head for head, _ in decided] + [one.head for one in signals]
    writer.writerow(["time", "seconds", *heads])
    before_ns = source.start_ns - 1
    every_ns = range(source.start_ns, source.end_ns + 1, PERIOD_MS * NS_PER_MS)
    for moment_ns in source.decisions.tick_times_ns or every_ns:
        frames = {name: one.at(moment_ns) for name, one in latest.items()}
        row = [utc(moment_ns, _DATE_TIME_MS), f"{(moment_ns - source.start_ns) / NS_PER_S:.3f}"]
        row += [text(before_ns, moment_ns) for _, text in decided]
        row += [one.text(frames[one.message]) for one in signals]
        writer.writerow(row)
        before_ns = moment_ns


def signal_columns(source: Source, selection: Selection) -> list[_SignalColumn]:
    """Every signal that is asked for, each command's beside what answers to it."""
    found: list[tuple[tuple[str, int, int], _SignalColumn]] = []
    orders = {name: number for number, name in enumerate(source.store.rows)}
    for name, rows in source.store.rows.items():
        for index, signal in enumerate(rows.message.spec.signals):
            if rows.count and selection.wants(name, signal.name):
                key = _place(source, name, index, signal.name, orders)
                found.append((key, _SignalColumn(name, index, signal)))
    return [column for _, column in sorted(found, key=lambda one: one[0])]


def _place(
    source: Source, message: str, index: int, signal: str, orders: dict[str, int]
) -> tuple[str, int, int]:
    """Order of the columns: a controller's together, what is echoed behind what was commanded."""
    found = COMMAND.fullmatch(message)
    node = found[1] if found else message.partition("_")[0]
    command = f"VCU_{node}_Command"
    if command not in source.store.rows:
        return "~", orders[message], index
    commanded = source.store.rows[command].message.spec.signal_names
    answered = {"MotorSpeed": "SpeedLimit"}.get(signal, signal)
    if answered in commanded:
        return node, commanded.index(answered), int(message != command)
    return node, len(commanded) + orders[message], index


def _decision_columns(source: Source, selection: Selection) -> Iterator[tuple[str, _TextBetween]]:
    decisions = source.decisions
    if not decisions.tick_times_ns:
        return
    if selection.wants(GATEWAY, "Mode"):
        modes = dict(zip(decisions.tick_times_ns, decisions.tick_modes, strict=True))
        yield f"{GATEWAY}.Mode", lambda _, moment_ns: MODES[modes[moment_ns]]
    if selection.wants(GATEWAY, "Causes"):
        yield f"{GATEWAY}.Causes", _causes_at(source)
    if selection.wants(f"{GATEWAY}_Events", "Event"):
        events = [(one.wall_ns, one.name) for one in decisions.events]
        yield f"{GATEWAY}.Events", _between(events)
    if selection.wants(f"{GATEWAY}_Why", "Sentence"):
        yield f"{GATEWAY}.Why", _latest_of(decisions.whys)


def _causes_at(source: Source) -> _TextBetween:
    """Every cause that counts at a moment; made anew only where one begins or ends."""
    spans = source.decisions.causes
    edges = sorted({edge for span in spans for edge in (span.began_ns, span.ended_ns) if edge})
    texts = [
        "; ".join(
            dict.fromkeys(  # two causes may have the same subject and effect
                span.key.title
                for span in spans
                if span.began_ns <= edge and (span.ended_ns is None or span.ended_ns > edge)
            )
        )
        for edge in edges
    ]
    return _latest_of(list(zip(edges, texts, strict=True)))


def _latest_of(texts: Sequence[tuple[int, str]]) -> _TextBetween:
    stamps = [stamp for stamp, _ in texts]

    def text(_: int, moment_ns: int) -> str:
        place = bisect_right(stamps, moment_ns)
        return texts[place - 1][1] if place else ""

    return text


def _between(names: Sequence[tuple[int, str]]) -> _TextBetween:
    stamps = [stamp for stamp, _ in names]

    def text(before_ns: int, moment_ns: int) -> str:
        first, last = bisect_right(stamps, before_ns), bisect_right(stamps, moment_ns)
        counted = groupby(name for _, name in names[first:last])
        return "; ".join(name for name, _ in counted)

    return text
