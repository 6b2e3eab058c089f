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
import hashlib
import os
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

NAMESPACE = "vcu-gateway-recording"
SUFFIX = ".sig"
_PROGRAM = "ssh-keygen"
_SIGN_WITHIN_S, _VERIFY_WITHIN_S = 2.0, 10.0
_LINK = re.compile(r"\d{4,9}\.link", re.ASCII)
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


def is_link(name: str) -> bool:
    return _LINK.fullmatch(name) is not None


def link_text(run: str, segment: int, link: bytes) -> bytes:
    """What is signed at the end of a segment; `link`: digest of its last member."""
    return (f"vcu-gateway recording 1\nrun {run}\nsegment {segment}\nlink {link.hex()}\n").encode()


def fingerprint(key: Path) -> str:
    """Fingerprint of a private key without a passphrase; SignatureError where it is none."""
    public = _run(["-y", "-P", "", "-f", key], b"", _SIGN_WITHIN_S).stdout.split()
    try:
        blob = base64.b64decode(public[1], validate=True)
    except (IndexError, binascii.Error) as error:
        raise SignatureError(f"{key} is no private key of OpenSSH") from error
    digest = base64.b64encode(hashlib.sha256(blob).digest()).decode()
    return f"SHA256:{digest.rstrip('=')}"


def sign(data: bytes, key: Path) -> bytes:
    """Signature of these bytes; SignatureError where there is none, after 2 s at most."""
    return _run(["-Y", "sign", "-n", NAMESPACE, "-f", key], data, _SIGN_WITHIN_S).stdout


def verify(data: bytes, signature: Path, allowed_signers: Path | None = None) -> Verified:
    """Who signed these bytes; SignatureError where nobody did, or nobody of the allowed signers.

    Without allowed signers any key will do.
    """
    of_it: list[str | Path] = ["-n", NAMESPACE, "-s", signature]
    if allowed_signers is None:
        found = _run(["-Y", "check-novalidate", *of_it], data, _VERIFY_WITHIN_S)
        return Verified(_fingerprint_in(found.stdout), None)
    find: list[str | Path] = ["-Y", "find-principals", "-f", allowed_signers, "-s", signature]
    names = _run(find, b"", _VERIFY_WITHIN_S).stdout.decode(errors="replace").splitlines()
    if not names:
        raise SignatureError("its key is none of the allowed signers'")
    by_name: list[str | Path] = ["-Y", "verify", "-f", allowed_signers, "-I", names[0]]
    found = _run([*by_name, *of_it], data, _VERIFY_WITHIN_S)
    return Verified(_fingerprint_in(found.stdout), names[0])


def _fingerprint_in(output: bytes) -> str:
    found = _FINGERPRINT.search(output.decode(errors="replace"))
    return found[0] if found else "unknown"


def _run(
    arguments: Sequence[str | Path], data: bytes, within_s: float
) -> "subprocess.CompletedProcess[bytes]":
    """Run ssh-keygen, which asks nobody for a passphrase and is ended after that time."""
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
    return done
