"""Chain of a recording, followed: where it breaks, and who has signed it how far."""

import contextlib
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.recording import chain, layout, signature
from vcu_gateway.recording.chain import Break, BreakKind
from vcu_gateway.recording.checked_segment import FaultKind, FileFault
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.signature import SignatureError

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


_PROGRAM = "ssh-keygen"


class Signatures(NamedTuple):
    """Who has signed a recording.

    Attributes:
        signers: fingerprints of the keys, with their names where allowed signers were given.
        segments: how many segments are signed; descriptions: and how many of an incident's.
        expected: fingerprint of the key that its recorder says to sign with; None without one.
        faults: signatures of something else, and with allowed signers what none of them signed.
    """

    signers: tuple[str, ...]
    segments: int
    descriptions: int
    expected: str | None
    faults: tuple[FileFault, ...]


def check_signatures(
    folder: Path, chain: Chain, expected: str | None, allowed_signers: Path | None
) -> Signatures:
    """Verify every signature of a drive or an incident; OSError as the disk has it."""
    return _Check(folder, chain, allowed_signers).signatures(expected)


class _Check:
    def __init__(self, folder: Path, chain: Chain, allowed_signers: Path | None) -> None:
        self._folder = folder
        self._chain = chain
        self._allowed = allowed_signers
        self._signers: set[str] = set()
        self._faults: list[FileFault] = []

    def signatures(self, expected: str | None) -> Signatures:
        descriptions = layout.incident_files(self._folder)
        segments = sum(
            self._is_signed(
                signature.link_name(number), self._text_of(number, digest), f"segment {number}"
            )
            for number, digest in self._chain.ends.items()
        )
        described = sum(self._is_signed(path.name, _data(path), path.name) for path in descriptions)
        signers, faults = tuple(sorted(self._signers)), tuple(self._faults)
        return Signatures(signers, segments, described, expected, faults)

    def _text_of(self, number: int, digest: bytes) -> bytes:
        described = layout.description_if_any(self._folder / layout.DRIVE_FILE)
        return signature.link_text(str(described.get("run")), number, digest)

    def _is_signed(self, name: str, data: bytes | None, what: str) -> bool:
        path = self._folder / f"{name}{signature.SUFFIX}"
        if not path.exists():
            if self._allowed is not None:
                self._faults.append(FileFault(name, f"{what} is not signed", FaultKind.CHANGED))
            return False
        if shutil.which(_PROGRAM) is None:
            what = f"{path.name} cannot be verified without {_PROGRAM}"
            raise UnavailableError(Problem(what, str(self._folder), "apt install openssh-client"))
        try:
            layout.read_small(path)
            found = signature.verify(data or b"", path, self._allowed)
        except (OSError, SignatureError) as error:
            reason = f"the signature is none of {what} as it is here: {error}"
            self._faults.append(FileFault(path.name, reason, FaultKind.CHANGED))
            return False
        name_of_it = f" ({found.identity})" if found.identity else ""
        self._signers.add(f"{found.fingerprint}{name_of_it}")
        return True


def _data(path: Path) -> bytes | None:
    try:
        return layout.read_small(path)
    except OSError:
        return None
