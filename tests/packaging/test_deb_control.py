"""What dpkg is told: configuration files, scripts, and the same bytes from the same commit."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.packaging.built import BIN, Deb, build, epoch_s, suite

pytestmark = pytest.mark.timeout(1200)
SCRIPTS = ("postinst", "postrm", "prerm")


@pytest.fixture(scope="module")
def control(deb: Deb, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return deb.control(tmp_path_factory.mktemp("control"))


def test_the_configuration_is_the_one_file_that_upgrades_keep(control):
    assert (control / "conffiles").read_text().split() == ["/etc/vcu-gateway/gateway.yaml"]


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_script_is_one_for_every_shell(control, script):
    path = control / script
    assert path.read_text().startswith("#!/bin/sh\nset -e\n")
    for shell in (["dash", "-n"], ["bash", "--posix", "-n"]):
        done = subprocess.run([*shell, path], capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
    assert "#DEBHELPER#" not in path.read_text()


@pytest.mark.parametrize("name", ["exporter", "web", "pedals"])
def test_installing_enables_the_gateway_and_no_program_beside_it(control, name):
    script, name = (control / "postinst").read_text(), f"vcu-gateway-{name}.service"
    assert "deb-systemd-helper enable 'vcu-gateway.service'" in script
    was_enabled = f"if deb-systemd-helper --quiet was-enabled '{name}'"
    before, _, after = script.partition(f"deb-systemd-helper enable '{name}'")
    assert was_enabled in before or not after


def test_installing_enables_the_recorders_socket_and_starts_nothing(control):
    script = (control / "postinst").read_text()
    assert "deb-systemd-helper enable 'vcu-gateway-recorder.socket'" in script
    assert "invoke start" not in script


def test_the_recorder_ends_after_the_gateways_that_hand_over_to_it(control):
    script = (control / "prerm").read_text()
    assert 0 < script.index("stop vcu-gateway-exporter") < script.index("stop vcu-gateway-recorder")


def test_recordings_go_with_the_configuration_and_not_before(control):
    script = (control / "postrm").read_text()
    before, _, after = script.partition('if [ "$1" = purge ]; then\n    rm -rf /var')
    assert "/var/lib/vcu-gateway-recorder" in after
    assert "/var/lib/vcu-gateway-recorder" not in before


def test_the_sums_are_those_of_all_files_but_the_configuration(deb, control):
    listed = {line.split("  ", 1)[1] for line in (control / "md5sums").read_text().splitlines()}
    assert listed == set(deb.contents) - {"etc/vcu-gateway/gateway.yaml"}


@pytest.fixture
def copied(tree: Path, tmp_path: Path) -> Path:
    """A copy, to be changed."""
    return shutil.copytree(tree, tmp_path / "tree", symlinks=True)


@pytest.mark.ci
def test_building_again_elsewhere_in_a_clean_root_gives_the_same_bytes(deb, copied, tmp_path):
    elsewhere = {"TZ": "Asia/Tokyo", "LC_ALL": "C", "HOME": str(tmp_path), "PYTHONHASHSEED": "7"}
    folder = tmp_path / "another place"
    caches = {"UV_CACHE_DIR": uv_cache(), "XDG_CACHE_HOME": cache()}
    build(copied, "deb", folder, "--suite", suite(), **elsewhere, **caches)
    (again,) = folder.glob("*.deb")
    assert again.read_bytes() == deb.path.read_bytes()


def cache() -> str:
    """The user's, with the root that it is built in."""
    return os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")


def uv_cache() -> str:
    return subprocess.check_output([BIN / "uv", "cache", "dir"], text=True).strip()


def refusal(tree: Path, **environment: str) -> str:
    """The last line of scripts/deb, which ends with EX_UNAVAILABLE."""
    kept = {name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"}
    done = subprocess.run(
        [tree / "scripts" / "deb", BIN], env=kept | environment, capture_output=True, text=True
    )
    assert done.returncode == 69
    return done.stderr.splitlines()[-1]


def test_outside_of_git_the_time_must_be_given(copied):
    assert refusal(copied) == "error: this is no git checkout: set SOURCE_DATE_EPOCH, seconds"


def test_a_missing_unit_is_named(copied, deb):
    del deb  # the build tools are there
    (copied / "systemd" / "vcu-gateway@.service").unlink()
    said = refusal(copied, SOURCE_DATE_EPOCH=str(epoch_s()))
    assert said == "error: systemd/vcu-gateway@.service is missing"
