"""The lab itself: that what runs in it cannot tell it from running outside, but for its vcan0."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

LAB = Path(__file__).with_name("lab")
PYTHON = sys.executable
# Only for a lab that hangs; a busy machine takes its time.
PATIENCE_S = 100

pytestmark = pytest.mark.skipif("VCU_LAB" in os.environ, reason="inside the lab already")


@pytest.fixture(scope="module", autouse=True)
def way():
    """The way this machine uses, "native" or "uml"."""
    done = subprocess.run([LAB, "check"], capture_output=True, text=True)
    if done.returncode != 0:
        ending = pytest.fail if "CI" in os.environ else pytest.skip
        ending(f"no lab here: {done.stdout}{done.stderr}")
    return done.stdout.partition(":")[0]


def lab(*argv, options=(), **more):
    return subprocess.run(
        [LAB, "run", "--timeout", str(PATIENCE_S), *options, "--", *argv],
        capture_output=True,
        **{"text": True, **more},
    )


def descendants(pid):
    """All processes that descend from this one, itself left out."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    family = {pid}
    while more := {child for child, parent in parents.items() if parent in family} - family:
        family |= more
    return family - {pid}


def alive(pids):
    """Those processes of pids that still run."""
    running = set()
    for pid in pids:
        with contextlib.suppress(OSError):
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
            running |= {pid} if state not in "ZX" else set()
    return running


def job_directories(pids):
    texts = [Path(f"/proc/{pid}/cmdline").read_text() for pid in pids if alive({pid})]
    return {Path(found) for text in texts for found in re.findall(r"/\S*/vcu-lab\.\w+", text)}


class NeverBegunError(Exception):
    """The lab ended before its command began."""


@contextlib.contextmanager
def started(script, timeout_s=PATIENCE_S, first=()):
    """A lab whose command has said that it is started, with its processes and directories."""
    argv = [*first, LAB, "run", "--timeout", str(timeout_s), "--", "sh", "-c", script]
    with subprocess.Popen(
        argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        first = process.stdout.readline()
        if not first:
            raise NeverBegunError(process.stderr.read())
        assert first == "started\n"
        pids = descendants(process.pid)
        assert pids
        yield process, pids, job_directories(pids)


def assert_gone(pids, directories):
    deadline = time.monotonic() + 60
    while alive(pids) or any(path.exists() for path in directories):
        assert time.monotonic() < deadline, (alive(pids), directories)
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("script", "status"),
    [("exit 3", 3), ("no-such-command", 127), ("kill -TERM $$", 128 + signal.SIGTERM)],
)
def test_the_exit_status_is_the_commands(script, status):
    assert lab("sh", "-c", script).returncode == status


def test_vcan0_is_up_and_carries_frames_between_processes():
    script = """
import os, socket
def bus():
    s = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    s.bind(("vcan0",))
    return s
receiver = bus()
receiver.settimeout(60)
if os.fork() == 0:
    bus().send(bytes.fromhex("23010000 02000000 abcd000000000000"))
    os._exit(0)
print(receiver.recv(16).hex(" ", 4))
socket.create_server(("127.0.0.1", 0))
"""
    done = lab(PYTHON, "-c", script)
    assert (done.stdout, done.stderr) == ("23010000 02000000 abcd0000 00000000\n", "")


def test_arguments_environment_and_directory_arrive_as_they_are(tmp_path):
    directory = tmp_path / "a place with spaces, ü and 'quotes'"
    directory.mkdir()
    odd = ["two words", "'\"", "$HOME", "line\nbreak", "", "*", "--", "é"]
    script = (
        "import os, sys; open('made', 'w').write('by the command');"
        "print(sys.argv[1:], os.environ['ODD'], os.environ['GIVEN'], os.getcwd())"
    )
    done = lab(
        *(PYTHON, "-c", script, *odd),
        options=["--env", "GIVEN=a=b c"],
        cwd=directory,
        env={**os.environ, "ODD": "x\n'y'"},
    )
    assert done.stdout == f"{odd} x\n'y' a=b c {directory}\n"
    assert (directory / "made").read_text() == "by the command"


def test_output_is_only_the_commands_in_order_and_stdout_is_not_stderr():
    script = "for i in $(seq 100); do echo $i; done; printf 'no\\r\\nnewline'; echo error >&2"
    done = lab("sh", "-c", script, text=False)
    assert done.stdout == b"".join(b"%d\n" % i for i in range(1, 101)) + b"no\r\nnewline"
    assert done.stderr == b"error\n"


