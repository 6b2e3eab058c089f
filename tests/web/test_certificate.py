"""The end of the page's certificate, read from certificates that openssl made."""

import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from vcu_gateway.web.application import end_of, ending_sentence

NOW = datetime(2026, 11, 25, 12, tzinfo=UTC)


def certificate(folder: Path, name: str, days: int) -> str:
    chain = folder / f"{name}.pem"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
    command += ["-nodes", "-days", str(days), "-subj", "/CN=vcu", "-keyout", f"{folder}/key.pem"]
    subprocess.run([*command, "-out", str(chain)], check=True, capture_output=True)
    return chain.read_text()


@pytest.mark.parametrize("days", [2, 20_000])
def test_the_end_is_what_openssl_says_in_this_century_and_after_2050(tmp_path, days):
    certificate(tmp_path, "chain", days)
    command = ["openssl", "x509", "-noout", "-enddate", "-in", tmp_path / "chain.pem"]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    end = end_of(tmp_path / "chain.pem")
    assert end.strftime("notAfter=%b %e %H:%M:%S %Y GMT") == said


def test_of_a_chain_the_first_end_counts(tmp_path):
    longer, shorter = certificate(tmp_path, "a", 90), certificate(tmp_path, "b", 2)
    (tmp_path / "chain.pem").write_text(longer + "\n" + shorter)
    assert end_of(tmp_path / "chain.pem") == end_of(tmp_path / "b.pem")


@pytest.mark.parametrize(
    "text", ["", "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----"]
)
def test_what_is_no_certificate_has_no_end(tmp_path, text):
    (tmp_path / "chain.pem").write_text(text)
    with pytest.raises(ValueError, match="has no certificate"):
        end_of(tmp_path / "chain.pem")


@pytest.mark.parametrize(
    ("left", "said"),
    [
        (timedelta(days=30, seconds=1), None),
        (timedelta(days=30), "ends on 2026-12-25 12:00 UTC"),
        (timedelta(seconds=1), "ends on 2026-11-25 12:00 UTC"),
        (timedelta(0), "ended on 2026-11-25 12:00 UTC"),
    ],
)
def test_a_person_is_told_in_the_last_thirty_days_and_after_them(left, said):
    sentence = ending_sentence(NOW + left, NOW)
    assert sentence is None if said is None else said in (sentence or "")
