"""The lab where the processor has more state than User Mode Linux knows, as in large_xstate.c."""

import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
LAB = HERE / "lab"
PATIENCE_S = 100
SIMULATED_BYTES = "16,384"

pytestmark = [
    pytest.mark.skipif("VCU_LAB" in os.environ, reason="inside the lab already"),
    pytest.mark.skipif(platform.machine() != "x86_64", reason="User Mode Linux is for x86"),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder with the simulation and the program that keeps its vector registers busy."""
    if not shutil.which("cc"):
        pytest.fail("no C compiler here: make tools")
    folder = tmp_path_factory.mktemp("built")
    for argv in (
        ["-shared", "-fPIC", "-o", folder / "large.so", HERE / "large_xstate.c"],
        ["-pthread", "-o", folder / "vectors", HERE / "vector_registers.c"],
    ):
        subprocess.run(["cc", "-O2", "-Wall", "-Wextra", *argv], check=True)
    return folder


@pytest.fixture
def lab(built, tmp_path):
    """Runs the lab on the simulated processor; its other arguments are environment variables."""

    def run(*argv, program=LAB, **environment):
        own = {"LAB_WAY": "uml", "CI": "", "LD_PRELOAD": built / "large.so", "TMPDIR": tmp_path}
        return subprocess.run(
            [program, *argv],
            capture_output=True,
            text=True,
            env={**os.environ, **own, **environment},
            timeout=PATIENCE_S,
        )

    return run


def test_without_help_the_guest_dies_and_the_lab_says_so_in_one_line(lab):
    # Not simulated to the lab itself, which therefore does not help.
    done = lab("run", "--", "true", LARGE_XSTATE_IN="linux.uml")
    assert (done.returncode, done.stdout) == (125, "")
    line = r"lab: the guest died: this machine's kernel refuses its registers .* is in (\S+)\n"
    found = re.fullmatch(line, done.stderr)
    assert found, done.stderr
    assert "put_fp_registers" in Path(found[1]).read_text()
    assert lab("check", LARGE_XSTATE_IN="linux.uml").returncode == 1


def test_the_vector_registers_of_threads_and_processes_are_kept(lab, built):
    done = lab("run", "--env", "LD_PRELOAD=", "--", str(built / "vectors"))
    if done.returncode == 77:
        pytest.skip("this processor has no AVX")
    assert (done.returncode, done.stdout, done.stderr) == (0, "kept\n", "")


def test_the_guests_processes_are_not_preloaded(lab, built):
    script = "echo $LD_PRELOAD; tr '\\0' '\\n' </proc/1/environ | grep LD_; cat /proc/1/maps"
    given, *rest = lab("run", "--", "sh", "-c", script).stdout.splitlines()
    assert given == str(built / "large.so")  # the caller's own, as any of its variables
    assert not [line for line in rest if "LD_" in line or "ptrace.so" in line or "xstate" in line]
    assert rest


def test_check_names_the_processor_its_state_and_the_remedy(lab):
    done = lab("check")
    assert (done.returncode, done.stderr) == (0, "")
    assert re.search(
        rf"; {SIMULATED_BYTES} bytes of processor state \(.+\), more than the guest knows: "
        r"preloaded ptrace\n$",
        done.stdout,
    )


def test_without_a_compiler_one_line_says_what_to_install(lab, tmp_path):
    # A checkout without what was built, and a PATH without cc.
    checkout, tools = tmp_path / "checkout", tmp_path / "bin"
    shutil.copytree(HERE, checkout / "tests" / "lab")
    tools.mkdir()
    (tools / "python3").symlink_to(Path(sys.executable).resolve())
    for name in ("linux.uml", "busybox", "ip", "tc", "env", "sh"):
        (tools / name).symlink_to(shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin:/sbin"))
    program = checkout / "tests" / "lab" / "lab"
    for words, status in ((["run", "--", "true"], 125), (["check"], 1)):
        done = lab(*words, program=program, PATH=str(tools))
        assert done.returncode == status
        assert re.fullmatch(r"lab: .*gcc.*: run `lab install`\n", done.stderr)
