"""The chain of a recording, followed: where it breaks, and the last member of each segment."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.drive_format import chain
from vcu_gateway.drive_format.chain import Break, BreakKind
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.recordings.checked_segment import FaultKind, FileFault

_KINDS = {
    BreakKind.BEGINNING: FaultKind.MISSING,
    BreakKind.MISSING: FaultKind.MISSING,
    BreakKind.CHANGED: FaultKind.CHANGED,
    BreakKind.UNCHAINED: FaultKind.CHANGED,
    BreakKind.TORN: FaultKind.TORN,
}


class Chain(NamedTuple):
    """What following the links found.

    Attributes:
        is_chained: every segment's members have links; False without a member.
        ends: digest of the last member of each segment, by its number.
        faults: where it breaks.
    """

    is_chained: bool
    ends: Mapping[int, bytes]
    faults: tuple[FileFault, ...]


def chain_of(folder: Path, segments: list[SegmentFiles], is_part: bool) -> Chain:
    """Follow the links; `is_part`: of an incident, which may begin anywhere in its drive.

    Files that cannot be read, of which `check_segment` says why, are passed by.
    """
    linked, ends, faults = list[bool](), dict[int, bytes](), list[FileFault]()
    with contextlib.suppress(OSError):
        for part in chain.walk(folder, segments=segments):
            if isinstance(part, Break):
                if not (is_part and part.kind is BreakKind.BEGINNING):
                    faults.append(_fault(part))
                continue
            linked.append(part.member.link is not None)
            if part.member.digest is not None:
                ends[part.segment] = part.member.digest
    return Chain(all(linked) and bool(linked), ends, tuple(faults))


def _fault(part: Break) -> FileFault:
    what = f"from byte {part.offset} on: {part.what}"
    if part.kind is BreakKind.BEGINNING:
        what = f"{part.what}: removed for room, or by somebody"
    return FileFault(part.path.name, what, _KINDS[part.kind])
