"""Recorder: running and connected, room, disk, latency of its writes, gaps.

Disk that the recordings are on: file system, device, what it has been through.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.doctor.check_result import (
    CheckResult,
    CheckSubject,
    Outcome,
    Unreadable,
    existing,
    text,
)
from vcu_gateway.doctor.service import ServiceFacts
from vcu_gateway.errors import GatewayError, NotPermittedError, Problem
from vcu_gateway.recording.layout import DEFAULT_FOLDER as FOLDER
from vcu_gateway.recording.recorder_status import STALE_S, RecorderStatus, read_status

_MOUNTS = "/proc/self/mountinfo"
_BLOCK_DEVICES = "/sys/dev/block"
_SECTOR_BYTES = 512


class RecordingDisk(NamedTuple):
    """Facts about it.

    Attributes:
        file_system: such as ext4 or tmpfs.
        is_read_only: nothing can be written.
        free_bytes: free for others than root.
        card: "SD" or "MMC" for a card or an eMMC; empty for other devices.
        card_bytes: size of the whole card; 0 where it is none.
        worn_pct: share of its life that an eMMC says it has used, in steps of 10; None where it
            does not say.
    """

    file_system: str
    is_read_only: bool
    free_bytes: int
    card: str = ""
    card_bytes: int = 0
    worn_pct: int | None = None


def disk_of(folder: str) -> RecordingDisk:
    found, device = os.statvfs(folder), os.stat(folder).st_dev
    disk = RecordingDisk(
        _file_system_of(device),
        bool(found.f_flag & os.ST_RDONLY),
        found.f_bavail * found.f_frsize,
    )
    return _with_card(disk, Path(_BLOCK_DEVICES, f"{os.major(device)}:{os.minor(device)}"))


def _file_system_of(device: int) -> str:
    """Type of the file system on this device; empty where it is not mounted here."""
    mounts = text(_MOUNTS)
    number = f"{os.major(device)}:{os.minor(device)}"
    lines = [] if isinstance(mounts, Unreadable) else mounts.splitlines()
    for line in lines:
        own, _, of_file_system = line.partition(" - ")
        if own.split()[2:3] == [number]:
            return of_file_system.split()[0]
    return ""


def _with_card(disk: RecordingDisk, block: Path) -> RecordingDisk:
    """With what a card's driver tells; a partition's disk is the folder above it."""
    whole = block.resolve()
    if (whole / "partition").exists():
        whole = whole.parent
    kind, sectors = text(str(whole / "device/type")), text(str(whole / "size"))
    if kind not in ("SD", "MMC") or not isinstance(sectors, str) or not sectors.isdecimal():
        return disk
    return disk._replace(
        card=kind,
        card_bytes=int(sectors) * _SECTOR_BYTES,
        worn_pct=worn_pct(text(str(whole / "device/life_time"))),
    )


def worn_pct(told: str | Unreadable) -> int | None:
    """The larger estimate of an eMMC, such as of `0x01 0x02`; None for 0, which says nothing."""
    words = told.split() if isinstance(told, str) else []
    try:
        steps = max((int(word, 16) for word in words), default=0)
    except ValueError:
        return None
    return 10 * steps if steps else None


SUBJECT = CheckSubject("recorder")
SOCKET_UNIT = "vcu-gateway-recorder.socket"
UNIT = "vcu-gateway-recorder.service"

_NOMINAL_BYTES_A_S = 16e6 / 3600
_DAY_S, _YEAR_S = 86_400, 365 * 86_400
_HOURS_AT_LEAST = 8
_SLOW_S = 1.0
_LOST_AT_MOST = 1e-3
_MB, _GB = 1e6, 1e9
_IN_MEMORY = ("tmpfs", "ramfs")
_TOLD = {"full": "is full", "failing": "does not take anything", "stalled": "does not answer"}
_CARD_CYCLES = 1_000
_WRITTEN_PER_BYTE = 3 * 10
"""What the file system adds, and what a card makes of small synchronous writes."""
_YEARS_AT_LEAST = 3
_WORN_PCT = 80


class RecorderFacts(NamedTuple):
    """Facts about the recorder.

    Attributes:
        status: what it told last; a Problem where that cannot be read, None where there is none.
        age_s: of the status.
        gateway_runs: and would be recorded.
    """

    socket: ServiceFacts
    status: RecorderStatus | Problem | None
    age_s: float
    disk: RecordingDisk | Unreadable | None
    gateway_runs: bool


def read(socket: ServiceFacts, *, gateway_runs: bool) -> RecorderFacts:
    status: RecorderStatus | Problem | None
    try:
        status = read_status()
    except NotPermittedError as error:
        status = error.problems[0]
    except GatewayError:
        status = None
    folder, age_s = FOLDER, 0.0
    if isinstance(status, RecorderStatus):
        folder, age_s = Path(status.folder), status.age_s()
    return RecorderFacts(socket, status, age_s, existing(str(folder), disk_of), gateway_runs)


def judge(facts: RecorderFacts) -> Iterator[CheckResult]:
    """Judge the recorder; nothing where it is not installed. No fault of it is `wrong`."""
    if not facts.socket.is_installed:
        return
    if not facts.socket.is_active:
        yield _off(facts.socket)
        return
    yield from SUBJECT.summarise("", _running(facts))
    yield from SUBJECT.summarise("disk", _disk(facts))


def _off(socket: ServiceFacts) -> CheckResult:
    if socket.is_enabled:
        what = f"{SOCKET_UNIT} does not listen: nothing is recorded"
        return SUBJECT.warning("active", what, f"sudo systemctl start {SOCKET_UNIT}")
    hint = f"sudo systemctl enable --now {SOCKET_UNIT}"
    return SUBJECT.ok("active", f"{SOCKET_UNIT} is not enabled: nothing is recorded", hint)


def _running(facts: RecorderFacts) -> Iterator[Outcome | None]:
    status = facts.status
    if isinstance(status, Problem):
        yield SUBJECT.unknown("status", f"{status.where}: {status.what}", status.remedy)
    elif status is None or facts.age_s > STALE_S:
        yield _silent(facts, status)
    else:
        yield f"running as {status.pid}"
        yield _connected(status, facts.gateway_runs)
        yield _lost(status)
        yield _written(status)


def _silent(facts: RecorderFacts, status: RecorderStatus | None) -> Outcome:
    if status is not None:
        what = f"it has said nothing for {facts.age_s:.0f} s: it hangs or is gone"
        return SUBJECT.warning("status", what, f"journalctl -u {UNIT} -n 20")
    if facts.gateway_runs:
        what = "the gateway runs, and no recorder: nothing is recorded"
        remedy = f"recorder.socket_path in gateway.yaml; journalctl -u {UNIT} -n 20"
        return SUBJECT.warning("status", what, remedy)
    return f"{SOCKET_UNIT} listens, no gateway has connected yet"


def _connected(status: RecorderStatus, gateway_runs: bool) -> Outcome:
    channels = sorted(one.channel for one in status.connections)
    if channels:
        return f"recording {' and '.join(channels)}"
    if not gateway_runs:
        return "no gateway is connected"
    what = "the gateway runs and is not connected: nothing is recorded"
    return SUBJECT.warning("connected", what, "recorder.socket_path in gateway.yaml")


def _lost(status: RecorderStatus) -> Outcome:
    totals = status.totals
    handed_on = totals.frames + totals.frames_lost
    gaps = f"{totals.gaps} gaps with {totals.frames_lost} of {handed_on} frames"
    if totals.frames_lost <= _LOST_AT_MOST * handed_on:
        return gaps if totals.gaps else "no gaps"
    return SUBJECT.warning("gaps", gaps, f"why: journalctl -u {UNIT}; vcu-gateway recordings check")


def _written(status: RecorderStatus) -> Outcome | None:
    if status.disk in _TOLD:
        what = f"the disk {_TOLD[status.disk]}: {status.last_error or 'for more than 2 s'}"
        waits = f"{status.waiting_bytes / _MB:.0f} of {status.memory_bytes / _MB:.0f} MB wait"
        return SUBJECT.warning("disk", f"{what}; {waits} in memory", f"df -h {status.folder}")
    longest_s = status.longest_sync_s
    if longest_s is None:
        return None
    if longest_s <= _SLOW_S:
        return f"on the disk within {longest_s * 1000:.0f} ms"
    what = f"the disk takes up to {longest_s:.1f} s: so much more is lost when the power fails"
    return SUBJECT.warning("latency", what, "a faster card, or a disk of their own for recordings")


def _disk(facts: RecorderFacts) -> Iterator[Outcome | None]:
    disk = facts.disk
    if isinstance(disk, Unreadable):
        yield SUBJECT.unknown("room", disk.reason)
    if not isinstance(disk, RecordingDisk):
        return
    status = facts.status if isinstance(facts.status, RecorderStatus) else None
    rate = max(status.bytes_a_second if status else 0.0, _NOMINAL_BYTES_A_S)
    yield _file_system(disk)
    if status is not None:
        yield _room(disk, status, rate)
    yield _wear(disk, rate)


def _file_system(disk: RecordingDisk) -> Outcome | None:
    if disk.file_system in _IN_MEMORY:
        what = f"recordings are in memory ({disk.file_system}): a power cut takes all of them"
        return SUBJECT.warning("file_system", what, f"mount a disk at {FOLDER}")
    if disk.is_read_only:
        what = "the file system of the recordings is read-only"
        return SUBJECT.warning("file_system", what, f"mount a disk at {FOLDER}")
    return disk.file_system or None


def _room(disk: RecordingDisk, status: RecorderStatus, rate: float) -> Outcome:
    """How much driving the ring holds at the present rate, never less than the nominal one."""
    beside = disk.free_bytes - status.keep_free_bytes + status.drives_bytes
    room_bytes = max(0, min(status.max_bytes, beside))
    hours = room_bytes / rate / 3600
    holds = f"{_hours(hours)} of driving at {rate * 3600 / _MB:.0f} MB/h"
    if hours >= _HOURS_AT_LEAST:
        return f"room for {holds}"
    what = f"the last {holds} are kept, and no more: {disk.free_bytes / _GB:.1f} GB are free"
    return SUBJECT.warning("room", what, "make room, or a disk of their own (docs/recordings.md)")


def _hours(hours: float) -> str:
    return f"{hours:.0f} h" if hours < 100 else f"{hours / 24:.0f} days"


def _wear(disk: RecordingDisk, rate: float) -> Outcome | None:
    """Of a card; years if it were written day and night."""
    if not disk.card:
        return None
    if disk.worn_pct is not None and disk.worn_pct >= _WORN_PCT:
        what = f"the eMMC has used {disk.worn_pct} % of its life"
        return SUBJECT.warning("wear", what, "replace it, or a disk of their own for recordings")
    years = disk.card_bytes * _CARD_CYCLES / (rate * _WRITTEN_PER_BYTE) / _YEAR_S
    name = "eMMC" if disk.card == "MMC" else "SD card"
    a_day = f"{rate * _DAY_S / _MB:.0f} MB a day"
    if years >= _YEARS_AT_LEAST:
        return f"{name} of {disk.card_bytes / _GB:.0f} GB, {a_day} if driven day and night"
    what = f"{a_day} wear the {name} out in about {years:.1f} years of driving"
    return SUBJECT.warning("wear", what, "a larger one, or a disk of their own for recordings")
