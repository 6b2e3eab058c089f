"""HTML report of a recording: reads it, and writes one page with plots."""

from typing import TextIO

from vcu_gateway.export.html_page import page
from vcu_gateway.export.report import Overlay
from vcu_gateway.export.report_builder import build
from vcu_gateway.export.selection import Selection
from vcu_gateway.export.source import ReadOptions, Source, read
from vcu_gateway.time_window import Window

__all__ = ["Overlay", "write", "write_report"]


def write(
    source: Source,
    selection: Selection,
    out: TextIO,
    overlay: Overlay | None = None,
    title: str = "",
) -> None:
    out.write(page(build(source, selection, overlay, title)))


def write_report(
    name: str, out: TextIO, overlay: Overlay | None = None, *, title: str = ""
) -> None:
    """Read a drive, an incident or a log, and write its page with the overlay.

    Damage in the recording is passed over: whoever made the overlay has told of it. Raises what
    `read` raises.
    """
    options = ReadOptions(Window(), lambda _: None, lambda *_: None)
    source = read(name, options)
    try:
        write(source, Selection(), out, overlay, title)
    finally:
        source.store.close()
