"""Recordings as text for people and as JSON."""

import math
import time
from collections.abc import Iterator, Sequence
from typing import Any

from vcu_gateway.recordings import CheckedRecording, RecordingSummary
from vcu_gateway.units import NS_PER_S

_MINUTE_S, _HOUR_S = 60, 3600
_UNITS = ("kB", "MB", "GB", "TB")
_NONE = "-"
_MOST_FAULTS = 100


def size(size_bytes: float) -> str:
    """Bytes with three digits and a unit, as disks are sold: 1 MB is 1,000,000 bytes."""
    if size_bytes < 1000:
        return f"{size_bytes:.0f} B"
    power = min(len(_UNITS), int(math.log(size_bytes * 1.0005, 1000)))
    return f"{size_bytes / 1000**power:.3g} {_UNITS[power - 1]}"


def duration(seconds: float) -> str:
    """`42 s`, `3 min 07 s`, `26 h 05 min`."""
    whole_s = round(seconds)
    if whole_s < _MINUTE_S:
        return f"{whole_s} s"
    if whole_s < _HOUR_S:
        return f"{whole_s // _MINUTE_S} min {whole_s % _MINUTE_S:02d} s"
    return f"{whole_s // _HOUR_S} h {whole_s % _HOUR_S // _MINUTE_S:02d} min"


def listed(found: Sequence[RecordingSummary], folder: str) -> Iterator[str]:
    """The list: drives, incidents, and what all of it takes."""
    for kind in ("drive", "incident"):
        rows = [one for one in found if one.kind == kind]
        yield f"{len(rows)} {kind}{'' if len(rows) == 1 else 's'} in {folder}/{kind}s"
        if rows:
            head = ("NAME", "BEGAN (UTC)", "DURATION", "SIZE", "GAPS", "")
            yield from _table([head, *map(_row, rows)])
        yield ""
    drives_bytes = sum(one.size_bytes for one in found if one.kind == "drive")
    yield f"{size(drives_bytes)} of drives; while a drive is there, its incidents take no room"


def _row(one: RecordingSummary) -> tuple[str, ...]:
    notes = [*one.reasons, *(["being written"] if one.is_written else [])]
    notes += ["kept"] if one.kept else []
    notes += one.problems
    return (
        one.name,
        _NONE if one.begun_wall_ns is None else _utc(one.begun_wall_ns),
        _NONE if one.duration_s is None else duration(one.duration_s),
        size(one.size_bytes),
        _gaps(one),
        "; ".join(notes),
    )


def _gaps(one: RecordingSummary) -> str:
    if one.lost is None:
        return _NONE
    return f"{one.lost.gaps} ({one.lost.frames} frames)" if one.lost.gaps else "none"


def _table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        yield f"  {'  '.join(cells)}".rstrip()


def _utc(wall_ns: int) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(wall_ns // NS_PER_S))


def summary_json(one: RecordingSummary) -> dict[str, Any]:
    """The summary; begun_wall_ns in nanoseconds since 1970."""
    return {**one._asdict(), "lost": one.lost and one.lost._asdict()}


def check_lines(found: CheckedRecording) -> Iterator[str]:
    """The state, who proves it, the sum, and every fault."""
    yield f"{found.name}: {check_headline(found)}; {_sum(found)}"
    yield from fault_lines(found, _MOST_FAULTS)


def fault_lines(found: CheckedRecording, most: int) -> Iterator[str]:
    """The first faults, a line each, and how many there are more."""
    for fault in found.faults[:most]:
        yield f"  {fault.file}: {fault.what}" if fault.file else f"  {fault.what}"
    if len(found.faults) > most:
        yield f"  and {len(found.faults) - most} more"


def check_headline(found: CheckedRecording) -> str:
    """The state, and what proves it."""
    if not found.is_chained:
        return f"{found.state.value}, not chained: nothing shows whether it was changed"
    signed = found.signatures
    if not signed.signers:
        return f"{found.state.value}, chained, unsigned"
    part = "" if signed.segments == found.segments else f" {signed.segments} segments"
    return f"{found.state.value}, chained, signed{part} by {', '.join(signed.signers)}"


def _sum(found: CheckedRecording) -> str:
    gaps = found.gaps
    received = found.frames + gaps.frames + found.missing_frames
    in_gaps = f" + {gaps.frames} in {gaps.gaps} gap{'' if gaps.gaps == 1 else 's'}"
    missing = f" + {found.missing_frames} missing" if found.missing_frames else ""
    ticks = f", {found.missing_ticks} ticks missing" if found.missing_ticks else ""
    frames = f"{received} frames received = {found.frames} recorded{in_gaps}{missing}"
    return f"{found.segments} segment{'' if found.segments == 1 else 's'}, {frames}{ticks}"


def check_json(found: CheckedRecording) -> dict[str, Any]:
    """What the check found."""
    signatures = found.signatures._asdict()
    del signatures["faults"]
    return {
        **found._asdict(),
        "state": found.state.name.lower(),
        "is_whole": found.is_whole,
        "gaps": found.gaps._asdict(),
        "signatures": signatures,
        "faults": [{**one._asdict(), "kind": one.kind.value} for one in found.faults],
    }


def chosen_lines(found: Sequence[RecordingSummary]) -> Iterator[str]:
    """What is about to be removed."""
    yield from _table([_row(one) for one in found])
