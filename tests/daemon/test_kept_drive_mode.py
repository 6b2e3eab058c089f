"""A drive mode that only the service level leaves, kept for the next start."""

from pathlib import Path

import pytest

from tests.core.simulated_drive import CODEC, NOW_NS
from vcu_gateway.core import calls
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.core.tuning import DriveMode, Tuning
from vcu_gateway.daemon.events import EventLog
from vcu_gateway.daemon.restart_state import KeptDriveMode

TUNING = Tuning(start="eco", modes={"eco": DriveMode(), "valet": DriveMode(left_by_service=True)})


class Process:
    """A gateway from its start on."""

    def __init__(self, folder: Path, tuning: Tuning = TUNING) -> None:
        self.gateway = Gateway(CODEC, Settings(tuning=tuning), NOW_NS)
        self.event_log = EventLog()
        self.kept = KeptDriveMode(folder, "can0", self.gateway, self.event_log)
        self.kept.begin()
        self.now_ns = NOW_NS

    def tick(self) -> None:
        self.now_ns += 50_000_000
        self.kept.observe(self.gateway.tick(self.now_ns))

    def ask(self, mode: str) -> None:
        self.gateway.apply(calls.SetDriveMode(mode, FaultClass.SERVICE, self.now_ns))
        self.tick()

    @property
    def events(self) -> list[str]:
        return [entry.event.name for entry in self.event_log.latest(10)]


def test_a_mode_left_by_service_is_the_next_process_s_too(tmp_path):
    first = Process(tmp_path)
    first.tick()
    first.ask("valet")
    assert Process(tmp_path).gateway.drive_modes == ("valet", "valet")


def test_another_mode_is_not_kept_and_one_that_was_left_is_forgotten(tmp_path):
    first = Process(tmp_path)
    first.ask("valet")
    first.ask("eco")
    assert list(tmp_path.iterdir()) == []
    assert Process(tmp_path).gateway.drive_modes == ("eco", "eco")


def test_a_mode_that_the_configuration_has_no_more_changes_nothing(tmp_path):
    Process(tmp_path).ask("valet")
    without = Process(tmp_path, Tuning(start="eco", modes={"eco": DriveMode()}))
    without.tick()
    assert without.gateway.drive_modes == ("eco", "eco")
    assert list(tmp_path.iterdir()) == []


def test_without_modes_nothing_is_written(tmp_path):
    process = Process(tmp_path, Tuning())
    process.tick()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_told_once(tmp_path):
    process = Process(tmp_path / "gone")
    process.ask("valet")
    process.tick()
    assert process.events == ["drive_mode_unwritten"]


def test_a_file_that_cannot_be_read_is_told(tmp_path):
    (tmp_path / "drive-mode-can0").mkdir()
    assert Process(tmp_path).events == ["drive_mode_unread"]


def test_the_state_folder_counts_before_the_runtime_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path / 'state'}:/other")
    gateway, log = Process(tmp_path).gateway, EventLog()
    kept = KeptDriveMode.of("can0", gateway, log, tmp_path)
    assert kept is not None
    assert kept._path.parent == tmp_path / "state"
    monkeypatch.delenv("STATE_DIRECTORY")
    assert KeptDriveMode.of("can0", gateway, log, None) is None


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"valet" * 100])
def test_a_damaged_file_changes_nothing(tmp_path, content):
    (tmp_path / "drive-mode-can0").write_bytes(content)
    assert Process(tmp_path).gateway.drive_modes == ("eco", "eco")
