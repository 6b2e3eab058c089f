"""Files made by hand: every verb answers with an error, soon, and with little memory."""

import gzip
import json
import os
import resource
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.replay.drives import ordinary
from vcu_gateway.recording import layout
from vcu_gateway.recording.members import packed

MOST_MEMORY_BYTES = 400 << 20
MOST_S = 10
VERBS = {
    "list": ["recordings", "list", "--folder", "."],
    "check": ["recordings", "check", "--folder", "."],
    "keep": ["recordings", "keep", "drive", "--from", "0", "--to", "1", "--folder", "."],
    "replay": ["replay", "./drives/drive"],
    "what-if": ["replay", "./drives/drive", "--set", "limits.derated_power_w=5000"],
    "export": ["export", "./drives/drive", "--to", "csv", "-o", "out.csv"],
}


def description(change: Callable[[dict], object]) -> Callable[[Path], None]:
    def made(folder: Path) -> None:
        path = folder / layout.DRIVE_FILE
        values = json.loads(path.read_text())
        change(values)
        path.write_text(json.dumps(values).replace('"TOO LARGE"', "1e400"))

    return made


def clock(value: object) -> Callable[[Path], None]:
    def change(values: dict) -> None:
        values["clock"]["wall_ns"] = value

    return description(change)


def written(name: str, data: bytes) -> Callable[[Path], None]:
    def made(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).write_bytes(data)

    return made


def link(name: str, target: str) -> Callable[[Path], None]:
    def made(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(target)

    return made


def special(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    def made(folder: Path) -> None:
        (folder / name).unlink()
        make(folder / name)

    return made


def listening(path: Path) -> None:
    # A socket's path is short.
    here = os.getcwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as sock:
            sock.bind(path.name)
    finally:
        os.chdir(here)


def core_of(change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def made(folder: Path) -> None:
        path = folder / CORE
        text = change(gzip.decompress(path.read_bytes()))
        path.write_bytes(packed(text, 0, 1))

    return made


CORE, FRAMES = layout.core_name(1), layout.frames_name(1)
NESTED = b"[" * 100_000 + b"]" * 100_000
HOSTILE = {
    "an empty member before core lines": lambda folder: (folder / CORE).write_bytes(
        gzip.compress(b"") + (folder / CORE).read_bytes()
    ),
    "no core lines": written(CORE, gzip.compress(b"")),
    "a clock of 1e400": clock("TOO LARGE"),
    "a clock of 30 digits": clock(10**30),
    "a clock that is a text": clock("12"),
    "a description that is nested deeply": written(layout.DRIVE_FILE, NESTED),
    "a description of 100 MB": written(layout.DRIVE_FILE, b" " * (100 << 20)),
    "a description with surrogates": description(lambda its: its.update(channel="\ud800")),
    "a DBC without the commands": written(layout.DBC_FILE, b'VERSION ""\n\nBU_: A\n'),
    "a DBC that is none": written(layout.DBC_FILE, b"\x00\xff" * 1000),
    "a configuration that is none": written(layout.CONFIG_FILE, NESTED),
    "core lines that are nested deeply": core_of(lambda text: b'{"f":0,"x":' + NESTED + b"}\n"),
    "a core line of 15 MB": core_of(lambda text: b'{"f":0,"x":[' + b"0," * (15 << 19) + b"0]}\n"),
    "numbers of core lines that are huge": core_of(
        lambda text: text.replace(b'"f":', b'"f":' + b"9" * 40)
    ),
    "15 million empty lines": written(CORE, packed(b"\n" * (15 << 20), 0, 1)),
    "15 million frames' lines": written(FRAMES, packed(b"\n" * (15 << 20), 0, 1)),
    "a bomb": written(FRAMES, gzip.compress(bytes(512 << 20), 1)),
    **{
        f"{what} in place of {name}": made(name)
        for name in (layout.DRIVE_FILE, layout.CONFIG_FILE, layout.DBC_FILE, CORE, FRAMES)
        for what, made in {
            "a dangling link": lambda name: link(name, "nowhere"),
            "a looping link": lambda name: link(name, name),
            "a link to /dev/zero": lambda name: link(name, "/dev/zero"),
            "a pipe": lambda name: special(name, os.mkfifo),
            "a folder": lambda name: special(name, Path.mkdir),
            "a socket": lambda name: special(name, listening),
        }.items()
    },
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive."""
    folder = tmp_path_factory.mktemp("recorded")
    return ordinary(folder / "drive", seconds=3.0)


def run(verb: str, folder: Path) -> subprocess.CompletedProcess[str]:
    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (MOST_MEMORY_BYTES, MOST_MEMORY_BYTES))

    return subprocess.run(
        [sys.executable, "-m", "vcu_gateway", *VERBS[verb]],
        cwd=folder,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=MOST_S,
        stdin=subprocess.DEVNULL,
        preexec_fn=bounded,
    )


def cases() -> Iterator[Any]:
    """One verb for each in CI, for every third in the quick suite; all of them nightly."""
    for number, what in enumerate(HOSTILE):
        chosen = list(VERBS)[number % len(VERBS)]
        for verb in VERBS:
            mark = pytest.mark.ci if number % 3 else ()
            yield pytest.param(what, verb, marks=mark if verb == chosen else pytest.mark.slow)


@pytest.mark.ci
@pytest.mark.parametrize(("what", "verb"), list(cases()))
def test_a_file_made_by_hand_is_an_error_and_no_crash(recorded, tmp_path, what, verb):
    drive = tmp_path / layout.DRIVES / "drive"
    (tmp_path / layout.INCIDENTS).mkdir()
    shutil.copytree(recorded, drive)
    HOSTILE[what](drive)
    done = run(verb, tmp_path)
    assert "Traceback" not in done.stderr, done.stderr
    assert "MemoryError" not in done.stderr
    assert done.returncode in (0, 3, 65, 66, 77, 78), done.stdout + done.stderr
