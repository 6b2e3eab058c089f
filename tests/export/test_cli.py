"""`vcu-gateway export` from the command line: break one thing."""

import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from click.testing import CliRunner

from tests.export.logs import random_frames, write_log
from tests.replay.drives import ordinary
from vcu_gateway import cli
from vcu_gateway.errors import GatewayError
from vcu_gateway.recording import folder


class Ran(NamedTuple):
    code: int
    out: str
    err: str


def export(*arguments: object) -> Ran:
    done = CliRunner().invoke(cli.group, ["export", *map(str, arguments)])
    if isinstance(done.exception, GatewayError):
        return Ran(done.exception.exit_code, done.stdout, f"{done.stderr}error: {done.exception}")
    return Ran(done.exit_code, done.stdout, done.stderr)


@pytest.fixture
def log(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_log(tmp_path / "drive.log", random_frames(280))


@pytest.mark.parametrize("kind", ["csv", "html"])
def test_the_file_is_named_after_the_recording_and_its_path_is_printed(log, kind):
    done = export(log, "--to", kind)
    assert (done.code, done.out) == (0, f"drive.{kind}\n")
    assert done.err.startswith("frames 280: decoded 280, not decoded 0\n")
    assert sorted(os.listdir()) == sorted(["drive.log", f"drive.{kind}"])


def test_an_old_file_is_replaced_only_where_it_was_named(log):
    Path("drive.csv").write_text("mine")
    done = export(log, "--to", "csv")
    assert done.code == 2
    assert "drive.csv is there already; name it with -o to replace it" in done.err
    assert Path("drive.csv").read_text() == "mine"
    assert export(log, "--to", "csv", "-o", "drive.csv").code == 0
    assert Path("drive.csv").read_text().startswith("time,seconds,")


def test_a_second_to_and_from_name_a_part(log):
    whole = export(log, "--to", "csv", "-o", "whole.csv")
    part = export(log, "--to", "csv", "--from", "0.5", "--to", "1", "-o", "part.csv")
    assert whole.code == part.code == 0
    rows = [len(Path(name).read_text().splitlines()) - 1 for name in ("whole.csv", "part.csv")]
    assert rows == [43, 10]
    assert "not asked for" in part.err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--to", "mf5"], 'did you mean "mf4"?'),
        (["--to", "csv", "--to", "html"], "one format is needed"),
        (["--to", "csv", "--to", "noon"], "'noon' is no time such as 90.5"),
        (["--to", "csv", "--from", "x"], "'x' is no time"),
        (["--to", "csv", "--from", "9", "--to", "3"], "9 is later than 3"),
        (["--to", "csv", "--signals", "SCO"], "no signal of this recording is called SCO; did you"),
        (["--to", "csv", "-o", "drive.log"], "drive.log is the recording itself"),
        (["--to", "html", "-o", "."], ". is a folder"),
        ([], "Missing option '--to'"),
    ],
)
def test_a_wrong_command_line_is_told_and_writes_nothing(log, arguments, says):
    done = export(log, *arguments)
    assert done.code == 2
    assert says in done.err
    assert os.listdir() == ["drive.log"]


@pytest.mark.parametrize(
    ("name", "contents", "code", "says"),
    [
        ("none.log", None, 66, "none.log: cannot be read: No such file or directory"),
        ("empty.log", b"", 65, "holds no frame that can be read; it is empty"),
        ("noise.log", b"noise\n" * 20, 65, "holds no frame that can be read"),
        ("drive.pcap", b"", 66, ".pcap is no known format"),
        ("broken.blf", b"LOGG" + bytes(200), 65, "is damaged here"),
        ("cut.log.gz", b"\x1f\x8b\x08\x00", 65, "is damaged here"),
    ],
)
def test_a_recording_that_cannot_be_read_is_told(log, name, contents, code, says):
    if contents is not None:
        Path(name).write_bytes(contents)
    done = export(name, "--to", "csv", "-o", "out.csv")
    assert done.code == code
    assert says in done.err
    assert not Path("out.csv").exists()


def test_a_folder_that_is_no_drive_is_told(log):
    done = export(log.parent, "--to", "csv", "-o", "out.csv")
    assert done.code == 66
    assert "give the folder of a drive or an incident" in done.err


def test_a_place_that_cannot_be_written_is_told(log):
    done = export(log, "--to", "csv", "-o", "no/out.csv")
    assert done.code == 69
    assert "no/out.csv: cannot be written: No such file or directory" in done.err


@pytest.mark.parametrize(
    ("kind", "package"), [("mf4", "asammdf"), ("parquet", "pyarrow"), ("mcap", "mcap")]
)
def test_without_its_extra_a_format_says_what_to_install_and_where(log, kind, package):
    done = export(log, "--to", kind)
    assert done.code == 69
    assert f"writing {kind} needs the package {package}; " in done.err
    assert (
        f"python3 -m venv ~/vcu-tools && ~/vcu-tools/bin/pip install 'vcu-gateway[{kind}]'"
        in done.err
    )
    assert os.listdir() == ["drive.log"]


def test_standard_input_is_read(log):
    command = [sys.executable, "-m", "vcu_gateway", "export", "-", "--to", "csv", "-o", "out.csv"]
    with log.open("rb") as text:
        done = subprocess.run(command, stdin=text, capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert len(Path("out.csv").read_text().splitlines()) == 44


def test_a_dbc_of_ones_own_decodes(log):
    own = Path("own.dbc")
    text = (Path(__file__).parents[2] / "dbc" / "vcu.dbc").read_text()
    own.write_text(text.replace("MotorSpeed", "Revolutions"))
    assert export(log, "--to", "csv", "--dbc", own, "--signals", "Revolutions").code == 0
    assert "PCU1_Status2.Revolutions [rpm]" in Path("drive.csv").read_text().splitlines()[0]


def test_a_time_of_which_there_is_nothing_is_refused_and_nothing_is_written(log):
    done = export(log, "--to", "csv", "--from", "3600")
    assert done.code == 65
    assert "has nothing of that time" in done.err
    assert not Path("drive.csv").exists()


def test_a_recording_is_found_by_its_name(tmp_path, monkeypatch):
    monkeypatch.setattr(folder, "DEFAULT_FOLDER", tmp_path / "kept")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kept" / "drives").mkdir(parents=True)
    made = ordinary(tmp_path / "kept" / "drives" / "20261123T180412Z-1f3a9c2e", seconds=1.0)
    done = export(made.name, "--to", "csv")
    assert (done.code, done.out) == (0, f"{made.name}.csv\n")
