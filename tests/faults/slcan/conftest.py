"""A gateway on an slcan adapter; vehicle and recorder on vcan0, the wire behind it."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults import judged_bus
from tests.faults.driving import RECORDER, BusStand, Driving
from tests.faults.slcan.adapter import Adapter
from tests.vcan.conftest import Recording, ended_after, wait_until


class Adapted(Driving):
    """A gateway whose frames an adapter passes on to the wire, as soon as the adapter can.

    Attributes:
        near: the frames as the gateway and the kernel exchange them, stamped when the kernel takes
            them: the wire would show when the adapter passed them on.
    """

    def __init__(self, stand: BusStand) -> None:
        path = stand.folder / "near"
        command = (sys.executable, str(RECORDER), str(path), f"={stand.channel}")
        child = stand.start("near", *command)
        wait_until(lambda: child.out.read_text() == "ready\n", "the recorder near the gateway")
        self.near = Recording(child, path)
        self._near_checked_to = 0
        super().__init__(stand, wire="vcan0")

    def check(self) -> None:
        """docs/safety.md, Invariants: on what the gateway sent since the last check."""
        frames, log = self.near.frames(), self.gateway.log()
        begin, self._near_checked_to = self._near_checked_to, len(frames)
        checked = judged_bus.check(frames[begin:], log=log)
        assert checked.frames > 0


@pytest.fixture(scope="module")
def adapter() -> Iterator[Adapter]:
    try:
        one = Adapter()
    except OSError as error:
        why = f"no slcan here: {error}; the lab has it with --modules slcan"
        if os.environ.get("CI") or os.environ.get("VCU_REQUIRE_CAN"):
            pytest.exit(why, returncode=1)
        pytest.skip(why)
    one.up()
    yield one
    one.close()


@pytest.fixture(scope="module")
def shared(adapter: Adapter, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Adapted]:
    with ended_after(BusStand(tmp_path_factory.mktemp("slcan"), forking=True)) as stand:
        stand.channel = adapter.name
        one = Adapted(stand)
        one.until_serving()
        one.start_vehicle()
        yield one
        one.let_go()


@pytest.fixture
def driving(shared: Adapted) -> Iterator[Adapted]:
    """With throttle on the wire; the invariants are held against it afterwards."""
    shared.until_driving()
    yield shared
    shared.check()


@pytest.fixture
def alone(adapter: Adapter, tmp_path: Path) -> Iterator[BusStand]:
    """For a gateway of the test's own, on the adapter."""
    with ended_after(BusStand(tmp_path, forking=True)) as stand:
        stand.channel = adapter.name
        yield stand
