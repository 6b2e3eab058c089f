"""Signatures of a recording: who has signed it, how far, and whether it is what was signed."""

import shutil
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.drive_format import layout, signature
from vcu_gateway.drive_format.signature import SignatureError
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.recordings.chained import Chain
from vcu_gateway.recordings.checked_segment import FaultKind, FileFault

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
