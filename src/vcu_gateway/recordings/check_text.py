"""Check of a recording as text for people and as JSON."""

from collections.abc import Iterator
from typing import Any

from vcu_gateway.recordings.check import CheckedRecording


def headline(found: CheckedRecording) -> str:
    """The state, and what proves it."""
    if not found.is_chained:
        return f"{found.state.value}, not chained: nothing shows whether it was changed"
    signed = found.signatures
    if not signed.signers:
        return f"{found.state.value}, chained, unsigned"
    part = "" if signed.segments == found.segments else f" {signed.segments} segments"
    return f"{found.state.value}, chained, signed{part} by {', '.join(signed.signers)}"


def fault_lines(found: CheckedRecording, most: int) -> Iterator[str]:
    """The first faults, a line each, and how many there are more."""
    for fault in found.faults[:most]:
        yield f"  {fault.file}: {fault.what}" if fault.file else f"  {fault.what}"
    if len(found.faults) > most:
        yield f"  and {len(found.faults) - most} more"


def values(found: CheckedRecording) -> dict[str, Any]:
    """What the check found, for JSON."""
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
