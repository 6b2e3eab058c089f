"""Process of the gateway and its machine: priority, memory, processor, disk, receive buffer."""

import os
import platform
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import (
    CheckResult,
    CheckSubject,
    Outcome,
    Unreadable,
    existing,
    fields,
    names,
    number,
    text,
    unreadable,
)

SUBJECT = CheckSubject("process")
BUFFERS = CheckSubject("buffers")
STATE_FOLDER = "/var/lib/vcu-gateway"
_NOT_REAL_TIME = ("0", "3", "5")  # systemd shows the kernel's numbers: other, batch, idle
_REAL_TIME = {os.SCHED_FIFO: "fifo", os.SCHED_RR: "rr"}
_MEMORY_AT_LEAST_KB = 100 * 1024
_DISK_AT_LEAST_MB = 200
# With so much, 555 frames of a full bus of 1 Mbit/s may wait, and 380 come between two ticks.
_LEAST_BYTES = 212_992
RMEM_MAX = "/proc/sys/net/core/rmem_max"
_SYSCTL_FILE = "/etc/sysctl.d/60-vcu-gateway.conf"
_CPUS = "/sys/devices/system/cpu/cpufreq"
# Their "powersave" follows the load; it is not the slowest speed.
_OWN_GOVERNORS = ("intel_pstate", "amd-pstate-epp", "amd_pstate_epp")


class RunningProcess(NamedTuple):
    """Scheduling and memory of a running gateway."""

    pid: int
    policy: str | Unreadable
    priority: int
    status: dict[str, str] | Unreadable


class ProcessFacts(NamedTuple):
    """Facts about the process and the machine.

    Attributes:
        running: None where no gateway runs.
        memory: /proc/meminfo.
        governors: cpufreq driver and governor of each group of processors; none where the speed
            is fixed.
        preemption: the kernel's preemption model, empty where it is unknown.
        disk_mb: free space of the state folder; None where there is none.
        memory_lock: systemd's LimitMEMLOCK=, policy: its CPUSchedulingPolicy=; empty where
            the unit is not installed.
    """

    running: RunningProcess | None
    memory: dict[str, str] | Unreadable
    governors: tuple[tuple[str, str], ...]
    preemption: str
    disk_mb: int | Unreadable | None
    memory_lock: str = ""
    policy: str = ""


def read(pid: int | None, memory_lock: str = "", policy: str = "") -> ProcessFacts:
    return ProcessFacts(
        None if pid is None else _running(pid),
        fields("/proc/meminfo"),
        tuple(governors()),
        _preemption(),
        free_mb(STATE_FOLDER),
        memory_lock,
        policy,
    )


def _running(pid: int) -> RunningProcess:
    policy: str | Unreadable
    try:
        policy = _REAL_TIME.get(os.sched_getscheduler(pid) & 0xFF, "other")
        priority = os.sched_getparam(pid).sched_priority
    except OSError as error:
        policy, priority = unreadable(f"process {pid}", error), 0
    return RunningProcess(pid, policy, priority, fields(f"/proc/{pid}/status"))


def governors(cpus: str = _CPUS) -> Iterator[tuple[str, str]]:
    for folder in names(cpus):
        driver = text(f"{cpus}/{folder}/scaling_driver")
        governor = text(f"{cpus}/{folder}/scaling_governor")
        if isinstance(driver, str) and isinstance(governor, str):
            yield driver, governor


def _preemption() -> str:
    if number("/sys/kernel/realtime") == 1:
        return "PREEMPT_RT"
    words = platform.version().split()
    return next((word for word in words if word.startswith("PREEMPT")), "")


def free_mb(folder: str) -> int | Unreadable | None:
    """Disk space of a folder that is free for others than root; None where there is no folder."""
    found = existing(folder, os.statvfs)
    if not isinstance(found, os.statvfs_result):
        return found
    return found.f_bavail * found.f_frsize >> 20


def judge(facts: ProcessFacts) -> Iterator[CheckResult]:
    running = facts.running
    if running is not None:
        checks = (_policy(running), _locked(running), _swapped(running))
        yield from SUBJECT.summarise(f"process {running.pid}", checks)
    else:
        yield from SUBJECT.summarise("the unit", _of_unit(facts))
    kernel = facts.preemption and f"kernel {facts.preemption}"
    machine = (_memory(facts), _swap(facts), _governor(facts.governors), _disk(facts), kernel)
    yield from SUBJECT.summarise("machine", machine)


def _policy(running: RunningProcess) -> Outcome:
    if isinstance(running.policy, Unreadable):
        return SUBJECT.unknown("priority", running.policy.reason)
    if running.policy in _REAL_TIME.values():
        return f"{running.policy} priority {running.priority}"
    what = f"process {running.pid} has no real-time priority: a busy machine makes ticks late"
    return SUBJECT.warning("priority", what, "run it as the service: its unit sets one")