def test_output_comes_while_the_command_runs(tmp_path):
    heard = tmp_path / "heard"
    script = f"echo started; until [ -e '{heard}' ]; do sleep 0.1; done; echo ended"
    with started(script) as (process, _, _):
        heard.touch()  # the command waits for it: it is still running
        assert process.stdout.readline() == "ended\n"
        assert process.wait() == 0


def test_a_timeout_ends_everything():
    try:
        assert_timed_out(3)
    except NeverBegunError:  # the boot counts, and a busy machine boots for as long as that
        assert_timed_out(40)


def assert_timed_out(timeout_s):
    script = "trap 'echo asked; exit' TERM; echo started; sleep 100 & wait"
    with started(script, timeout_s) as (process, pids, directories):
        assert process.stdout.read() == "asked\n"
        assert process.wait() == 124
        assert_gone(pids, directories)


def test_interrupt_reaches_the_command_which_may_choose_its_status():
    script = "trap 'exit 7' INT; echo started; sleep 100 & wait"
    with started(script) as (process, pids, directories):
        process.send_signal(signal.SIGINT)
        assert process.wait() == 7
        assert_gone(pids, directories)


def test_nothing_outlives_a_killed_lab():
    with started("echo started; while :; do :; done") as (process, pids, directories):
        process.kill()
        process.wait()
        assert_gone(pids, directories)


# A kernel without groups of sessions has no such rank to ask for.
@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="no groups by session here")
@pytest.mark.parametrize(("first", "rank"), [((), "-10"), (("nice", "-n", "5"), "0")])
def test_its_session_goes_before_others_as_root_unless_its_caller_gives_way(first, rank):
    raised = ["sh", "-c", "echo -10 >/proc/self/autogroup"]
    may = subprocess.run(raised, start_new_session=True, capture_output=True).returncode == 0
    with started("echo started; while :; do :; done", first=first) as (process, pids, directories):
        leaders = [pid for pid in alive(pids) if os.getsid(pid) == pid]
        ranks = [Path(f"/proc/{pid}/autogroup").read_text().split()[-1] for pid in leaders]
        process.kill()
        process.wait()
        assert_gone(pids, directories)
    assert sorted(ranks) == sorted([rank if may else "0", "0"]), "the session, and its undertaker's"


def test_two_labs_at_once_have_a_vcan0_each():
    script = "ip link del vcan0 && sleep 1 && ip link add dev vcan0 type vcan"
    argv: list[str | Path] = [LAB, "run", "--timeout", str(PATIENCE_S), "--", "sh", "-c", script]
    pair = [subprocess.Popen(argv) for _ in range(2)]
    assert [process.wait() for process in pair] == [0, 0]


def test_module_parameters_and_extra_modules(way):
    if way != "uml":
        pytest.skip("needs User Mode Linux")
    options = ["--module-param", "vcan:echo=1", "--modules", "slcan sch_netem"]
    script = "cat /sys/module/vcan/parameters/echo; grep -E -c '^(slcan|sch_netem) ' /proc/modules"
    assert lab("sh", "-c", script, options=options).stdout == "Y\n2\n"


@pytest.mark.parametrize(("ci", "shown"), [("", False), ("true", True)])
def test_a_guest_that_dies_ends_in_one_line_and_ci_sees_its_console(way, tmp_path, ci, shown):
    if way != "uml":
        pytest.skip("needs User Mode Linux")
    done = lab("busybox", "poweroff", "-f", env={**os.environ, "CI": ci, "TMPDIR": str(tmp_path)})
    assert done.returncode == 125
    line, _, console = done.stderr.partition("\n")
    found = re.fullmatch(r"lab: the guest died; its console is in (/\S+)", line)
    assert "System halted" in Path(found[1]).read_text()
    assert ("System halted" in console, bool(console)) == (shown, shown)


def test_check_says_in_one_line_what_works(way):
    done = subprocess.run([LAB, "check"], capture_output=True, text=True)
    kernel = {"native": r"Linux \S+", "uml": r"User Mode Linux \d\S+"}[way]
    works = rf"{way}: {kernel} begins after \d+\.\d s, vcan0 carries a frame.*\n"
    assert re.fullmatch(works, done.stdout)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_native_way_in_the_guest_of_the_other_way():
    script = 'ip link del vcan0; echo "$VCU_LAB"; exit 4'
    inner = [PYTHON, str(LAB), "run", "--", "sh", "-c", script]
    done = lab(*inner)
    assert (done.stdout, done.returncode) == ("native\n", 4)


def test_run_without_a_command_is_a_usage_error():
    assert subprocess.run([LAB, "run"], capture_output=True).returncode == 2
