"""The recorder that `recordings keep now` asks: one that writes into this folder, now."""

import time
from pathlib import Path

import pytest

from tests.recorder.told import STATUS
from vcu_gateway.errors import UnavailableError
from vcu_gateway.recording import layout
from vcu_gateway.recording.folder import RecordingFolder
from vcu_gateway.recording.keep import running
from vcu_gateway.recording.recorder_status import STALE_S


@pytest.fixture
def folder(tmp_path: Path) -> RecordingFolder:
    (tmp_path / "kept" / layout.DRIVES).mkdir(parents=True)
    return RecordingFolder(tmp_path / "kept")


def write(path: Path, folder: Path, age_s: float = 0.1, gateways: int = 1) -> Path:
    """A status as the recorder writes it."""
    status = STATUS._replace(
        folder=str(folder),
        written_monotonic_ns=time.monotonic_ns() - int(age_s * 1e9),
        connections=STATUS.connections[:gateways],
    )
    path.write_text(status.text())
    return path


def test_a_recorder_that_says_in_the_folder_how_it_goes_is_found(folder):
    write(folder.path / "status.json", folder.path)
    assert running(folder).pid == STATUS.pid


def test_a_recorder_of_another_folder_is_not_asked(folder, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    path = write(tmp_path / "status.json", other)
    with pytest.raises(UnavailableError, match=rf"writes into {other}, not here.*--folder"):
        running(folder, path)
    path = write(tmp_path / "status.json", tmp_path / "gone")
    with pytest.raises(UnavailableError, match="not here"):
        running(folder, path)


@pytest.mark.parametrize(
    ("age_s", "said"), [(STALE_S + 5, "is 15 s old"), (-60, "before this computer's start")]
)
def test_a_process_number_in_an_old_status_is_nobody_to_be_asked(folder, age_s, said):
    write(folder.path / "status.json", folder.path, age_s)
    with pytest.raises(UnavailableError, match=f"no recorder runs: .*{said}"):
        running(folder)


def test_a_recorder_without_a_gateway_has_nothing_to_keep(folder):
    write(folder.path / "status.json", folder.path, gateways=0)
    with pytest.raises(UnavailableError, match="no gateway is connected"):
        running(folder)
