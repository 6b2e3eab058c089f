"""Time goes wrong: late ticks, pauses, long uptimes, counters at their end, odd places."""

import gc
import json
import os
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from types import SimpleNamespace

import pytest

from tests.core import simulated_drive
from tests.core.simulated_drive import MS, PERIOD_NS, ZERO_TORQUE, Drive, active
from tests.driven import driven
from tests.faults.conftest import ROOT, Seen
from tests.faults.line_client import LineClient
from tests.faults.pure.bystander import once_more
from tests.faults.pure.test_process import commands, moving, next_commands
from vcu_gateway.bus.socketcan import DrainingSocketcanBus
from vcu_gateway.core.codec import Reason
from vcu_gateway.core.demand import ControllerDemand, PowerMode, Refusal
from vcu_gateway.core.schedule import Schedule
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.server.views import counters

FULL = ControllerDemand(throttle_pct=100, power_mode=PowerMode.NORMAL)
SLEW_RAW = 5 / 0.39  # of one period, in codes of the throttle
DAY_NS = 86_400 * 1_000_000_000


def on_the_bench(ticks: int) -> Drive:
    """Driving on a demand that never expires, its throttle still on the rise."""
    drive = Drive(bench_demand=FULL, auto_arm=True)
    drive.demanded = None
    drive.until(Mode.ACTIVE)
    for _ in range(ticks):
        drive.tick()
    return drive


@pytest.mark.parametrize("slept_s", [1, 60, 8 * 3600, 30 * 86_400])
def test_f56_time_that_passed_without_the_program_is_a_late_tick(slept_s, seen: Seen):
    drive = on_the_bench(6)
    assert 0 < drive.commands[0][1] < 200
    drive.silent = set(simulated_drive.RECEIVED)
    result = drive.tick(after_ns=slept_s * 1_000_000_000)
    assert drive.commands == [ZERO_TORQUE] * 2
    assert len(result.frames) == 2, "nothing is made up"
    assert drive.mode is Mode.FAULT
    assert [event for event in drive.events if event.fields.get("cause") == "tick_late"]
    drive.silent = set()
    drive.run(5000)
    assert drive.mode is Mode.FAULT, "latched"
    seen(f"{slept_s} s: zero torque in the first tick, latched", reaction_ms=0)


@pytest.mark.parametrize("periods", [1, 2, 3, 4, 5, 40])
def test_f57_a_late_tick_skips_what_was_missed_and_earns_one_period_at_most(periods, seen: Seen):
    schedule = Schedule(0, PERIOD_NS)
    assert schedule.due(0)
    tick = schedule.due((1 + periods) * PERIOD_NS)
    assert tick is not None
    assert (tick.skipped, schedule.skipped) == (periods, periods)
    assert schedule.due((1 + periods) * PERIOD_NS) is None, "no burst"
    drive = on_the_bench(6)
    before = drive.commands[0][1]
    drive.tick(after_ns=(1 + periods) * PERIOD_NS)
    after = drive.commands[0][1]
    assert after - before <= SLEW_RAW + 1
    # Controllers answer commands only: after 4 missed ones their answers are stale.
    assert drive.mode is (Mode.ACTIVE if periods < 4 else Mode.FAULT)
    late = any(event.fields.get("cause") == "tick_late" for event in drive.events)
    assert late is (periods > 4)
    seen(f"{periods} late: {periods} skipped, throttle {before} to {after}, {drive.mode.value}")


@pytest.mark.ci
@pytest.mark.clock
def test_f59_a_full_collection_finds_nothing_to_walk_and_a_forced_pause_is_a_late_tick(
    tmp_path, seen: Seen
):
    """What lives at the start is frozen: a collection while driving walks what came since."""
    heap = [{"number": [number]} for number in range(400_000)]
    begun_s = time.monotonic()
    gc.collect()
    before_ms = (time.monotonic() - begun_s) * 1000
    with driven(tmp_path) as whole, moving(whole) as driver:
        assert gc.get_freeze_count() > len(heap)
        assert not gc.isenabled(), "none by itself"
        schedule = whole.loop.schedule
        pauses_ms: list[float] = []

        def collect() -> None:
            begun_s = time.monotonic()
            gc.collect()
            pauses_ms.append((time.monotonic() - begun_s) * 1000)

        def mode_after_collections() -> str:
            driver.until_driving()
            wanted = len(pauses_ms) + 5
            for _ in range(5):
                whole.loop.work_queue.post(collect)
                time.sleep(0.06)
            whole.until(lambda: len(pauses_ms) == wanted, "five collections")
            return whole.mode

        once_more(mode_after_collections, lambda mode: mode == "active")
        driver.until_driving()
        skipped = schedule.skipped
        whole.loop.work_queue.post(lambda: time.sleep(0.3))
        whole.until_mode("fault")
        commands(whole)
        next_commands(whole, 2)  # of the tick that saw it
        assert set(next_commands(whole, 8)) == {ZERO_TORQUE}
        missed = schedule.skipped - skipped
    del heap
    assert min(pauses_ms) < before_ms / 4
    assert missed >= 5
    seen(
        f"a collection took {before_ms:.0f} ms before the freeze, {min(pauses_ms):.1f} ms while"
        f" driving; a forced pause of 300 ms: {missed} ticks skipped, zero torque, latched"
    )


