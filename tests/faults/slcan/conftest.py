"""A gateway on an slcan adapter; vehicle and recorder on vcan0, the wire behind it."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.faults.driving import BusStand, Driving
from tests.faults.slcan.adapter import Adapter
from tests.vcan.conftest import ended_after


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
def shared(adapter: Adapter, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driving]:
    with ended_after(BusStand(tmp_path_factory.mktemp("slcan"), forking=True)) as stand:
        stand.channel = adapter.name
        one = Driving(stand, wire="vcan0")
        one.until_serving()
        one.start_vehicle()
        yield one
        one.let_go()


@pytest.fixture
def driving(shared: Driving) -> Iterator[Driving]:
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
