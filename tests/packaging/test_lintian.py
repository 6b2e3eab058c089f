"""Debian's own judge of packages, that of the release which the package is for."""

import shutil
import subprocess

import pytest

from tests.packaging.built import REPOSITORY, suite

pytestmark = [pytest.mark.ci, pytest.mark.timeout(1200)]  # the root may have to be built
# One list of overrides serves every release: one's lintian may not know the name of another's tag.
UNKNOWN = "alien-tag"


def test_lintian_finds_nothing_that_has_no_reason(deb, tmp_path):
    shutil.copy(deb.path, tmp_path / "one.deb")
    ask = ["lintian", "--allow-root", "--display-info", "--suppress-tags", UNKNOWN]
    done = subprocess.run(
        [REPOSITORY / "scripts/in-suite", suite(), tmp_path, *ask, tmp_path / "one.deb"],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
