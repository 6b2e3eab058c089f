"""HTML report of a recording: one file with plots, bands and events, and nothing to load."""

import base64
import hashlib
import html
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

from vcu_gateway.export.report import (
    Band,
    CodeLine,
    Line,
    Overlay,
    PackedLines,
    Plot,
    Report,
    packed,
)
from vcu_gateway.export.report_builder import build
from vcu_gateway.export.source import ReadOptions, Selection, Source, read
from vcu_gateway.time_window import Window
from vcu_gateway.units import NS_PER_S

UPLOT = Path(__file__).with_name("uplot")
"""uPlot 1.6.32 as npm has it, with its licence (MIT)."""

_PAGE_FILES = Path(__file__).with_name("page")
_SCRIPTS = (UPLOT / "uPlot.iife.min.js", _PAGE_FILES / "plots.js", _PAGE_FILES / "report.js")
"""In their order: each needs what the one before it defines."""
_STYLES = (UPLOT / "uPlot.min.css", _PAGE_FILES / "report.css")

MOST_DATA_BYTES = 1_150_000
"""Of packed lines; longer recordings get a coarser grid, so that the page stays below 2 MB."""

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main id="report">
<noscript>The plots need scripts, which are switched off in this browser.</noscript>
{body}
</main>
<script type="application/json" id="data">{data}</script>
{scripts}
</body>
</html>
"""


def page(report: Report) -> str:
    bucket_ns, lines = _small_enough(report)
    scripts = [path.read_text(encoding="utf-8") for path in _SCRIPTS]
    style = "".join(path.read_text(encoding="utf-8") for path in _STYLES)
    data = json.dumps(_data(report, bucket_ns, lines), separators=(",", ":"))
    policy = (
        f"default-src 'none'; script-src {' '.join(map(_hash, scripts))}; style-src {_hash(style)};"
        " base-uri 'none'; form-action 'none'"
    )
    return _PAGE.format(
        policy=policy,
        title=html.escape(f"{report.title} · vcu-gateway"),
        style=style,
        body="\n".join(_body(report)),
        data=data.replace("<", "\\u003c"),  # it cannot end the script element that holds it
        scripts="\n".join(f"<script>{script}</script>" for script in scripts),
    )


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def _small_enough(report: Report) -> tuple[int, PackedLines]:
    """The lines packed, and the grid on which they fit; both halved until they do."""
    bucket_ns = report.bucket_ns
    lines: list[CodeLine] = [line.codes for plot in report.plots for line in plot.lines]
    while len((result := packed(lines)).data) > MOST_DATA_BYTES:
        bucket_ns *= 2
        lines = [line.halved() for line in lines]
    return bucket_ns, result


def _data(report: Report, bucket_ns: int, lines: PackedLines) -> dict[str, Any]:
    layouts = iter(lines.layouts)
    buckets = -(-report.buckets * report.bucket_ns // bucket_ns)
    return {
        "start": report.start_ns / NS_PER_S,
        "length": (report.end_ns - report.start_ns) / NS_PER_S,
        "bucket": bucket_ns / NS_PER_S,
        "buckets": buckets,
        "plots": [_plot(plot, layouts) for plot in report.plots],
        "bands": [_band(band, report.start_ns) for band in report.bands],
        "events": [
            [_seconds(one.wall_ns, report.start_ns), one.severity, one.name, one.text]
            for one in report.events
        ],
        "whys": [[_seconds(stamp, report.start_ns), text] for stamp, text in report.whys],
        "lines": base64.b64encode(lines.data).decode(),
    }


def _seconds(stamp_ns: int, start_ns: int) -> float:
    return round((stamp_ns - start_ns) / NS_PER_S, 6)


def _plot(plot: Plot, layouts: Iterator[dict[str, Any]]) -> dict[str, Any]:
    lines = [_line(line, next(layouts)) for line in plot.lines]
    return {"title": plot.title, "unit": plot.unit, "lines": lines}


def _line(line: Line, layout: dict[str, Any]) -> dict[str, Any]:
    told = {**line._asdict(), "role": line.role.value, "names": dict(line.names), **layout}
    del told["codes"]
    return told


def _band(band: Band, start_ns: int) -> dict[str, Any]:
    spans = [
        [_seconds(one.begin_ns, start_ns), _seconds(one.end_ns, start_ns), one.kind, one.text]
        for one in band.spans
    ]
    return {"title": band.title, "whatIf": band.what_if, "spans": spans}


def _body(report: Report) -> Iterator[str]:
    """What can be read without the script."""
    text = html.escape
    facts = "".join(f"<div><dt>{text(k)}</dt><dd>{text(v)}</dd></div>" for k, v in report.facts)
    yield f"<header><p class='name'>{text(report.title)}</p><h1>{text(report.headline)}</h1>"
    yield f"<dl class='facts'>{facts}</dl></header>"
    if report.overlay is not None:
        yield from _overlay(report.overlay)
    yield "<div id='stage'></div>"
    if report.constant:
        yield "<details><summary>Signals that never changed "
        yield f"<span class='count'>{len(report.constant)}</span></summary>"
        yield from _table(("signal", "value"), report.constant)
        yield "</details>"
    for name, contents in report.texts.items():
        yield f"<details><summary>{text(name)}</summary><pre>{text(contents)}</pre></details>"


_CURVES = (
    "Solid: the curve of the what-if; dashed: as recorded, where it differs."
    " Marks below, at 0: where the drive was, darker the longer."
)


def _overlay(overlay: Overlay) -> Iterator[str]:
    text = html.escape
    yield f"<section class='whatif'><p class='name'>What if</p><h2>{text(overlay.headline)}</h2>"
    if overlay.notes:
        yield "<ul>" + "".join(f"<li>{text(note)}</li>" for note in overlay.notes) + "</ul>"
    if overlay.rows:
        yield from _table(overlay.columns, overlay.rows)
    if overlay.curves:
        yield "<div class='curves'>" + "".join(one.svg() for one in overlay.curves) + "</div>"
        yield f"<p class='name'>{_CURVES}</p>"
    yield "</section>"


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    heads = "".join(f"<th scope='col'>{html.escape(column)}</th>" for column in columns)
    yield f"<div class='scroll'><table><thead><tr>{heads}</tr></thead><tbody>"
    for row in rows:
        yield "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
    yield "</tbody></table></div>"


def write(
    source: Source, selection: Selection, out: TextIO, overlay: Overlay | None = None
) -> None:
    out.write(page(build(source, selection, overlay)))


def write_report(name: str, out: TextIO, overlay: Overlay | None = None) -> None:
    """Read a drive, an incident or a log, and write its page with the overlay.

    Damage in the recording is passed over: whoever made the overlay has told of it. Raises what
    `read` raises.
    """
    options = ReadOptions(Window(), lambda _: None, lambda *_: None)
    source = read(name, options)
    try:
        write(source, Selection(), out, overlay)
    finally:
        source.store.close()
