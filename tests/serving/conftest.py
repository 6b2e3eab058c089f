"""One running gateway for a whole file, and a fresh one where a test breaks it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.driven import Driven, driven


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    """In standby; tests leave it so."""
    with driven(tmp_path_factory.mktemp("running")) as one:
        one.until_ready()
        yield one


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[Driven]:
    """In standby; the test may do as it likes."""
    with driven(tmp_path) as one:
        one.until_ready()
        yield one
