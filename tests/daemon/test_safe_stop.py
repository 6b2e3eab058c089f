"""The process that sends safe frames when the gateway cannot; the sending itself is in vcan/."""

import subprocess
import sys
from pathlib import Path

import pytest

from vcu_gateway.daemon import safe_stop

KILLED = {"SERVICE_RESULT": "signal", "EXIT_CODE": "killed", "EXIT_STATUS": "KILL"}
GOOD = "vcan9\n0008A7D0#0C000000E02E0000\n0008A8D0#0C000000E02E0000\n"


def stopped(path: Path, **environment: str) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-I", "-S", safe_stop.__file__, str(path)],
        capture_output=True, text=True, env=environment, check=False, timeout=60,
    )  # fmt: skip
    assert done.stderr == ""
    return done.returncode, done.stdout


def test_the_frames_are_those_of_the_kernel():
    assert safe_stop._packed("0008A7D0#0C000000E02E0000") == bytes.fromhex(
        "d0a70880 08000000 0c000000e02e0000"
    )


def test_nothing_is_said_after_an_orderly_end(tmp_path):
    (tmp_path / "safe-frames").write_text(GOOD)
    assert stopped(tmp_path / "safe-frames", SERVICE_RESULT="success") == (0, "")


def test_a_gateway_that_had_sent_nothing_needs_no_frames(tmp_path):
    status, said = stopped(tmp_path / "nothing", **KILLED)
    assert (status, said) == (
        0, "no safe frames to send: the gateway had sent none, or ended in order\n",
    )  # fmt: skip


@pytest.mark.parametrize(
    "contents",
    ["", "vcan9", "vcan9\nnonsense", "vcan9\n0008A7D0#0C", "vcan9\n#0C000000E02E0000", "\n\n"],
)
def test_a_torn_file_sends_nothing_and_says_so(tmp_path, contents):
    (tmp_path / "safe-frames").write_text(contents)
    status, said = stopped(tmp_path / "safe-frames", **KILLED)
    assert status == 1
    assert said.startswith("no safe frames to send: ")


def test_an_interface_that_is_not_there_is_reported(tmp_path):
    (tmp_path / "safe-frames").write_text(GOOD)
    status, said = stopped(tmp_path / "safe-frames", **KILLED)
    assert status == 1
    assert said.startswith("vcan9: no safe frames sent: ")


def test_it_imports_nothing_of_the_gateway():
    source = Path(safe_stop.__file__).read_text()
    assert "vcu_gateway" not in source.replace("vcu-gateway", "")
