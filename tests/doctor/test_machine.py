"""Time, buffers and process: a healthy machine; break one thing."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.doctor.judged import not_ok, only, well
from vcu_gateway.doctor import clock, process
from vcu_gateway.doctor.check_result import Unreadable, number
from vcu_gateway.doctor.process import RunningProcess

# Time.

CLOCK = clock.ClockFacts(True, 11_200, 1, 50_000)


def test_a_synchronised_clock_with_fine_timers_is_one_line():
    assert well(clock.judge(CLOCK)) == (
        "clock synchronised (within 12 ms), timers of 1 ns, timer slack 50 us"
    )
    assert not_ok(clock.judge(CLOCK)) == {}


@pytest.mark.parametrize(
    ("changed", "check", "kind", "remedy"),
    [
        ({"synchronised": False}, "synchronised", "warning", "sudo timedatectl set-ntp true"),
        ({"synchronised": Unreadable("adjtimex: no")}, "synchronised", "unknown", ""),
        ({"resolution_ns": 1_000_000}, "resolution", "warning", "high-resolution"),
        ({"slack_ns": 1_000_001}, "slack", "warning", "TimerSlackNSec="),
        ({"slack_ns": Unreadable("no such file")}, "slack", "unknown", ""),
    ],
)
def test_each_fault_of_the_clock_is_one_finding(changed, check, kind, remedy):
    found = only(clock.judge(CLOCK._replace(**changed)))
    assert (found.subject, found.check, found.kind.value) == ("time", check, kind)
    assert remedy in found.remedy


def test_what_is_just_fine_enough_is_well():
    for fine_enough in (CLOCK._replace(resolution_ns=999_999), CLOCK._replace(slack_ns=1_000_000)):
        assert not_ok(clock.judge(fine_enough)) == {}


def test_the_clocks_figures_are_told_in_milliseconds():
    assert "finer than 4 ms" in only(clock.judge(CLOCK._replace(resolution_ns=4_000_000))).what
    assert "slack of 20 ms" in only(clock.judge(CLOCK._replace(slack_ns=20_000_000))).what
    for error_us in (0, None):
        assert "within" not in well(clock.judge(CLOCK._replace(error_us=error_us)))


def test_this_machines_clock_is_read():
    facts = clock.read()
    assert isinstance(facts.synchronised, bool)
    assert facts.error_us is not None
    assert 0 < facts.resolution_ns <= 10_000_000


# Buffers.

BUFFERS = {"wanted_bytes": None, "max_bytes": 212_992}


def test_the_kernels_usual_buffer_is_well_where_none_is_asked_for():
    assert not_ok(process.judge_buffers(**BUFFERS)) == {}


@pytest.mark.parametrize(
    ("changed", "check", "kind", "remedy"),
    [
        ({"max_bytes": 212_991}, "rmem_max", "warning", "net.core.rmem_max=212992"),
        ({"max_bytes": Unreadable("hidden")}, "rmem_max", "unknown", ""),
        ({"wanted_bytes": 212_993}, "rmem_max", "warning", "net.core.rmem_max=212993"),
        (
            {"wanted_bytes": 4096, "max_bytes": Unreadable("hidden")},
            "rmem_max",
            "unknown",
            "",
        ),
    ],
)
def test_each_limit_that_is_too_low_is_one_finding(changed, check, kind, remedy):
    found = only(process.judge_buffers(**BUFFERS | changed))
    assert (found.subject, found.check, found.kind.value) == ("buffers", check, kind)
    assert remedy in found.remedy


def test_a_buffer_that_the_kernel_gives_is_well():
    findings = list(process.judge_buffers(212_992, 212_992))
    assert well(findings) == "receive buffer of 212992 bytes is available"
    assert not_ok(findings) == {}


def test_this_machines_buffers_are_read():
    assert "receive buffer" in next(process.judge_buffers(None, number(process.RMEM_MAX))).what


# Process.

MEMORY = {"MemAvailable": "900000 kB", "SwapTotal": "0 kB", "SwapFree": "0 kB"}
STATUS = {"VmLck": "92160 kB", "VmSwap": "0 kB"}
RUNNING = RunningProcess(700, "fifo", 20, STATUS)
PROCESS = process.ProcessFacts(
    RUNNING, MEMORY, (("cpufreq-dt", "performance"),), "PREEMPT_RT", 5000
)


def running(**changed: Any) -> process.ProcessFacts:
    return PROCESS._replace(running=RUNNING._replace(**changed))


def test_a_real_time_process_on_a_roomy_machine_is_two_lines():
    findings = list(process.judge(PROCESS))
    assert not_ok(findings) == {}
    assert [one.what for one in findings] == [
        "process 700: fifo priority 20, locked in memory",
        "machine: 878 MB memory free, governor performance, 5000 MB disk free, kernel PREEMPT_RT",
    ]


@pytest.mark.parametrize(
    ("facts", "check", "kind"),
    [
        (running(policy="other"), "priority", "warning"),
        (running(policy=Unreadable("gone")), "priority", "unknown"),
        (running(status={**STATUS, "VmLck": "0 kB"}), "memory_lock", "warning"),
        (running(status=Unreadable("gone")), "memory_lock", "unknown"),
        (running(status={**STATUS, "VmSwap": "4 kB"}), "swapped", "warning"),
        (PROCESS._replace(memory={**MEMORY, "MemAvailable": "102399 kB"}), "memory", "warning"),
        (PROCESS._replace(memory=Unreadable("hidden")), "memory", "unknown"),
        (PROCESS._replace(memory={}), "memory", "unknown"),
        (PROCESS._replace(memory={**MEMORY, "SwapTotal": "4096 kB"}), "swap", "warning"),
        (PROCESS._replace(governors=(("cpufreq-dt", "powersave"),)), "governor", "warning"),
        (PROCESS._replace(disk_mb=199), "disk", "warning"),
        (PROCESS._replace(disk_mb=Unreadable("no permission")), "disk", "unknown"),
        (PROCESS._replace(running=None, memory_lock="8388608"), "memory_lock", "warning"),
        (PROCESS._replace(running=None, policy="0"), "priority", "warning"),
    ],
)
def test_each_fault_of_the_process_is_one_finding(facts, check, kind):
    found = only(process.judge(facts))
    assert (found.subject, found.check, found.kind.value) == ("process", check, kind)
    assert found.remedy or kind == "unknown"


@pytest.mark.parametrize(
    "facts",
    [
        running(policy="rr"),
        running(status={"VmLck": "1 kB"}),
        PROCESS._replace(memory={**MEMORY, "MemAvailable": "102400 kB"}),
        PROCESS._replace(governors=(("intel_pstate", "powersave"),)),
        PROCESS._replace(governors=()),
        PROCESS._replace(disk_mb=200),
        PROCESS._replace(disk_mb=None),
        PROCESS._replace(running=None),
        PROCESS._replace(running=None, memory_lock="infinity", policy="1"),
        PROCESS._replace(preemption=""),
    ],
)
def test_what_is_well_or_not_there_is_not_complained_of(facts):
    assert not_ok(process.judge(facts)) == {}


def test_a_process_of_this_machine_is_read_and_one_that_has_ended_is_unknown():
    mine = process.read(os.getpid()).running
    assert mine is not None
    assert isinstance(mine.status, dict)
    assert "VmLck" in mine.status
    beyond_the_last = 2**22 + 1
    assert not_ok(process.judge(process.read(beyond_the_last))).get("priority") == "unknown"


@pytest.mark.parametrize(
    ("facts", "figure"),
    [
        (PROCESS._replace(memory={**MEMORY, "MemAvailable": "51200 kB"}), "only 50 MB"),
        (
            PROCESS._replace(memory={**MEMORY, "SwapTotal": "4096 kB", "SwapFree": "1024 kB"}),
            "3 MB",
        ),
        (PROCESS._replace(running=None, memory_lock="8388608"), "only 8192 kB"),
        (PROCESS._replace(running=None, memory_lock="104857599"), "only 102399 kB"),
        (running(status={**STATUS, "VmSwap": "4 kB"}), "4 kB of process 700"),
    ],
)
def test_the_figures_are_told_in_their_units(facts, figure):
    assert figure in only(process.judge(facts)).what


def test_a_limit_that_is_just_large_enough_and_half_a_swap_file_are_well():
    assert not_ok(process.judge(PROCESS._replace(running=None, memory_lock="104857600"))) == {}
    half = {"MemAvailable": "900000 kB", "SwapTotal": "9 kB"}
    assert not_ok(process.judge(PROCESS._replace(memory=half))) == {}


def test_what_is_not_known_of_the_machine_is_not_named():
    machine = well(process.judge(PROCESS._replace(governors=(), preemption="", disk_mb=None)))
    assert machine.endswith("machine: 878 MB memory free")


def test_a_memory_figure_that_is_none_is_unknown():
    odd = PROCESS._replace(memory={**MEMORY, "MemAvailable": "plenty kB"})
    assert not_ok(process.judge(odd)) == {"memory": "unknown"}


def test_each_processors_driver_and_governor_are_read(tmp_path: Path):
    for name, driver in (("policy0", "cpufreq-dt"), ("policy4", None)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "scaling_governor").write_text("powersave\n")
        if driver is not None:
            (folder / "scaling_driver").write_text(f"{driver}\n")
    assert list(process.governors(str(tmp_path))) == [("cpufreq-dt", "powersave")]
    assert list(process.governors(str(tmp_path / "none"))) == []


def test_free_space_is_read_in_megabytes(tmp_path: Path):
    before = shutil.disk_usage(tmp_path).free / 2**20
    found: Any = process.free_mb(str(tmp_path))
    after = shutil.disk_usage(tmp_path).free / 2**20
    assert min(before, after) * 0.95 <= found <= max(before, after) * 1.05  # others write, too
    assert process.free_mb(str(tmp_path / "none")) is None
    file = tmp_path / "file"
    file.touch()
    assert isinstance(process.free_mb(f"{file}/below"), Unreadable)


@pytest.fixture
def real_time_pid() -> Iterator[int]:
    with subprocess.Popen(["sleep", "60"]) as child:
        try:
            policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(child.pid, policy, os.sched_param(20))
        except PermissionError:
            child.kill()
            pytest.skip("this user may not set a real-time priority")
        yield child.pid
        child.kill()


def test_a_real_time_process_is_read_as_one(real_time_pid):
    found = process.read(real_time_pid).running
    assert found is not None
    assert (found.policy, found.priority) == ("fifo", 20)
    assert process.read(os.getpid()).running._replace(status={}).policy == "other"
