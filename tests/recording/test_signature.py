"""Signatures: made and verified with ssh-keygen alone, and never waited for long."""

import subprocess
import time

import pytest

from vcu_gateway.recording import signature
from vcu_gateway.recording.signature import SignatureError

TEXT = signature.link_text("1f3a9c2e", 3, bytes(range(32)))


def make_key(folder, name, passphrase=""):
    path = folder / name
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", passphrase, "-C", name, "-f", path], check=True
    )
    return path


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """Two keys, the allowed signers that name the first, and its signature of the text."""
    folder = tmp_path_factory.mktemp("keys")
    key, other = make_key(folder, "vehicle"), make_key(folder, "other")
    allowed = folder / "allowed_signers"
    allowed.write_text(f"vehicle {key.with_suffix('.pub').read_text()}")
    made = folder / "0003.link.sig"
    made.write_bytes(signature.sign(TEXT, key))
    return key, other, allowed, made


def test_the_signed_text_is_four_plain_lines():
    link = "000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f"
    lines = f"vcu-gateway recording 1\nrun 1f3a9c2e\nsegment 3\nlink {link}\n"
    assert lines.encode() == TEXT
    assert signature.link_name(3) == "0003.link"


def test_a_signature_names_its_key_and_who_is_allowed_to_sign(keys):
    key, _, allowed, made = keys
    fingerprint = signature.fingerprint(key)
    assert fingerprint.startswith("SHA256:")
    assert signature.verify(TEXT, made) == (fingerprint, None)
    assert signature.verify(TEXT, made, allowed) == (fingerprint, "vehicle")


def test_another_text_and_another_key_are_refused(keys, tmp_path):
    _, other, allowed, made = keys
    with pytest.raises(SignatureError, match="incorrect signature"):
        signature.verify(TEXT + b"\n", made)
    foreign = tmp_path / "foreign.sig"
    foreign.write_bytes(signature.sign(TEXT, other))
    assert signature.verify(TEXT, foreign).fingerprint == signature.fingerprint(other)
    with pytest.raises(SignatureError):
        signature.verify(TEXT, foreign, allowed)
    foreign.write_bytes(b"no signature")
    with pytest.raises(SignatureError):
        signature.verify(TEXT, foreign)


def test_a_key_that_cannot_sign_says_why(tmp_path):
    with_passphrase = make_key(tmp_path, "closed", "a passphrase")
    for key in (with_passphrase, tmp_path / "none"):
        with pytest.raises(SignatureError):
            signature.fingerprint(key)
        with pytest.raises(SignatureError):
            signature.sign(TEXT, key)


def test_an_ssh_keygen_that_hangs_is_ended(tmp_path, monkeypatch):
    program = tmp_path / "ssh-keygen"
    program.write_text("#!/bin/sh\nexec sleep 60\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(signature, "_SIGN_WITHIN_S", 0.2)
    begin_s = time.monotonic()
    with pytest.raises(SignatureError, match="did not end within"):
        signature.sign(TEXT, tmp_path / "key")
    assert time.monotonic() - begin_s < 10
    program.unlink()
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SignatureError, match="apt install openssh-client"):
        signature.sign(TEXT, tmp_path / "key")
