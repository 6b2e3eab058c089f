"""Signatures as the recorder leaves them, and keys to make them with."""

import subprocess
from pathlib import Path

from vcu_gateway.recording import chain, layout, signature
from vcu_gateway.recording.chain import Linked
from vcu_gateway.recording.signature import link_name, link_text

RUN = "1f3a9c2e-0000"


def make_key(path: Path) -> Path:
    """A key without a passphrase; its public half beside it."""
    make = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(path)]
    subprocess.run(make, check=True, stdin=subprocess.DEVNULL)
    return path


def sign(drive: Path, key: Path) -> None:
    """Sign the end of every segment."""
    linked = (part for part in chain.walk(layout.segments(drive)) if isinstance(part, Linked))
    for segment, digest in {part.segment: part.member.digest for part in linked}.items():
        text = link_text(RUN, segment, digest or b"")
        (drive / link_name(segment)).write_bytes(text)
        (drive / f"{link_name(segment)}.sig").write_bytes(signature.sign(text, key))
