"""Signatures of a recording, made and verified by OpenSSH's ssh-keygen: nobody needs our tool.

At the end of each segment a text names the last member of the chain so far, and beside it is its
signature; that of an incident is over its description:

    0001.link  0001.link.sig      incident.json  incident.json.sig

    vcu-gateway recording 1
    run 1f3a9c2e...
    segment 1
    link 5d41...        SHA-256 of the segment's last member

    ssh-keygen -Y verify -f ALLOWED -I NAME -n vcu-gateway-recording -s 0001.link.sig <0001.link
"""

import base64
import binascii
import contextlib
import hashlib
import os
import re
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.recording import layout
from vcu_gateway.recording.chain import FaultKind, FileFault

NAMESPACE = "vcu-gateway-recording"
SUFFIX = ".sig"
_PROGRAM = "ssh-keygen"
_SIGN_WITHIN_S, _VERIFY_WITHIN_S = 2.0, 10.0
LINK = re.compile(r"\d{4,9}\.link", re.ASCII)
_FINGERPRINT = re.compile(r"SHA256:\S+")


class SignatureError(Exception):
    """Why something could not be signed or verified, as one line."""


class Verified(NamedTuple):
    """Who signed: the key's fingerprint, and its name in the allowed signers; None without them."""

    fingerprint: str
    identity: str | None


def link_name(segment: int) -> str:
    """File that names the last member of a segment; its signature has `SUFFIX` behind that."""
    return f"{segment:04d}.link"


def link_paths(folder: Path, segment: int) -> tuple[Path, Path]:
    """What is signed of a segment, and its signature, whether they are there or not."""
    name = link_name(segment)
    return folder / name, folder / f"{name}{SUFFIX}"


def link_text(run: str, segment: int, link: bytes) -> bytes:
    """What is signed at the end of a segment; `link`: digest of its last member."""
    return (f"vcu-gateway recording 1\nrun {run}\nsegment {segment}\nlink {link.hex()}\n").encode()


def fingerprint(key: Path) -> str:
    """Fingerprint of a private key without a passphrase; SignatureError where it is none."""
    public = _run(b"", _SIGN_WITHIN_S, "-y", "-P", "", "-f", key).split()
    try:
        blob = base64.b64decode(public[1], validate=True)
    except (IndexError, binascii.Error) as error:
        raise SignatureError(f"{key} is no private key of OpenSSH") from error
    digest = base64.b64encode(hashlib.sha256(blob).digest()).decode()
    return f"SHA256:{digest.rstrip('=')}"


def sign(data: bytes, key: Path) -> bytes:
    """Signature of these bytes; SignatureError where there is none, after 2 s at most."""
    return _run(data, _SIGN_WITHIN_S, "-Y", "sign", "-n", NAMESPACE, "-f", key)


def verify(data: bytes, signature: Path, allowed_signers: Path | None = None) -> Verified:
    """Who signed these bytes; SignatureError where nobody did, or nobody of the allowed signers.

    Without allowed signers any key will do.
    """
    name: str | None = None
    by = ["check-novalidate"]
    if allowed_signers is not None:
        find = ("-Y", "find-principals", "-f", allowed_signers, "-s", signature)
        names = _run(b"", _VERIFY_WITHIN_S, *find).decode(errors="replace").splitlines()
        if not names:
            raise SignatureError("its key is none of the allowed signers'")
        name, by = names[0], ["verify", "-f", str(allowed_signers), "-I", names[0]]
    said = _run(data, _VERIFY_WITHIN_S, "-Y", *by, "-n", NAMESPACE, "-s", signature)
    found = _FINGERPRINT.search(said.decode(errors="replace"))
    return Verified(found[0] if found else "unknown", name)


class Signatures(NamedTuple):
    """Who has signed a recording.

    Attributes:
        signers: fingerprints of the keys, with their names where allowed signers were given.
        segments: how many segments are signed; descriptions: and how many of an incident's.
        expected: fingerprint of the key that its recorder says to sign with; None without one.
    """

    signers: tuple[str, ...] = ()
    segments: int = 0
    descriptions: int = 0
    expected: str | None = None


def check_signatures(
    folder: Path,
    ends: Mapping[int, bytes],
    expected: str | None,
    allowed_signers: Path | None,
    faults: list[FileFault],
) -> Signatures:
    """Verify every signature of a drive or an incident; OSError as the disk has it.

    `ends`: digest of the last member of each segment. Signatures of something else are added to
    `faults`, and with allowed signers what none of them signed.
    """
    run = str(layout.description_if_any(folder / layout.DRIVE_FILE).get("run"))

    def signers(signed: Iterable[tuple[str, bytes | None, str]]) -> list[str]:
        found = [_signer(folder, *one, allowed_signers, faults) for one in signed]
        return [one for one in found if one is not None]

    segments = signers(
        (link_name(number), link_text(run, number, digest), f"segment {number}")
        for number, digest in ends.items()
    )
    paths = layout.incident_files(folder)
    descriptions = signers((path.name, None, path.name) for path in paths)
    all_signers = tuple(sorted({*segments, *descriptions}))
    return Signatures(all_signers, len(segments), len(descriptions), expected)


def _signer(
    folder: Path,
    name: str,
    data: bytes | None,
    what: str,
    allowed_signers: Path | None,
    faults: list[FileFault],
) -> str | None:
    """Who has signed the file of this name, or these bytes in its place; None where nobody did."""
    path = folder / f"{name}{SUFFIX}"
    if not path.exists():
        if allowed_signers is not None:
            faults.append(FileFault(name, f"{what} is not signed", FaultKind.CHANGED))
        return None
    if shutil.which(_PROGRAM) is None:
        what = f"{path.name} cannot be verified without {_PROGRAM}"
        raise UnavailableError(Problem(what, str(folder), "apt install openssh-client"))
    if data is None:
        with contextlib.suppress(OSError):
            data = layout.read_small(folder / name)
    try:
        layout.read_small(path)
        found = verify(data or b"", path, allowed_signers)
    except (OSError, SignatureError) as error:
        reason = f"the signature is none of {what} as it is here: {error}"
        faults.append(FileFault(path.name, reason, FaultKind.CHANGED))
        return None
    return f"{found.fingerprint} ({found.identity})" if found.identity else found.fingerprint


def _run(data: bytes, within_s: float, *arguments: str | Path) -> bytes:
    """Output of ssh-keygen, which asks nobody for a passphrase and is ended after that time."""
    try:
        done = subprocess.run(  # noqa: S603 - OpenSSH's own program
            [_PROGRAM, *map(str, arguments)],
            check=False,
            input=data,
            capture_output=True,
            timeout=within_s,
            start_new_session=True,
            env={**os.environ, "SSH_ASKPASS_REQUIRE": "never", "LC_ALL": "C"},
        )
    except subprocess.TimeoutExpired as error:
        raise SignatureError(f"{_PROGRAM} did not end within {within_s:g} s") from error
    except FileNotFoundError as error:
        raise SignatureError(f"{_PROGRAM} is not there: apt install openssh-client") from error
    except OSError as error:
        raise SignatureError(f"{_PROGRAM}: {error.strerror}") from error
    if done.returncode:
        said = done.stderr.decode(errors="replace").split("\n")
        raise SignatureError(next((line for line in said if line.strip()), "it failed"))
    return done.stdout