def _of_unit(facts: ProcessFacts) -> Iterator[Outcome | None]:
    """Judge the unit of an installed service that does not run."""
    if facts.memory_lock.isdecimal() and int(facts.memory_lock) < _MEMORY_AT_LEAST_KB * 1024:
        what = f"the unit may lock only {int(facts.memory_lock) >> 10} kB of memory"
        yield SUBJECT.warning("memory_lock", what, "LimitMEMLOCK=infinity in a drop-in")
    if facts.policy in _NOT_REAL_TIME:
        what = "the unit asks for no real-time priority: a busy machine makes ticks late"
        yield SUBJECT.warning("priority", what, "CPUSchedulingPolicy=fifo in a drop-in")


def _locked(running: RunningProcess) -> Outcome:
    locked_kb = _kb(running.status, "VmLck")
    if isinstance(locked_kb, Unreadable):
        return SUBJECT.unknown("memory_lock", locked_kb.reason)
    if locked_kb:
        return "locked in memory"
    what = f"process {running.pid} does not lock its memory: paging makes ticks late"
    return SUBJECT.warning("memory_lock", what, "run it with --lock-memory, as the service does")


def _swapped(running: RunningProcess) -> Outcome | None:
    swapped_kb = _kb(running.status, "VmSwap")
    if isinstance(swapped_kb, Unreadable) or not swapped_kb:
        return None
    what = f"{swapped_kb} kB of process {running.pid} are swapped out"
    return SUBJECT.warning("swapped", what, "run it with --lock-memory, or sudo swapoff -a")


def _memory(facts: ProcessFacts) -> Outcome:
    free_kb = _kb(facts.memory, "MemAvailable")
    if isinstance(free_kb, Unreadable):
        return SUBJECT.unknown("memory", free_kb.reason)
    if free_kb >= _MEMORY_AT_LEAST_KB:
        return f"{free_kb >> 10} MB memory free"
    what = f"only {free_kb >> 10} MB memory are free"
    remedy = "find the largest process: ps --sort=-rss -eo rss,comm | head"
    return SUBJECT.warning("memory", what, remedy)


def _swap(facts: ProcessFacts) -> Outcome | None:
    total, free = (_kb(facts.memory, name) for name in ("SwapTotal", "SwapFree"))
    if isinstance(total, Unreadable) or isinstance(free, Unreadable) or total <= free:
        return None
    what = f"{total - free >> 10} MB of swap are in use: what is not locked may be slow"
    return SUBJECT.warning("swap", what, "sudo swapoff -a, and remove it from /etc/fstab")


def _kb(found: dict[str, str] | Unreadable, name: str) -> int | Unreadable:
    if isinstance(found, Unreadable):
        return found
    amount = found.get(name, "").split()
    return int(amount[0]) if amount and amount[0].isdecimal() else Unreadable(f"no {name}")


def _governor(governors: tuple[tuple[str, str], ...]) -> Outcome | None:
    if any(name == "powersave" and driver not in _OWN_GOVERNORS for driver, name in governors):
        what = "the processor runs at its lowest speed (governor powersave)"
        command = f"echo performance | sudo tee {_CPUS}/policy*/scaling_governor"
        return SUBJECT.warning("governor", what, command)
    used = sorted({governor for _, governor in governors})
    return f"governor {' and '.join(used)}" if used else None


def _disk(facts: ProcessFacts) -> Outcome | None:
    if isinstance(facts.disk_mb, Unreadable):
        return SUBJECT.unknown("disk", facts.disk_mb.reason)
    if facts.disk_mb is None:
        return None
    if facts.disk_mb >= _DISK_AT_LEAST_MB:
        return f"{facts.disk_mb} MB disk free"
    what = f"only {facts.disk_mb} MB are free below {STATE_FOLDER}"
    return SUBJECT.warning("disk", what, f"make room: du -ah {STATE_FOLDER} | sort -h | tail")


def judge_buffers(wanted_bytes: int | None, max_bytes: int | Unreadable) -> Iterator[CheckResult]:
    """`wanted_bytes` is bus.receive_buffer_bytes, None where it is not set."""
    wanted = wanted_bytes or _LEAST_BYTES
    who = "a full bus" if wanted_bytes is None else "bus.receive_buffer_bytes"
    if isinstance(max_bytes, Unreadable):
        yield BUFFERS.unknown("rmem_max", max_bytes.reason)
    elif max_bytes < wanted:
        what = f"the kernel gives {max_bytes} bytes, {who} wants {wanted}"
        write = f"echo net.core.rmem_max={wanted} | sudo tee -a {_SYSCTL_FILE}"
        yield BUFFERS.warning("rmem_max", what, f"{write} && sudo sysctl -p {_SYSCTL_FILE}")
    else:
        yield BUFFERS.ok("rmem_max", f"receive buffer of {wanted} bytes is available")
