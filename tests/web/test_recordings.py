"""Recordings in the page: listed, given away whole, computed again, within limits."""

import io
import resource
import shutil
import tarfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from playwright.sync_api import FilePayload

from tests.replay.drives import ordinary
from tests.web.browser import PICTURES, chromium, context_of, opened
from tests.web.conftest import PASSWORD
from tests.web.stand import WebProcess, serving
from vcu_gateway.web.recordings import archive

SLOWER = b"bus: {channel: can0}\nlimits: {throttle_slew_pct_per_s: 20.0}\n"
NAME = "20261123T180412Z-1f3a9c2e"


def broken_drive(parent: Path) -> Path:
    """A recorder's folder with one drive that is none: its parts are there, and cannot be read."""
    drive = parent / "recordings" / "drives" / NAME
    drive.mkdir(parents=True)
    (parent / "recordings" / "incidents").mkdir()
    (drive / "drive.json").write_text("{}")
    (drive / "0001.frames.log.gz").write_bytes(bytes(range(256)) * 300)
    (drive / "secret").symlink_to("/etc/passwd")
    return parent / "recordings"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Of all tests that leave it as it is."""
    return broken_drive(tmp_path_factory.mktemp("recorded"))


@pytest.fixture(scope="module")
def web(tmp_path_factory, gateway, folder):
    options = ("--local-role", "operator", "--recordings", str(folder))
    with serving(tmp_path_factory.mktemp("web"), gateway.socket_path, *options) as one:
        yield one


@pytest.fixture
def own_folder(tmp_path) -> Path:
    """To be broken."""
    return broken_drive(tmp_path)


@pytest.fixture
def own_web(tmp_path, gateway, own_folder):
    """To be broken."""
    options = ("--local-role", "operator", "--recordings", str(own_folder))
    with serving(tmp_path, gateway.socket_path, *options) as one:
        yield one


def path(what: str, name: str = NAME, kind: str = "drives") -> str:
    return f"/api/recordings/{kind}/{name}/{what}"


def test_what_the_recorder_wrote_is_listed(web):
    (one,) = web.request("GET", "/api/recordings").json["recordings"]
    assert (one["kind"], one["name"]) == ("drive", NAME)
    assert one["size_bytes"] > 70_000


def test_a_download_has_every_file_and_no_link(web, folder):
    answer = web.request("GET", path("download"))
    assert answer.headers["content-disposition"] == f'attachment; filename="{NAME}.tar"'
    with tarfile.open(fileobj=io.BytesIO(answer.body)) as tar:
        assert tar.getnames() == [f"{NAME}/0001.frames.log.gz", f"{NAME}/drive.json"]
        frames = tar.extractfile(f"{NAME}/0001.frames.log.gz")
        assert frames is not None
        assert frames.read() == (folder / "drives" / NAME / "0001.frames.log.gz").read_bytes()
    assert web.events("recording_downloaded")[0]["recording"] == NAME


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("..", "drives"),
        ("%2e%2e", "drives"),
        (NAME, "other"),
        (NAME, "..%2fdrives"),
        ("x", "drives"),
    ],
)
def test_nothing_but_a_recordings_folder_is_given_away(web, name, kind):
    assert web.request("GET", path("download", name, kind)).status == 404


def test_a_link_to_another_folder_is_no_recording(own_web, own_folder, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    (own_folder / "drives" / "20261123T180412Z-00000000").symlink_to(other)
    assert own_web.request("GET", path("download", "20261123T180412Z-00000000")).status == 404


def test_a_recording_that_cannot_be_replayed_is_a_sentence(web):
    answer = web.request("POST", path("replay"))
    assert answer.status == 422
    assert "drive.json" in answer.json["sentence"]


def test_a_wrong_configuration_is_named_without_the_name_of_a_temporary_file(web):
    answer = web.request("POST", path("what-if"), b"limits: {speed: 1}")
    assert answer.status == 422
    assert "vcu-web." not in answer.json["sentence"]


def test_a_configuration_that_is_too_large_is_refused(web):
    assert web.request("POST", path("what-if"), bytes(70_000)).status == 413


@pytest.mark.parametrize(
    "config",
    [
        b"a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\n",
        b"[" * 60_000,
        b"{a: " * 15_000,
        b"limits: {" + b", ".join(b"k%d: 1" % number for number in range(6000)) + b"}",
        b"\xff\xfe\x00",
        b"!!python/object/apply:os.system [id]",
        b"include: /etc/shadow",
        b"",
    ],
    ids=["aliases", "depth", "maps", "keys", "bytes", "tag", "include", "empty"],
)
def test_a_hostile_configuration_is_a_sentence_and_soon(web, config):
    begin_s = time.monotonic()
    answer = web.request("POST", path("what-if"), config)
    assert answer.status == 422
    assert 0 < len(answer.json["sentence"]) < 10_000
    assert time.monotonic() - begin_s < 20
    assert web.request("GET", "/").status == 200


def test_a_full_disk_is_a_sentence_and_the_page_goes_on(own_web):
    resource.prlimit(own_web.process.pid, resource.RLIMIT_FSIZE, (0, 0))  # no file has any room
    answer = own_web.request("POST", path("what-if"), SLOWER)
    assert answer.status == 507
    assert "cannot be kept" in answer.json["sentence"]
    assert own_web.act("estop").json["granted"] is True


def test_whoever_lists_does_not_wait_for_a_replay(tmp_path, gateway, driven):
    options = ("--local-role", "operator", "--recordings", str(driven))
    with serving(tmp_path, gateway.socket_path, *options) as web, ThreadPoolExecutor() as pool:
        replays = [pool.submit(web.request, "POST", path("replay")) for _ in range(2)]
        assert len(web.request("GET", "/api/recordings").json["recordings"]) == 1
        assert sorted(one.result().status for one in replays) == [200, 429]


def test_a_large_file_is_given_away_in_pieces_also_where_it_changes(tmp_path):
    folder = tmp_path / NAME
    folder.mkdir()
    large = folder / "0001.frames.log.gz"
    large.write_bytes(bytes(range(251)) * 10_000)
    pieces = archive(folder)
    begun = [next(pieces), next(pieces)]
    large.write_bytes(b"shorter")
    whole = [*begun, *pieces]
    assert max(map(len, whole)) <= 65_536
    with tarfile.open(fileobj=io.BytesIO(b"".join(whole))) as tar:
        (entry,) = tar.getmembers()
        assert entry.size == 2_510_000
        assert not entry.uid


def test_recordings_are_for_operators(tmp_path, gateway, folder, users_file):
    options = ("--users", str(users_file), "--recordings", str(folder))
    with serving(tmp_path, gateway.socket_path, *options) as web:
        web.sign_in("anna", PASSWORD)
        assert web.request("GET", "/api/recordings").status == 403
        assert web.request("GET", path("download")).status == 403
        assert web.request("POST", path("replay")).status == 403


def test_without_a_recorder_the_list_says_why_it_is_empty(tmp_path, gateway):
    with serving(tmp_path, gateway.socket_path, "--local-role", "operator") as web:
        listed = web.request("GET", "/api/recordings").json
    assert listed["recordings"] == []
    assert "--recordings" in listed["sentence"]


def test_a_folder_that_went_away_is_a_sentence(own_web: WebProcess, own_folder):
    shutil.rmtree(own_folder)
    listed = own_web.request("GET", "/api/recordings").json
    assert listed["recordings"] == []
    assert "cannot be read" in listed["sentence"]


@pytest.fixture(scope="module")
def driven(tmp_path_factory) -> Path:
    """A recorder's folder with a real drive in it."""
    folder = tmp_path_factory.mktemp("driven")
    (folder / "incidents").mkdir()
    (folder / "drives").mkdir()
    recorded = ordinary(folder / "made")
    shutil.move(recorded, folder / "drives" / NAME)
    return folder


