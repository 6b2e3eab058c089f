"""Recorded drives that every test here may copy."""

import shutil
from pathlib import Path

import pytest

from tests.replay import drives


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Drives by name, made once; a test that changes one copies it."""
    folder = tmp_path_factory.mktemp("recorded")
    made = {"ordinary": drives.ordinary, "every": drives.every_input, "limits": drives.limits}
    return {name: make(folder / name) for name, make in made.items()}


@pytest.fixture
def every(recorded: dict[str, Path], tmp_path: Path) -> Path:
    """A copy of the drive with every kind of input."""
    return shutil.copytree(recorded["every"], tmp_path / "every")
