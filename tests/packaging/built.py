"""What the tests of the packages share: building each once, and looking inside."""

import os
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
BIN = REPOSITORY / ".venv" / "bin"
EPOCH_S = 1_700_000_000
HOME = "usr/lib/vcu-gateway"
SITE = f"{HOME}/lib/python3.11/site-packages"
_NOT_HERE = 69  # EX_UNAVAILABLE


def copy_tree(folder: Path) -> Path:
    """The source tree as an archive would hold it: outside of git, and nobody works in it."""
    shutil.copytree(REPOSITORY, folder, symlinks=True, ignore=_left_out)
    shutil.copy(REPOSITORY / ".gitignore", folder)
    return folder


def _left_out(folder: str, names: list[str]) -> set[str]:
    if Path(folder) != REPOSITORY:
        return {"__pycache__"}
    return {name for name in names if name.startswith(".")} | {"build", "dist", "tests", "bench"}


def build(tree: Path, script: str, folder: Path, **environment: str) -> None:
    """Run it into the folder; where this machine cannot build, that is a failure on CI alone."""
    done = subprocess.run(
        [tree / "scripts" / script, BIN, folder],
        env={**os.environ, "SOURCE_DATE_EPOCH": str(EPOCH_S), **environment},
        capture_output=True,
        text=True,
    )
    if done.returncode == _NOT_HERE and "CI" not in os.environ:
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr


class Deb:
    """A Debian package, opened."""

    def __init__(self, path: Path) -> None:
        self.path = path
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

    def text(self, name: str) -> str:
        return self.contents[name].decode()

    def field(self, name: str) -> str:
        return subprocess.check_output(["dpkg-deb", "-f", self.path, name], text=True).strip()

    def control(self, folder: Path) -> Path:
        """The folder with the control files in it."""
        subprocess.run(["dpkg-deb", "-e", self.path, folder], check=True)
        return folder
