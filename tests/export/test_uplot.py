"""uPlot, as npm has it: version, licence and checksums."""

import hashlib

import pytest

from vcu_gateway.export.html_report import UPLOT

# Of uplot-1.6.32.tgz, whose integrity in the registry is
# sha512-KIMVnG68zvu5XXUbC4LQEPnhwOxBuLyW1AHtpm6IKTXImkbLgkMy+jabjLgSLMasNuGGzQm/ep3tOkyTxpiQIw==
SHA256 = {
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}


@pytest.mark.parametrize("name", SHA256)
def test_it_is_unchanged(name):
    assert hashlib.sha256((UPLOT / name).read_bytes()).hexdigest() == SHA256[name]


def test_nothing_else_lies_beside_it():
    assert {path.name for path in UPLOT.iterdir()} == set(SHA256)


@pytest.mark.ci
def test_its_licence_and_version_go_with_it():
    assert "MIT License" in (UPLOT / "LICENSE").read_text()
    assert "uPlot (v1.6.32)" in (UPLOT / "uPlot.iife.min.js").read_text()[:200]
