"""docs/examples/README.md as a reader types it: the demo in one terminal, programs in another."""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.client.test_examples import AXIS, BUTTON, Stick
from tests.docs.pages import ROOT, blocks
from vcu_gateway.client import Client

PAGE = ROOT / "docs" / "examples" / "README.md"
DEMO, PROGRAMS = (block.splitlines() for block in blocks(PAGE, "sh"))
WAIT_S = 60.0

pytestmark = [pytest.mark.clock, pytest.mark.timeout(300)]


class Clone(NamedTuple):
    """A clone with its .venv and a running demo; `export` is the line that the demo printed."""

    folder: Path
    export: str

    @property
    def socket(self) -> str:
        return self.export.partition("=")[2]

    def typed(self, line: str) -> subprocess.Popen[str]:
        """A line in the other terminal."""
        return started(f"{self.export}\nexec {line}", self.folder)

    def outcome(self, line: str) -> tuple[int, str]:
        """Exit code and what was said."""
        program = self.typed(line)
        said, errors = program.communicate(timeout=WAIT_S)
        return program.returncode, said + errors


def started(script: str, folder: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(folder)}
    environment.pop("VCU_GATEWAY_SOCKET", None)
    pipe = subprocess.PIPE
    return subprocess.Popen(
        ["bash", "-c", script], cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True
    )


def until(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


@pytest.fixture(scope="module")
def clone() -> Iterator[Clone]:
    folder = Path(tempfile.mkdtemp(prefix="vcu."))
    for name in (".venv", "docs"):
        (folder / name).symlink_to(ROOT / name)
    (line,) = DEMO
    said = folder / "said.txt"
    said.touch()
    demo = started(f"exec {line} >said.txt", folder)
    until(lambda: demo.poll() is not None or "export " in said.read_text())
    exports = [line.strip() for line in said.read_text().splitlines() if "export " in line]
    yield Clone(folder, exports[0])
    demo.send_signal(signal.SIGINT)
    _, errors = demo.communicate(timeout=WAIT_S)
    assert (demo.returncode, errors) == (0, "")
    shutil.rmtree(folder)


def line_of(name: str) -> str:
    (line,) = (line for line in PROGRAMS if name in line)
    return line


def test_the_page_has_a_line_for_each_program_with_the_interpreter_of_the_readme():
    programs = sorted(path.name for path in PAGE.parent.glob("*.py"))
    assert len(PROGRAMS) == len(programs)
    for name in programs:
        assert line_of(name).startswith(f".venv/bin/python docs/examples/{name} ")


@pytest.mark.ci
def test_the_control_loop_drives_the_demo(clone):
    code, said = clone.outcome(line_of("control_loop"))
    assert code == 0, said
    assert said.splitlines()[-2:] == ["driving", "done"]


def test_the_logger_writes_what_the_demos_vehicle_says(clone):
    program = clone.typed(line_of("logger"))
    written = clone.folder / "battery.csv"
    until(lambda: written.exists() and written.read_text().count("\n") > 10)
    program.send_signal(signal.SIGINT)
    _, errors = program.communicate(timeout=WAIT_S)
    assert (program.returncode, errors) == (0, "interrupted\n")
    head, *_, last = written.read_text().splitlines()  # the first rows may come before a frame
    row = dict(zip(head.split(","), last.split(","), strict=True))
    assert 40 < float(row["BMS_Status.PackVoltage"]) < 100


def test_the_joystick_drives_the_demo_and_says_where_there_is_none(clone):
    if not os.path.exists("/dev/input/js0"):
        code, said = clone.outcome(line_of("joystick"))
        assert code == 1
        assert "No such file or directory: '/dev/input/js0'" in said
    stick = Stick(clone.folder / "js0")
    with Client(clone.socket) as client:
        until(lambda: client.why()["mode"] == "standby")
        program = clone.typed(f"{line_of('joystick')} --device js0")
        until(lambda: pressed(stick) and client.why()["mode"] == "active")
        stick.send(AXIS, 1, -32767)
        until(lambda: client.state()["commands"]["PCU1"]["throttle_pct"] > 5)
    stick.unplug()
    _, errors = program.communicate(timeout=WAIT_S)
    assert program.returncode == 1
    assert "the joystick is gone" in errors


def pressed(stick: Stick) -> bool:
    """The button that arms, once more: arming is refused for a moment."""
    stick.send(BUTTON, 0, 1)
    stick.send(BUTTON, 0, 0)
    return True
