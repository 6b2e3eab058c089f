"""The packages, each built once for all tests."""

import os
from pathlib import Path

import pytest

from tests.packaging.built import RELEASES, Deb, build, copy_tree, suite


@pytest.fixture(scope="session")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the packages are built from."""
    return copy_tree(tmp_path_factory.mktemp("source") / "tree")


@pytest.fixture(scope="session")
def deb(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Deb:
    """The one that VCU_DEB names, which the service is tested from; else one of this machine."""
    if given := os.environ.get("VCU_DEB"):
        path = Path(given)
        if not path.exists():
            pytest.skip("no package for this suite could be built")
    else:
        folder = tmp_path_factory.mktemp("deb")
        build(tree, "deb", folder)
        (path,) = folder.glob("*.deb")
    if suite() not in RELEASES:
        pytest.skip(f"looks at the package for {' and '.join(RELEASES)}")
    return Deb(path, RELEASES[suite()])


@pytest.fixture(scope="session")
def dist(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    build(tree, "dist", folder)
    return folder
