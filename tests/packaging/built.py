"""What the tests of the packages share: building each once, and looking inside."""

import os
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path
from typing import NamedTuple

import pytest

REPOSITORY = Path(__file__).parents[2]
BIN = REPOSITORY / ".venv" / "bin"
_EPOCH_S = 1_700_000_000  # where there is no git
HOME = "usr/lib/vcu-gateway"
_NOT_HERE = 69  # EX_UNAVAILABLE


class Release(NamedTuple):
    """A Debian that the package is built for."""

    number: int
    python: str
    units: str  # where its debhelper puts them


RELEASES = {
    "bookworm": Release(12, "3.11", "lib/systemd/system"),
    "trixie": Release(13, "3.13", "usr/lib/systemd/system"),
}


def suite() -> str:
    """The one that is asked for, else the machine's."""
    own = subprocess.check_output([REPOSITORY / "scripts" / "own-suite"], text=True).strip()
    return os.environ.get("VCU_SUITE", own)


def epoch_s() -> int:
    """What scripts/deb takes: as given, else when what the package is made of last changed."""
    if given := os.environ.get("SOURCE_DATE_EPOCH"):
        return int(given)
    made_of = subprocess.check_output([REPOSITORY / "scripts" / "deb", "--made-of"], text=True)
    log = ["git", "-C", str(REPOSITORY), "log", "-1", "--format=%ct", "--", *made_of.split()]
    done = subprocess.run(log, capture_output=True, text=True)
    return int(done.stdout) if done.returncode == 0 else _EPOCH_S


def copy_tree(folder: Path) -> Path:
    """The source tree as an archive would hold it: outside of git, and nobody works in it."""
    shutil.copytree(REPOSITORY, folder, symlinks=True, ignore=_left_out)
    shutil.copy(REPOSITORY / ".gitignore", folder)
    return folder


def _left_out(folder: str, names: list[str]) -> set[str]:
    if Path(folder) != REPOSITORY:
        return {"__pycache__"}
    return {name for name in names if name.startswith(".")} | {"build", "dist", "tests", "bench"}


def build(tree: Path, script: str, folder: Path, *options: str, **environment: str) -> None:
    """Run it into the folder; where this machine cannot build, that is a failure on CI alone."""
    done = subprocess.run(
        [tree / "scripts" / script, *options, BIN, folder],
        env={**os.environ, "SOURCE_DATE_EPOCH": str(epoch_s()), "DEB_INSTALL": "no", **environment},
        capture_output=True,
        text=True,
    )
    if done.returncode == _NOT_HERE and "CI" not in os.environ:
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr


class Deb:
    """A Debian package for a release, opened."""

    def __init__(self, path: Path, release: Release) -> None:
        self.path = path
        self.release = release
        self.site = f"{HOME}/lib/python{release.python}/site-packages"
        with tempfile.TemporaryFile() as file:
            subprocess.run(["dpkg-deb", "--fsys-tarfile", path], stdout=file, check=True)
            file.seek(0)
            with tarfile.open(fileobj=file) as archive:
                self.members = {member.name[2:]: member for member in archive if member.name != "."}
                self.contents = {
                    name: archive.extractfile(member).read()
                    for name, member in self.members.items()
                    if member.isfile()
                }

    def place(self, name: str) -> str:
        """A path with {site}, {units} or {rules} in it, as this release has it."""
        units = self.release.units
        rules = units.replace("systemd/system", "udev/rules.d")
        return name.format(site=self.site, units=units, rules=rules)

    def text(self, name: str) -> str:
        return self.contents[name].decode()

    def field(self, name: str) -> str:
        return subprocess.check_output(["dpkg-deb", "-f", self.path, name], text=True).strip()

    def control(self, folder: Path) -> Path:
        """The folder with the control files in it."""
        subprocess.run(["dpkg-deb", "-e", self.path, folder], check=True)
        return folder
