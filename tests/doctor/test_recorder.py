"""The recorder: running and connected, room, disk, latency, gaps."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from tests.doctor.judged import not_ok, only, well
from tests.doctor.test_service import TOLD
from tests.recorder.told import STATUS
from vcu_gateway.doctor import recorder
from vcu_gateway.doctor.check_result import CheckResult, CheckStatus, existing
from vcu_gateway.doctor.recorder import SOCKET_UNIT, RecorderFacts, RecordingDisk, judge
from vcu_gateway.doctor.service import ServiceFacts
from vcu_gateway.errors import Problem

GB = 10**9
DISK = RecordingDisk("ext4", False, 16 * GB)
HEALTHY = RecorderFacts(ServiceFacts(SOCKET_UNIT, TOLD), STATUS, 0.5, DISK, True)


def of(**changed: Any) -> list[CheckResult]:
    """Judged with another status."""
    return list(judge(HEALTHY._replace(status=STATUS._replace(**changed))))


def on(**changed: Any) -> list[CheckResult]:
    """Judged on another disk."""
    return list(judge(HEALTHY._replace(disk=DISK._replace(**changed))))


def unit(**changed: str) -> ServiceFacts:
    return ServiceFacts(SOCKET_UNIT, {**TOLD, **changed})


def test_a_healthy_recorder_says_how_long_its_ring_is():
    found = list(judge(HEALTHY))
    assert not_ok(found) == {}
    assert well(found) == (
        "running as 123, recording can0, no gaps, on the disk within 20 ms\n"
        "disk: ext4, room for 11 days of driving at 16 MB/h"
    )


def test_nothing_is_said_where_it_is_not_installed():
    facts = HEALTHY._replace(socket=ServiceFacts(SOCKET_UNIT, None))
    assert list(judge(facts)) == []


def test_one_that_is_switched_off_is_no_fault():
    facts = HEALTHY._replace(socket=unit(UnitFileState="disabled", ActiveState="inactive"))
    (found,) = judge(facts)
    assert found.kind is CheckStatus.OK
    assert "nothing is recorded" in found.what


def test_one_that_should_listen_and_does_not_is_a_warning():
    found = only(judge(HEALTHY._replace(socket=unit(ActiveState="inactive"))))
    assert found.remedy == f"sudo systemctl start {SOCKET_UNIT}"


def test_before_the_first_gateway_there_is_nothing_to_fault():
    found = list(judge(HEALTHY._replace(status=None, gateway_runs=False)))
    assert not_ok(found) == {}
    assert "no gateway has connected yet" in well(found)


def test_a_gateway_without_a_recorder_is_a_warning():
    assert not_ok(judge(HEALTHY._replace(status=None))) == {"status": "warning"}


def test_a_gateway_that_is_not_connected_is_a_warning():
    assert not_ok(of(connections=())) == {"connected": "warning"}
    standing = HEALTHY._replace(status=STATUS._replace(connections=()), gateway_runs=False)
    assert not_ok(judge(standing)) == {}


@pytest.mark.parametrize(("age_s", "found"), [(10.0, {}), (10.1, {"status": "warning"})])
def test_a_recorder_that_says_nothing_hangs_or_is_gone(age_s, found):
    assert not_ok(judge(HEALTHY._replace(age_s=age_s))) == found


def test_what_this_user_may_not_read_is_unknown():
    hidden = Problem("may not be read", "/run/vcu-gateway-recorder/status.json", "use sudo")
    found = only(judge(HEALTHY._replace(status=hidden)))
    assert (found.kind, found.remedy) == (CheckStatus.UNKNOWN, "use sudo")


@pytest.mark.parametrize(("lost", "found"), [(5000, {}), (5100, {"gaps": "warning"})])
def test_more_than_a_thousandth_in_gaps_is_a_warning(lost, found):
    totals = dataclasses.replace(STATUS.totals, gaps=3, frames_lost=lost)
    assert not_ok(of(totals=totals)) == found


@pytest.mark.parametrize("state", ["full", "failing", "stalled"])
def test_a_disk_that_takes_nothing_is_a_warning_with_what_waits(state):
    found = only(of(disk=state, last_error="No space left on device", waiting_bytes=12_000_000))
    assert found.check == "disk"
    assert "No space left on device" in found.what
    assert "12 of 34 MB wait in memory" in found.what


@pytest.mark.parametrize(("longest_s", "found"), [(1.0, {}), (1.1, {"latency": "warning"})])
def test_a_slow_disk_is_a_warning(longest_s, found):
    assert not_ok(of(longest_sync_s=longest_s)) == found


def test_before_the_first_write_there_is_no_latency():
    assert not_ok(of(longest_sync_s=None, last_sync_s=None)) == {}


def test_little_room_is_a_warning_that_says_how_little():
    found = only(on(free_bytes=(1 << 30) + 20_000_000))
    assert found.check == "room"
    assert found.what.startswith("the last 8 h of driving at 16 MB/h are kept")
    assert not_ok(on(free_bytes=(1 << 30) + 30_000_000)) == {}


def test_a_busy_bus_shortens_the_ring():
    assert "room for 12 h of driving at 360 MB/h" in well(of(bytes_a_second=100_000.0))
    assert not_ok(of(bytes_a_second=200_000.0)) == {"room": "warning"}


@pytest.mark.parametrize("kind", ["tmpfs", "ramfs"])
def test_memory_in_place_of_a_disk_is_a_warning(kind):
    found = only(on(file_system=kind))
    assert "a power cut takes all of them" in found.what


def test_a_read_only_file_system_is_a_warning():
    assert not_ok(on(is_read_only=True)) == {"file_system": "warning"}


def test_a_card_says_how_much_is_written_to_it():
    assert "SD card of 32 GB, 384 MB a day" in well(on(card="SD", card_bytes=32 * GB))


def test_a_small_card_is_worn_out_too_soon():
    found = only(on(card="SD", card_bytes=8 * GB))
    assert (found.check, "1.9 years" in found.what) == ("wear", True)


def test_an_emmc_says_itself_how_worn_it_is():
    worn = {"card": "MMC", "card_bytes": 64 * GB}
    assert not_ok(on(**worn, worn_pct=70)) == {}
    assert not_ok(on(**worn, worn_pct=80)) == {"wear": "warning"}


@pytest.mark.parametrize(
    ("told", "worn"),
    [("0x01 0x02", 20), ("0x0b 0x01", 110), ("0x00 0x00", None), ("junk", None), ("", None)],
)
def test_the_wear_of_an_emmc_is_the_larger_of_both_estimates(told, worn):
    assert recorder.worn_pct(told) == worn


def test_a_folder_that_is_there_has_a_file_system_and_room(tmp_path: Path):
    found = recorder.disk_of(str(tmp_path))
    assert found.free_bytes > 0
    assert found.file_system
    assert existing(str(tmp_path / "none"), recorder.disk_of) is None


@pytest.fixture
def without_a_recorder() -> None:
    """This machine has none; where it has, its own state would be read."""
    if Path("/run/vcu-gateway-recorder").exists():
        pytest.skip("a recorder is installed here")


def test_on_a_machine_without_one_nothing_is_read(without_a_recorder: None):
    facts = recorder.read(unit(), gateway_runs=False)
    assert facts.status is None
    assert facts.disk is None
