"""The installed package under a real systemd, a healthy vehicle and a recorder on vcan0."""

import json
import os
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.faults.driving import QUIET, record
from tests.service.driver import Driver
from tests.service.unit import CONFIG, NAME, Unit, systemctl
from tests.vcan.conftest import (
    COMMANDS,
    Recording,
    Stand,
    ended_after,
    figures,  # noqa: F401 - a fixture
    pytest_terminal_summary,  # noqa: F401 - a hook of pytest
)

MEMBER, STRANGER = "member", "stranger"


def service_is_missing() -> str | None:
    """Why these tests cannot run here, or None."""
    if os.environ.get("VCU_LAB") != "systemd":
        return "needs a machine to throw away: `make test-service` boots one in the lab"
    if not Path("/lib/systemd/system", NAME).exists():
        return "the package is not installed: `lab run --systemd --install build/deb/*.deb`"
    return None


@pytest.fixture(scope="session", autouse=True)
def a_real_systemd() -> None:
    why = service_is_missing()
    if why and os.environ.get("VCU_REQUIRE_SYSTEMD"):
        pytest.exit(why, returncode=1)
    if why:
        pytest.skip(why)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A guest on a busy machine takes its time. What removes the package comes last."""
    items.sort(key=lambda item: item.path.name == "test_package.py")
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.timeout(600), append=False)


class Booted(NamedTuple):
    """The service as the boot left it, before any test."""

    state: str
    enabled: str
    restarts: int
    pid: int
    ready_us: int  # from systemd's start
    warnings: list[str]  # of systemd about it


@pytest.fixture(scope="session", autouse=True)
def booted(a_real_systemd: None) -> Booted:
    return as_booted()


@cache  # a test that is taken again asks for all fixtures anew
def as_booted() -> Booted:
    unit = Unit()
    begun_us = int(systemctl("show", "--property=UserspaceTimestampMonotonic", "--value").stdout)
    return Booted(
        unit.show("ActiveState"),
        unit.show("UnitFileState"),
        unit.number("NRestarts"),
        unit.pid,
        unit.number("ActiveEnterTimestampMonotonic") - begun_us,
        warnings_of_systemd(),
    )


def warnings_of_systemd() -> list[str]:
    """What the journal has of the package's files, but for what the gateway itself said."""
    subprocess.run(["journalctl", "--sync"], check=True)
    ask = ["journalctl", "--boot", "--priority=warning", "--output=json"]
    lines = subprocess.run(ask, capture_output=True, text=True).stdout.splitlines()
    told = [json.loads(line) for line in lines]
    return [
        str(one["MESSAGE"])
        for one in told
        if one.get("SYSLOG_IDENTIFIER") != "vcu-gateway" and "vcu-gateway" in str(one)
    ]


@pytest.fixture(scope="session")
def default_config(booted: Booted) -> str:
    """As the package brings it."""
    return as_packaged()


@cache
def as_packaged() -> str:
    return CONFIG.read_text()


@pytest.fixture(scope="session")
def stand(booted: Booted, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    """Processes that outlive every gateway; forked from this one."""
    with ended_after(Stand(tmp_path_factory.mktemp("stand"), forking=True)) as stand:
        yield stand


@pytest.fixture(scope="session")
def bus(stand: Stand) -> Recording:
    """The command frames of every interface, by a process of its own."""
    return record(stand, "", COMMANDS)


@pytest.fixture(scope="session")
def vehicle(stand: Stand) -> None:
    """A healthy one on vcan0, as long as the tests last.

    Below the gateway and above the rest: apt keeps the lab's one processor busy for seconds.
    """
    ordinary = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))  # a forked process has it, too
    try:
        stand.vehicle(QUIET)
    finally:
        os.sched_setscheduler(0, *ordinary)


def configure(text: str, channel: str = "vcan0") -> None:
    CONFIG.write_text(text.replace("channel: can0", f"channel: {channel}"))


def fresh(config: str) -> Unit:
    one = Unit()
    one.clear()
    configure(config)
    return Unit()


@pytest.fixture
def unit(default_config: str) -> Unit:
    """The service, stopped, on vcan0; nothing is left of earlier runs."""
    return fresh(default_config)


@pytest.fixture
def service(unit: Unit, vehicle: None) -> Unit:
    """Started, beside a healthy vehicle."""
    unit.start()
    return unit


@pytest.fixture(scope="module")
def steady(default_config: str, vehicle: None) -> Unit:
    """The same, but one for all tests of a module: they look at it, drive it and leave it whole."""
    one = fresh(default_config)
    one.start()
    return one


@pytest.fixture
def driver(bus: Recording) -> Iterator[Driver]:
    one = Driver(bus)
    yield one
    one.let_go()


@pytest.fixture(scope="session")
def people(booted: Booted) -> Iterator[None]:
    """Two users, one of them a member of the socket's group."""
    users = {MEMBER: ["-G", "vcu-gateway"], STRANGER: []}
    for name, groups in users.items():
        subprocess.run(["useradd", *groups, name], check=True)
    yield
    for name in users:
        subprocess.run(["userdel", "--force", name], check=True)
