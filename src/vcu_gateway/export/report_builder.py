"""Report built from a recording: headline, facts, bands, plots and events.

Bands of a report: modes, causes and named codes as stretches of time.
"""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby, pairwise
from operator import itemgetter

from vcu_gateway.export.decisions import MODES, NEVER_RECEIVED, DecidedEvent, Decisions
from vcu_gateway.export.report import GAP, Band, Overlay, Report, ReportEvent, Span
from vcu_gateway.export.report_plots import Grid, SignalLine, plots, signal_lines
from vcu_gateway.export.source import Selection, Source
from vcu_gateway.export.tables import GATEWAY
from vcu_gateway.recording.reader import CauseSpan
from vcu_gateway.text import TIME_OF_DAY_MS, duration, utc
from vcu_gateway.units import NS_PER_MS, NS_PER_S

_MOST_CAUSES = 14
_MOST_SPANS = 300
_WORST_FIRST = (
    *("cut", "stop", "power limit", "regen off", "regen limit", "turbo off", "cap", "alarm"),
)


def mode_band(decisions: Decisions, end_ns: int) -> Iterator[Band]:
    """Modes of the gateway; none where the recording has no ticks."""
    ticks = zip(decisions.tick_times_ns, decisions.tick_modes, strict=True)
    changes = [(next(group)[0], MODES[code]) for code, group in groupby(ticks, itemgetter(1))]
    if changes:
        yield Band("mode", _stretches(changes, end_ns))


def _stretches(changes: Sequence[tuple[int, str]], end_ns: int) -> tuple[Span, ...]:
    """Each from its change to the next one, the last until the end; of the kind of its name."""
    pairs = pairwise([*changes, (end_ns, "")])
    return tuple(Span(begin_ns, last_ns, name, name) for (begin_ns, name), (last_ns, _) in pairs)


def drive_mode_band(decisions: Decisions, start_ns: int, end_ns: int) -> Iterator[Band]:
    """Drive modes, each from where it counts; none where there are none."""
    spans = [
        Span(max(start_ns, one.begin_ns), min(one.end_ns, end_ns), "", one.text)
        for one in _stretches(decisions.drive_modes, end_ns)
    ]
    if inside := tuple(span for span in spans if span.begin_ns < span.end_ns):
        yield Band("drive mode", inside)


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
        causes.setdefault(one.key.title, []).append(span)
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
    if overlay.modes:
        yield Band("mode, what if", _stretches(overlay.modes, end_ns), what_if=True)
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


_FINEST_NS = 50 * NS_PER_MS
_MOST_BUCKETS = 36_000
_MOST_EVENTS = 3000
_YEAR_2000_NS = 946_684_800 * NS_PER_S
_LONGEST_TEXT = 200_000


def build(source: Source, selection: Selection, overlay: Overlay | None = None) -> Report:
    grid = _grid(source)
    end_ns = grid.start_ns + grid.buckets * grid.bucket_ns
    lines = {one.key: one for one in signal_lines(source.store.rows.values(), selection, grid)}
    drawn, constant = plots(lines, overlay, grid)
    bands = [
        *mode_band(source.decisions, end_ns),
        *drive_mode_band(source.decisions, grid.start_ns, end_ns),
    ]
    if overlay is not None:
        bands += overlay_bands(overlay, end_ns)
    if selection.wants(GATEWAY, "Causes"):
        bands += cause_bands(source.decisions, grid.start_ns, end_ns)
    bands += code_bands(lines, grid, {key for key in lines if "_Command" in key})
    return Report(
        title=source.title,
        headline=headline(source, bands),
        facts=tuple(_facts(source, grid)),
        start_ns=grid.start_ns,
        end_ns=source.end_ns,
        bucket_ns=grid.bucket_ns,
        buckets=grid.buckets,
        plots=drawn,
        bands=tuple(bands),
        events=tuple(_events(source.decisions)[:_MOST_EVENTS]),
        whys=tuple(source.decisions.whys),
        constant=constant,
        texts=_texts(source.attachments),
        overlay=overlay,
    )


