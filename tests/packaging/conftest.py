"""The packages, each built once for all tests."""

from pathlib import Path

import pytest

from tests.packaging.built import Deb, build, copy_tree


@pytest.fixture(scope="session")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the packages are built from."""
    return copy_tree(tmp_path_factory.mktemp("source") / "tree")


@pytest.fixture(scope="session")
def deb(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Deb:
    folder = tmp_path_factory.mktemp("deb")
    build(tree, "deb", folder)
    (path,) = folder.glob("*.deb")
    return Deb(path)


@pytest.fixture(scope="session")
def dist(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    build(tree, "dist", folder)
    return folder
