"""The lab under QEMU: a command in it meets what it meets under systemd, and two controllers."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LAB = Path(__file__).with_name("lab")
HERE = Path(__file__).parents[2]
PATIENCE_S = 600

# The first test may unpack a kernel and build a root; a busy machine takes its time.
pytestmark = [
    pytest.mark.skipif("VCU_LAB" in os.environ, reason="inside the lab already"),
    pytest.mark.timeout(900),
]

FACTS = """
import json, os, pathlib, socket, subprocess, sys
def output(command):
    return subprocess.run(command, shell=True, capture_output=True, text=True).stdout.strip()
def written(path):
    try:
        pathlib.Path(path).write_text("x")
    except OSError as error:
        return error.strerror
def bus(name):
    output(f"ip link set {name} type can bitrate 250000 && ip link set {name} up")
    one = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    one.settimeout(60)
    one.bind((name,))
    return one
state = output("systemctl is-system-running --wait; udevadm settle")
receiver = bus("can1")
bus("can0").send(bytes.fromhex("23010000 02000000 abcd000000000000"))
facts = {
    "arguments": sys.argv[1:], "directory": os.getcwd(), "odd": os.environ["ODD"],
    "lab": os.environ["VCU_LAB"], "state": state, "beside": written("beside"),
    "frame": receiver.recv(16).hex(" ", 4),
    "drivers": [os.path.basename(os.path.realpath(f"/sys/class/net/{name}/device/driver"))
        for name in ("can0", "can1")],
    "disk": pathlib.Path(os.environ["VCU_DISK"]).read_bytes()[:4].decode(),
    "vcan0": output("ip -brief link show vcan0"), "kernel": os.uname().release,
}
print(json.dumps(facts))
print("error", file=sys.stderr)
sys.exit(3)
"""


def lab(*argv, options=(), **more):
    return subprocess.run(
        [LAB, "run", "--qemu", "--timeout", str(PATIENCE_S), *options, "--", *argv],
        **{"capture_output": True, "text": True, **more},
    )


@pytest.fixture(scope="module", autouse=True)
def qemu():
    scripts = [["debian-kernel"], ["debian-root"]]
    done = [subprocess.run([LAB.with_name(*s)], capture_output=True, text=True) for s in scripts]
    missing = "" if shutil.which(f"qemu-system-{os.uname().machine}") else "no QEMU; "
    if why := missing + "".join(one.stderr for one in done if one.returncode):
        pytest.fail(f"{why}: make tools")


def test_a_command_meets_its_own_surroundings_and_two_controllers_on_one_bus(tmp_path):
    directory = tmp_path / "a place with spaces, ü, and 'quotes'"
    directory.mkdir()
    (directory / "program.py").write_text(FACTS)
    (disk := tmp_path / "disk").write_bytes(b"disk" * 1024)
    done = lab(
        *("/usr/bin/python3", "program.py", "two words", "'\"$HOME\n"),
        options=["--disk", str(disk)],
        cwd=directory,
        env={**os.environ, "ODD": "x\n'y'"},
    )
    assert (done.returncode, done.stderr) == (3, "error\n")
    facts = json.loads(done.stdout)
    assert facts["arguments"] == ["two words", "'\"$HOME\n"]
    assert (facts["directory"], facts["odd"]) == (str(directory), "x\n'y'")
    assert (facts["lab"], facts["state"]) == ("qemu", "running")
    assert facts["beside"] == "Read-only file system"
    assert facts["drivers"] == ["kvaser_pci", "kvaser_pci"]
    assert facts["frame"] == "23010000 02000000 abcd0000 00000000"
    assert "UP" in facts["vcan0"]
    assert facts["disk"] == "disk"


def test_the_interpreter_is_the_one_of_venv_and_a_signal_reaches_the_command():
    script = "trap 'echo asked; exit 7' TERM; .venv/bin/python -c 'import can; print(can.__name__)'"
    argv: list[str | Path] = [LAB, "run", "--qemu", "--timeout", str(PATIENCE_S), "--", "sh", "-c"]
    with subprocess.Popen(
        [*argv, f"{script}; sleep 10000 & wait"], stdout=subprocess.PIPE, text=True, cwd=HERE
    ) as process:
        assert process.stdout.readline() == "can\n"
        process.terminate()
        assert process.stdout.read() == "asked\n"
        assert process.wait() == 7


def test_a_timeout_during_the_boot_ends_the_guest_and_shows_its_console():
    done = lab("echo", "begun", options=["--timeout", "0.5"])
    assert (done.returncode, done.stdout) == (124, "")
    assert "timed out before the command had begun; its console is in " in done.stderr


def test_another_architecture_takes_this_way_by_itself(monkeypatch):
    monkeypatch.syspath_prepend(str(LAB.parent))
    import qemu

    assert not qemu.is_needed()
    monkeypatch.setattr(sys.modules["platform"], "machine", lambda: "aarch64")
    assert qemu.is_needed()
    assert qemu.architecture().emulator == "qemu-system-aarch64"
