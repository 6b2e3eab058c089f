"""One running gateway for a whole file, and a fresh one where a test breaks it."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.driven import Driven, driven
from vcu_gateway.client import RefusedError

# The vehicle is a thread of this process: on a busy machine it is late, and not silent.
PATIENT = (
    "freshness: {stale_after_ms: {PCU1_Status1: 10000, PCU1_Status2: 400,"
    " PCU2_Status1: 10000, PCU2_Status2: 400, BMS_Status: 3200}}\n"
)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    with driven(tmp_path_factory.mktemp("running"), always=PATIENT) as one:
        one.until_ready()
        yield one


def is_reset(one: Driven) -> bool:
    """Not where a vehicle that the machine held up is a reason to stop again."""
    with one.client() as client, contextlib.suppress(RefusedError):
        client.reset("service")
        return True
    return False


@pytest.fixture
def running(shared: Driven) -> Driven:
    """In standby; tests leave it so, but where the machine stood still and it stopped for that."""
    if shared.mode == "fault":
        shared.until(lambda: is_reset(shared), "a reset")
    shared.until_ready()
    return shared


@pytest.fixture
def fresh(tmp_path: Path) -> Iterator[Driven]:
    """In standby; the test may do as it likes."""
    with driven(tmp_path, always=PATIENT) as one:
        one.until_ready()
        yield one
