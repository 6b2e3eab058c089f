"""One gateway for the tests that leave it well; a fresh one where one did not."""

import contextlib
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

from tests.faults.driving import BusStand, Driving, driving_in
from tests.vcan.conftest import ended_after


class ReadyDriving:
    """Keeps one gateway ready to drive, from test to test."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._stack = contextlib.ExitStack()
        self._one: Driving | None = None
        self._count = 0

    def ready(self) -> Driving:
        if self._one is None or not self._one.is_well():
            self.clear()
            self._count += 1
            folder = self._folder / str(self._count)
            folder.mkdir()
            self._one = self._stack.enter_context(driving_in(folder))
        return self._one

    def clear(self) -> None:
        """End the one that is there; the interface has no gateway then."""
        self._stack.close()
        self._one = None


@pytest.fixture(scope="module")
def ready_driving(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ReadyDriving]:
    one = ReadyDriving(tmp_path_factory.mktemp("driving"))
    yield one
    one.clear()


@pytest.fixture
def driving(ready_driving: ReadyDriving, request: pytest.FixtureRequest) -> Iterator[Driving]:
    """With throttle on the bus; the invariants are held against it afterwards."""
    one = ready_driving.ready()
    try:
        one.until_driving()
        yield one
        one.check()
    except BaseException:
        ready_driving.clear()
        raise
    if request.node.stash.get(FAILED, False):
        ready_driving.clear()


FAILED = pytest.StashKey[bool]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    item.stash[FAILED] = item.stash.get(FAILED, False) or report.failed
    return report


@pytest.fixture
def alone(ready_driving: ReadyDriving, tmp_path: Path) -> Iterator[BusStand]:
    """A stand for a gateway of the test's own: no other is on the interface."""
    ready_driving.clear()
    with ended_after(BusStand(tmp_path, forking=True)) as stand:
        yield stand