def _grid(source: Source) -> Grid:
    """Grid of 50 ms, of twice that and so on for what is long."""
    start_ns, end_ns = source.start_ns, source.end_ns
    bucket_ns = _FINEST_NS
    while (end_ns - start_ns) // bucket_ns >= _MOST_BUCKETS:
        bucket_ns *= 2
    return Grid(start_ns, bucket_ns, (end_ns - start_ns) // bucket_ns + 1)


def headline(source: Source, bands: list[Band]) -> str:
    """The recording in a sentence or two: how long, in which modes, and what ended it."""
    lasts = duration((source.end_ns - source.start_ns) / NS_PER_MS)
    decisions = source.decisions
    if not decisions.tick_times_ns:
        count, channel = source.store.summary.decoded.total(), source.store.channel
        where = f" on {channel}" if channel else ""
        known = sum(1 for rows in source.store.rows.values() if rows.count)
        return (
            f"{lasts} of traffic{where}: {count:,} frames of {known} messages."
            " The recording has no decisions of a gateway."
        )
    sentences = [_driven(bands, lasts)]
    faults = [one for one in decisions.events if one.name == "fault_latched"]
    if not faults:
        sentences.append("No fault latched.")
    else:
        first = faults[0]
        reason = first.fields.get("reason", "")
        several = f"{len(faults)} faults latched, the first"
        what = several if len(faults) > 1 else "A fault latched"
        sentences.append(f"{what} at {utc(first.wall_ns, TIME_OF_DAY_MS)}: {reason}.")
    return " ".join(sentences)


def _driven(bands: list[Band], lasts: str) -> str:
    modes = next((band.spans for band in bands if band.title == "mode"), ())
    active = [span.end_ns - span.begin_ns for span in modes if span.kind == "active"]
    if not active:
        return f"{lasts} recorded, never active."
    times = "once" if len(active) == 1 else f"{len(active)} times"
    return f"{lasts} recorded, {duration(sum(active) / NS_PER_MS)} of it active ({times})."


def _facts(source: Source, grid: Grid) -> Iterator[tuple[str, str]]:
    if grid.start_ns > _YEAR_2000_NS:
        yield "begins", f"{utc(grid.start_ns)} UTC"
    yield "lasts", duration((source.end_ns - source.start_ns) / NS_PER_MS)
    yield "frames", f"{source.store.summary.decoded.total():,}"
    if source.decisions.tick_times_ns:
        yield "ticks", f"{len(source.decisions.tick_times_ns):,}"
        yield "missing", "; ".join(what for _, what in source.decisions.gaps) or "nothing"
    if source.unreadable:
        yield "unreadable", f"{source.unreadable} lines"
    if source.store.channel:
        yield "channel", source.store.channel
    yield from _reasons(source.attachments)
    yield from _versions(source.description)


def _reasons(attachments: Mapping[str, bytes]) -> Iterator[tuple[str, str]]:
    """Why an incident is kept."""
    for name, contents in attachments.items():
        if name.startswith("incident"):
            with contextlib.suppress(ValueError, TypeError, KeyError):
                yield "kept because of", str(json.loads(contents)["reason"])


def _versions(description: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    versions = description.get("versions")
    if isinstance(versions, dict):
        yield from ((str(name), str(version)) for name, version in versions.items())
    if digest := description.get("config_digest"):
        yield "configuration", str(digest)[:12]


def _events(decisions: Decisions) -> list[ReportEvent]:
    """Events and gaps in their order; what had never come yet in one row for each tick."""
    found = [ReportEvent(stamp, "warning", "gap", what) for stamp, what in decisions.gaps]
    for (stamp, name, waited), group in groupby(decisions.events, key=_moment_and_kind):
        events = list(group)
        if waited:
            subjects = dict.fromkeys(str(one.fields["subject"]) for one in events)
            text = f"{', '.join(subjects)} {NEVER_RECEIVED}"
            found.append(ReportEvent(stamp, events[0].severity, name, text))
        else:
            found += [ReportEvent(stamp, one.severity, name, _sentence(one)) for one in events]
    return sorted(found, key=lambda one: one.wall_ns)


def _moment_and_kind(event: DecidedEvent) -> tuple[int, str, bool]:
    return event.wall_ns, event.name, event.fields.get("detail") == NEVER_RECEIVED


def _sentence(event: DecidedEvent) -> str:
    """What the event says, without the names of its fields where they go without saying."""
    fields = {name: str(value) for name, value in event.fields.items() if value not in (None, "")}
    if {"subject", "effect"} <= fields.keys():
        detail = f" {fields['detail']}" if "detail" in fields else ""
        return f"{fields['subject']}{detail}: {fields['effect']}"
    if {"before", "after"} <= fields.keys():
        reason = f": {fields['reason']}" if "reason" in fields else ""
        return f"{fields['before']} → {fields['after']}{reason}"
    if {"stage", "sentence"} <= fields.keys():
        return fields["sentence"]
    return event.text


def _texts(attachments: Mapping[str, bytes]) -> dict[str, str]:
    return {
        name: contents.decode("utf-8", "replace")[:_LONGEST_TEXT]
        for name, contents in attachments.items()
        if not name.endswith(".dbc")
    }