def test_a_drive_comes_out_the_same_and_with_another_configuration_not(tmp_path, gateway, driven):
    options = ("--local-role", "operator", "--recordings", str(driven))
    with serving(tmp_path, gateway.socket_path, *options) as web:
        same = web.request("POST", path("replay")).json
        other = web.request("POST", path("what-if"), SLOWER).json
    assert same["same"] is True, same["lines"]
    assert any(line.startswith("equal: ") for line in same["lines"])
    assert other["same"] is False


@pytest.mark.ci
def test_a_browser_replays_and_asks_what_if(tmp_path, gateway, driven):
    options = ("--local-role", "operator", "--recordings", str(driven))
    with (
        serving(tmp_path, gateway.socket_path, *options) as web,
        chromium() as browser,
        context_of(browser) as context,
    ):
        page, seen = opened(context, web.url, "recordings")
        page.get_by_role("button", name="Replay").click()
        page.wait_for_selector("pre:text('The same.')", timeout=60_000)
        upload: FilePayload = {"name": "gateway.yaml", "mimeType": "text/yaml", "buffer": SLOWER}
        page.set_input_files("input[type=file]", upload)
        page.wait_for_selector("pre:text('It differs.')", timeout=60_000)
        PICTURES.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=PICTURES / "replayed-1024.png")
        assert seen.errors == []
        with page.expect_download() as started:
            page.get_by_role("link", name="Download").click()
        assert started.value.suggested_filename == f"{NAME}.tar"