# Long uptimes.

ORIGINS_NS = {
    "200 days": 200 * DAY_NS,
    "where a float loses whole nanoseconds": 2**53 - 3 * 1_000_000_000,
    "ten years": 3652 * DAY_NS,
    "the end of 64 bits": 2**63 - 60 * 1_000_000_000,
}


def history(origin_ns: int, monkeypatch: pytest.MonkeyPatch) -> list[tuple[object, ...]]:
    """Everything that a drive with its limits, silences and its end says, from this origin."""
    monkeypatch.setattr(simulated_drive, "NOW_NS", origin_ns)
    told: list[tuple[object, ...]] = []
    drive = active(clear_hold_ms=1000)
    drive.demanded = FULL
    schedule = Schedule(drive.now_ns, PERIOD_NS)
    for tick in range(300):
        drive.codes = {"BMS_Status.CellUndervoltage": 1} if 60 <= tick < 90 else {}
        drive.silent = {"PCU2_Status2"} if 150 <= tick < 160 else set()
        jitter_ns = 7 * MS * (tick % 3 == 1) - 7 * MS * (tick % 3 == 2) + (tick % 5 == 0)
        result = drive.tick(after_ns=PERIOD_NS + jitter_ns)
        due = schedule.due(drive.now_ns)
        age_ns = result.snapshot.age_ns("BMS_Status")
        lateness_ns = due and due.lateness_ns
        told.append((drive.mode, tuple(drive.commands), age_ns, lateness_ns, schedule.skipped))
        if tick == 220:
            drive.demanded = ControllerDemand()
            drive.tick()
            told.append((drive.reset().sentence, drive.mode))
    return told


