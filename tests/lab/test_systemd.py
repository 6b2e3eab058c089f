"""The lab with a systemd of its own: that a service in it meets what it meets on a vehicle."""

import json
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

LAB = Path(__file__).with_name("lab")
HERE = Path(__file__).parents[2]

# The first test may build a root, and a busy machine takes its time.
pytestmark = [
    pytest.mark.skipif("VCU_LAB" in os.environ, reason="inside the lab already"),
    pytest.mark.timeout(900),
]
PATIENCE_S = 240

FACTS = """
import json, os, pathlib, subprocess, sys
def output(command):
    return subprocess.run(command, shell=True, capture_output=True, text=True).stdout.strip()
def sandboxed(properties, command):
    options = [word for setting in properties for word in ("-p", setting)]
    run = ["systemd-run", "--wait", "--quiet", "--pipe", *options, "sh", "-c", command]
    return subprocess.run(run, capture_output=True, text=True)
def written(path):
    try:
        pathlib.Path(path).write_text("x")
    except OSError as error:
        return error.strerror
pathlib.Path("/etc/systemd/network/bench.netdev").write_text("[NetDev]\\nName=vcan7\\nKind=vcan\\n")
facts = {
    "first": pathlib.Path("/proc/1/comm").read_text().strip(),
    "state": output("systemctl is-system-running --wait"),
    "failed": output("systemctl --failed --no-legend --plain"),
    "debian": pathlib.Path("/etc/debian_version").read_text().strip(),
    "arguments": sys.argv[1:],
    "odd": os.environ["ODD"],
    "directory": os.getcwd(),
    "here": sorted(os.listdir()),
    "vcan0": output("ip -brief link show vcan0"),
    "repository": written(sys.argv[1] + "/written"),
    "beside": written("beside"),
    "shadow": oct(os.stat("/etc/shadow").st_mode), "group": os.stat("/etc/shadow").st_gid,
    "marker": os.path.exists("/etc/marker"), "made": written("/etc/marker"),
    "mkdir": sandboxed(["SystemCallFilter=~mkdir", "SystemCallErrorNumber=EPERM"],
        "mkdir /tmp/made").returncode,
    "strict": sandboxed(["ProtectSystem=strict"], "touch /etc/made").returncode,
    "policy": sandboxed(["CPUSchedulingPolicy=fifo", "CPUSchedulingPriority=40", "User=nobody",
        "PrivateUsers=yes"], 'grep "^policy" /proc/self/sched; id -un; chrt -p 0').stdout,
    "memory": sandboxed(["MemoryMax=20M"],
        "exec /usr/bin/python3 -c 'bytes(range(100)) * (1 << 20)'").returncode,
    "network": output("systemctl start systemd-networkd; udevadm settle; networkctl --no-pager; "
        "timeout 60 sh -c 'until ip link show vcan7; do sleep 0.1; done'"),
}
print(json.dumps(facts))
"""


def lab(*argv, options=(), **more):
    return subprocess.run(
        [LAB, "run", "--systemd", "--timeout", str(PATIENCE_S), *options, "--", *argv],
        **{"capture_output": True, "text": True, **more},
    )


@pytest.fixture(scope="module", autouse=True)
def a_root():
    done = subprocess.run([LAB.with_name("debian-root")], capture_output=True, text=True)
    if done.returncode != 0:
        ending = pytest.fail if "CI" in os.environ else pytest.skip
        ending(f"no root for the lab: {done.stderr}")


