"""Bands of a report: modes, causes and named codes as stretches of time."""

from collections.abc import Iterator, Mapping, Sequence

from vcu_gateway.export.decisions import MODES, NEVER_RECEIVED, Decisions
from vcu_gateway.export.lines import GAP
from vcu_gateway.export.report import Band, Overlay, Span
from vcu_gateway.export.report_lines import Grid, SignalLine
from vcu_gateway.recording.cause_spans import CauseSpan

_MOST_CAUSES = 14
_MOST_SPANS = 300
_WORST_FIRST = ("cut", "stop", "power limit", "regen off", "regen limit", "turbo off", "alarm")


def mode_band(decisions: Decisions, end_ns: int) -> Iterator[Band]:
    """Modes of the gateway; none where the recording has no ticks."""
    changes: list[tuple[int, str]] = []
    for stamp, code in zip(decisions.tick_times_ns, decisions.tick_modes, strict=True):
        if not changes or changes[-1][1] != MODES[code]:
            changes.append((stamp, MODES[code]))
    yield from _of_changes("mode", changes, end_ns, what_if=False)


def _of_changes(
    title: str, changes: Sequence[tuple[int, str]], end_ns: int, *, what_if: bool
) -> Iterator[Band]:
    if changes:
        ends = [*(stamp for stamp, _ in changes[1:]), end_ns]
        spans = [Span(one[0], end, one[1], one[1]) for one, end in zip(changes, ends, strict=True)]
        yield Band(title, tuple(spans), what_if)


def cause_bands(decisions: Decisions, start_ns: int, end_ns: int) -> list[Band]:
    """A band for each cause, the worst effect first; one for all that had not come yet."""
    waited = [one for one in decisions.causes if one.detail == NEVER_RECEIVED]
    bands = [_waited_for(waited, start_ns, end_ns)] if waited else []
    causes: dict[str, list[Span]] = {}
    for one in decisions.causes:
        if one.detail == NEVER_RECEIVED:
            continue
        last_ns = end_ns if one.ended_ns is None else min(one.ended_ns, end_ns)
        text = f"{one.key.subject} {one.detail}".strip()
        span = Span(max(start_ns, one.began_ns), last_ns, one.key.effect, text)
        causes.setdefault(f"{one.key.subject}: {one.key.effect}", []).append(span)
    return [*bands, *_ranked(causes)]


def _waited_for(waited: Sequence[CauseSpan], start_ns: int, end_ns: int) -> Band:
    """What a gateway lacks when it starts: one stretch until the last of it has come."""
    last_ns = max(end_ns if one.ended_ns is None else one.ended_ns for one in waited)
    messages = sorted({one.key.subject for one in waited})
    span = Span(
        max(start_ns, waited[0].began_ns), min(last_ns, end_ns), "alarm", ", ".join(messages)
    )
    return Band(f"never received until then: {len(messages)} messages", (span,))


def _ranked(causes: Mapping[str, list[Span]]) -> list[Band]:
    def rank(item: tuple[str, list[Span]]) -> tuple[int, int]:
        effect = item[1][0].kind
        worst = _WORST_FIRST.index(effect) if effect in _WORST_FIRST else len(_WORST_FIRST)
        return worst, item[1][0].begin_ns

    ordered = sorted(causes.items(), key=rank)[:_MOST_CAUSES]
    return [Band(title, tuple(spans[:_MOST_SPANS])) for title, spans in ordered]


def overlay_bands(overlay: Overlay, end_ns: int) -> Iterator[Band]:
    yield from _of_changes("mode, what if", overlay.modes, end_ns, what_if=True)
    causes: dict[str, list[Span]] = {}
    for text, began_ns, ended_ns in overlay.causes:
        effect = text.rpartition(": ")[2]
        span = Span(began_ns, end_ns if ended_ns is None else ended_ns, effect, text)
        causes.setdefault(text, []).append(span)
    yield from (band._replace(what_if=True) for band in _ranked(causes))


def code_bands(lines: Mapping[str, SignalLine], grid: Grid, used: set[str]) -> Iterator[Band]:
    """Signals with named codes that change now and then, such as a level of the battery."""
    for key, line in lines.items():
        if line.signal.names and key not in used and line.codes.constant is None:
            spans = _code_spans(line, grid)
            if 1 < len(spans) <= _MOST_SPANS:
                yield Band(key, tuple(spans))


def _code_spans(line: SignalLine, grid: Grid) -> list[Span]:
    spans: list[Span] = []
    before, begin_ns = GAP, grid.start_ns
    stamps = [grid.start_ns + bucket * grid.bucket_ns for bucket in range(grid.buckets)]
    pairs = zip(line.codes.earlier, line.codes.later, stamps, strict=True)
    changes = [(code, stamp) for one, other, stamp in pairs for code in (one, other)]
    for code, stamp in [*changes, (GAP, grid.start_ns + grid.buckets * grid.bucket_ns)]:
        if code != before:
            if before != GAP and stamp > begin_ns:
                text = line.signal.names.get(before, f"code {before}")
                spans.append(Span(begin_ns, stamp, "", text))
            before, begin_ns = code, stamp
    return spans