def edges(origin_ns: int, monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What a nanosecond before, at and after a deadline makes of it, from this origin."""
    monkeypatch.setattr(simulated_drive, "NOW_NS", origin_ns)
    drive = active()
    latest = drive.tick().snapshot.latest("PCU2_Status2")
    assert latest is not None
    drive.silent = {"PCU2_Status2"}
    told: list[object] = []
    for past_ns in (-1, 0, 1):
        after_ns = latest.arrival_ns + 200 * MS + past_ns - drive.now_ns
        told.append(drive.tick(after_ns).snapshot.stale("PCU2_Status2"))
    schedule = Schedule(origin_ns, PERIOD_NS)
    points_ns = (-1, 0, PERIOD_NS - 1, PERIOD_NS + PERIOD_NS // 2 - 1)
    return told + [schedule.due(origin_ns + past_ns) is None for past_ns in points_ns]


@pytest.mark.parametrize("uptime", ORIGINS_NS)
def test_f81_a_long_uptime_is_as_exact_as_the_first_second(uptime, monkeypatch, seen: Seen):
    origin_ns = ORIGINS_NS[uptime]
    # The battery speaks on a grid of half seconds from 0: both origins lie alike on it.
    origin_ns -= origin_ns % (500 * MS)
    late, early = history(origin_ns, monkeypatch), history(1000 * MS, monkeypatch)
    assert late == early
    assert edges(origin_ns, monkeypatch) == [False, False, True, True, False, True, False]
    modes = {told[0] for told in late}
    assert {Mode.ACTIVE, Mode.FAULT} <= modes
    seen(f"{uptime}: {len(late)} ticks with limits, silence, latch and reset equal to the bit;"
         " deadlines to the nanosecond")  # fmt: skip


# Counters.


def test_f82_counters_at_their_end_stay_right(tmp_path, seen: Seen):
    drive = active()
    drive.demanded = FULL
    receiver = drive.gateway.receiver
    highest = (2**32 - 1, 2**53, 2**64 - 1)
    for value in highest:
        receiver.rejected = dict.fromkeys(Reason, value)
        receiver.store.out_of_order = value
        receiver.confirmed = dict.fromkeys(receiver.confirmed, value)
        drive.run(500)
        assert drive.mode is Mode.ACTIVE
        assert drive.commands[0][1] > 0
        drive.gateway.receive(simulated_drive.Frame(0x123, b"", drive.now_ns, extended=False))
        assert counters(drive.gateway)["rejected"]["standard_id"] == value + 1
        assert receiver.confirmed["PCU1"] == value + 10
    drive._sequence = 2**63 - 20
    drive.run(500)
    assert drive.commands[0][1] > 0
    last = drive.offer(FULL, sequence=2**63 - 1)
    assert last.granted
    assert drive.offer(FULL, sequence=2**63 - 1).refusal is Refusal.OLD_SEQUENCE
    drops = _drops_over_the_end()
    with driven(tmp_path) as whole:
        whole.until_ready()
        whole.loop.gateway.receiver.rejected[Reason.UNKNOWN] = 2**64
        with LineClient(whole.socket_path) as client:
            told = client.result("health")["frames"]["rejected"]["unknown"]
            beyond = client.demand(2**63, 0)["error"]["message"]
    assert told >= 2**64
    seen(
        f"statistics beyond {max(highest)} count on; the kernel's 32-bit drops over their end:"
        f" {drops}; sequence 2^63: {beyond}"
    )


def _drops_over_the_end() -> str:
    """The kernel's counter as the bus connection takes it over, given a socket that rolls over."""
    told = iter([2**32 - 5, 2**32 - 1, 3])

    def getsockopt(*_: int) -> bytes:
        return b"".join(n.to_bytes(4, sys.byteorder) for n in (*(0,) * 8, next(told)))

    bus = SimpleNamespace(
        socket=SimpleNamespace(getsockopt=getsockopt),
        _counters=SimpleNamespace(dropped=0),
        _drops_before=0,
    )
    seen = []
    for _ in range(3):
        DrainingSocketcanBus._count_drops(bus)  # type: ignore[arg-type]  # the part it uses
        seen.append(bus._counters.dropped)
    assert seen == [2**32 - 5, 2**32 - 1, 2**32 + 3]
    return f"{seen[1]} then {seen[2]}"


# Places.

PLACES = {
    "Turkish": {"LANG": "tr_TR.UTF-8", "LC_ALL": "tr_TR.UTF-8"},
    "C": {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "a zone with summer time": {"TZ": "Europe/Berlin"},
    "no zone data": {"TZ": "Asia/Taipei", "TZDIR": "/nonexistent", "PYTHONTZPATH": ""},
    "a zone that does not exist": {"TZ": ":/dev/null"},
}


@pytest.mark.ci
@pytest.mark.clock
def test_f83_language_and_time_zone_change_neither_words_nor_stamps(tmp_path, seen: Seen):
    config = tmp_path / "gateway.yaml"
    config.write_text(
        "bus: {interface: virtual, channel: alone}\n"
        f"api: {{enabled: false, socket_path: {tmp_path / 'control.sock'}}}\n"
    )
    begun_s = time.time()
    places = ("here", *PLACES)
    with ThreadPoolExecutor(2) as pool:
        outputs = dict(
            zip(places, pool.map(lambda place: _run_at(place, config), places), strict=True)
        )
    here = outputs.pop("here")
    assert len(here) >= 5
    for place, lines in outputs.items():
        assert _words(lines) == _words(here), place
        for stamp in re.findall(r'"timestamp": "([^"]*)"', "\n".join(lines)):
            assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z", stamp)
            told_s = datetime.fromisoformat(stamp).timestamp()
            assert begun_s - 1 < told_s < time.time() + 1, f"{place}: {stamp} is no UTC"
    seen(f"{len(here)} log lines the same words in {len(outputs)} places, stamps in UTC")


def _run_at(place: str, config) -> list[str]:
    """Its log; of a run in which the machine stood still for ticks there is more to tell: again."""
    for _ in range(5):
        done = subprocess.run(
            [sys.executable, "-m", "vcu_gateway", "run", "-c", str(config), "--duration", "1.3"],
            env={**os.environ, **PLACES.get(place, {})},
            capture_output=True,
            timeout=60,
            cwd=ROOT,
        )
        assert done.returncode == 0, done.stderr
        lines = done.stderr.decode("ascii").splitlines()
        if not any(cause in line for line in lines for cause in ('"tick_late"', '"unconfirmed"')):
            break
    return lines


# Of one second's figures some are there only where a tick was missed.
FIGURES = {"timestamp", "unsent_frames", "lateness_p50_below_us", "lateness_p99_below_us"}


def _words(lines: list[str]) -> list[dict[str, str]]:
    """What each line says, without figures."""
    entries = [json.loads(line) for line in lines]
    return [
        {key: re.sub(r"[\d.]+", "#", str(entry[key])) for key in entry.keys() - FIGURES}
        for entry in entries
        if entry["event"] != "ticks_skipped"
    ]