@pytest.fixture(scope="module")
def facts(tmp_path_factory):
    """What a command in the guest found, started in a directory under /tmp."""
    directory = tmp_path_factory.mktemp("a place with spaces, ü and 'quotes'")
    (directory / "program.py").write_text(FACTS)
    done = lab(
        *("/usr/bin/python3", "program.py", str(HERE), "two words", "'\"$HOME\n"),
        options=["--also", str(HERE)],
        cwd=directory,
        env={**os.environ, "ODD": "x\n'y'"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    return {**json.loads(done.stdout), "outside": directory}


def test_process_one_is_systemd_and_every_unit_has_started(facts):
    assert facts["first"] == "systemd"
    assert facts["state"] == "running", facts["failed"]
    assert facts["debian"].startswith(("12.", "13."))


def test_vcan0_is_up(facts):
    assert "UP" in facts["vcan0"]


def test_arguments_environment_and_directory_arrive_as_they_are(facts):
    assert facts["arguments"] == [str(HERE), "two words", "'\"$HOME\n"]
    assert facts["odd"] == "x\n'y'"
    assert facts["directory"] == str(facts["outside"])
    assert facts["here"] == ["program.py"]


def test_the_folders_of_the_machine_can_only_be_read(facts):
    assert facts["repository"] == "Read-only file system"
    assert facts["beside"] == "Read-only file system"


def test_the_files_of_the_root_have_their_owners(facts):
    assert (facts["shadow"], facts["group"]) == ("0o100640", 42)


def test_sandboxes_hold(facts):
    assert facts["mkdir"] != 0
    assert facts["strict"] != 0


def test_a_service_has_a_real_time_policy_as_an_ordinary_user(facts):
    assert "nobody" in facts["policy"]
    assert "SCHED_FIFO" in facts["policy"]


def test_a_service_above_its_memory_is_killed(facts):
    assert facts["memory"] != 0


def test_networkd_makes_a_bus_when_a_test_starts_it(facts):
    assert "vcan7" in facts["network"]


def test_output_is_the_commands_and_its_interpreter_the_one_of_venv():
    script = "import sys; print(sys.base_prefix); print('error', file=sys.stderr); sys.exit(3)"
    done = lab(str(HERE / ".venv/bin/python"), "-c", script, cwd=HERE)
    inside = (done.returncode, done.stdout, done.stderr)
    base: list[str | Path] = [HERE / ".venv/bin/python", "-c", "import sys; print(sys.base_prefix)"]
    assert inside == (3, subprocess.run(base, capture_output=True, text=True).stdout, "error\n")


def test_what_was_written_is_gone_in_the_next_guest(facts):
    assert facts["made"] is None
    assert lab("test", "-e", "/etc/marker", cwd=HERE).returncode == 1


@pytest.mark.parametrize("suite", ["bookworm", "trixie"])
def test_a_command_below_a_temporary_folder_finds_its_folder(suite):
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "here").touch()
        done = lab("ls", options=["--root", suite], cwd=folder)
    assert (done.returncode, done.stdout, done.stderr) == (0, "here\n", "")


@pytest.mark.parametrize("folder", ["/tmp", "/var/tmp"])
def test_a_folder_that_the_guest_needs_for_itself_is_no_place_to_start_in(folder):
    done = lab("true", cwd=folder)
    assert done.returncode == 125
    assert done.stderr == f"lab: {folder} cannot be shown to a guest that has its own\n"


def test_a_timeout_during_the_boot_ends_the_guest_in_one_line(tmp_path):
    environment = {**os.environ, "CI": "", "TMPDIR": str(tmp_path)}
    done = lab("echo", "begun", options=["--timeout", "0.5"], env=environment)
    assert (done.returncode, done.stdout) == (124, "")
    assert re.fullmatch(
        r"lab: timed out before the command had begun.*; its console is in \S+\n", done.stderr
    )


def test_a_signal_reaches_the_command_which_may_choose_its_status():
    script = "trap 'echo asked; exit 7' TERM; echo begun; sleep 300 & wait"
    argv: list[str | Path] = [
        LAB,
        "run",
        "--systemd",
        "--timeout",
        str(PATIENCE_S),
        "--",
        "sh",
        "-c",
        script,
    ]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "begun\n"
        process.terminate()
        assert process.stdout.read() == "asked\n"
        assert process.wait() == 7


def test_a_root_without_systemd_is_a_failure_of_the_lab(tmp_path):
    environment = {**os.environ, "CI": "", "TMPDIR": str(tmp_path)}
    done = lab("true", options=["--root", str(tmp_path)], env=environment)
    assert done.returncode == 125
    assert done.stderr.startswith(f"lab: the guest died: no systemd in {tmp_path}; its console is")
    assert done.stderr.count("\n") == 1


def test_a_directory_serves_as_a_root(tmp_path):
    image = subprocess.run([LAB.with_name("debian-root")], capture_output=True, text=True).stdout
    if os.geteuid() != 0:
        pytest.skip("only root can unpack a root with its owners")
    with subprocess.Popen(["sqfs2tar", image.strip()], stdout=subprocess.PIPE) as tar:
        subprocess.run(["tar", "-xp", "-C", tmp_path], stdin=tar.stdout, check=True)
    done = lab("systemctl", "is-system-running", "--wait", options=["--root", str(tmp_path)])
    shutil.rmtree(tmp_path)  # 280 MB that pytest would keep
    assert (done.returncode, done.stdout) == (0, "running\n")
