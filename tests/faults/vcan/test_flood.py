"""More on the bus than one can read: what is lost is counted exactly, and no tick waits."""

import functools
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest

from tests.faults import reference_ticks
from tests.faults.conftest import Seen
from tests.faults.driving import (
    MS,
    BusStand,
    Driving,
    record,
    set_up,
    stopped_within_ms,
    told,
    undisturbed,
)
from tests.faults.flood import EFF, ERR, Flood, poured, send
from tests.vcan.conftest import COMMANDS, wait_until

BMS_STATUS, BMS_TEMPERATURES = 0x1808D0F4, 0x1809D0F4
FLOODED = {"IMU_Acceleration": 0x040AD079, "IMU_AngularRate": 0x040BD079}
TRAFFIC = (*COMMANDS, BMS_STATUS, BMS_TEMPERATURES, 0x0808D0A7, 0x0808D0A8, 0x0809D0A7,
           0x0809D0A8, 0x040AD092)  # fmt: skip
FOREIGN = ((EFF | 0x00000001, bytes(8)), (0x001, bytes(8)), (EFF | 0x0CF00400, bytes(8)))
LEVEL = bytes.fromhex("a81ea81ea81e0000")
OWN = tuple((EFF | can_id, LEVEL) for can_id in FLOODED.values())
QUEUED_FRAMES = 555  # of this lab's kernel: twice net.core.rmem_max
TICK_MS = 50 + 5
QUIET_BUSY_S, FLOOD_BUSY_S = 0.0005, 0.0025
pytestmark = pytest.mark.timeout(300)  # for a machine that stalls again and again


@pytest.fixture
def flooded(alone: BusStand) -> Iterator[Driving]:
    """Drives; everything with our identifiers but the flood is recorded."""
    one = Driving(alone, recording=record(alone, "", TRAFFIC))
    one.until_serving()
    one.until_link("up")  # from here on it receives what is recorded
    one.start_vehicle()
    yield one
    one.let_go()


def accounted_for(driving: Driving, counts: Counter[int], seen: Seen) -> dict[str, Any]:
    """End it; every frame with our identifiers was received or is counted as dropped."""
    state = driving.ended()
    own = sum(n for can_id, n in counts.items() if can_id & ~EFF in FLOODED.values())
    bus = state["bus"]
    counted = bus["received"] + bus["dropped"]
    wait_until(lambda: own + len(driving.recording.frames()) >= counted, "the recorder")
    others = len(driving.recording.frames())
    assert counted == own + others, "each frame is here or there"
    received = {name: state["messages"][name]["frame_count"] for name in FLOODED}
    lost = own - sum(received.values()) - state["counters"]["out_of_order"]
    assert lost <= bus["dropped"]
    seen(
        f"{sum(counts.values())} frames flooded, {own} of them with our identifiers: "
        f"{sum(received.values())} taken in, {bus['dropped']} counted as dropped with the "
        f"{others} others, none unaccounted for"
    )
    return state


class Spell(NamedTuple):
    """So many seconds of driving.

    Attributes:
        stalls: ticks that another Python process missed, as busy as the gateway.
        p99_ms: lateness of the gateway's ticks, up to the latest 1200.
    """

    ticks: int
    skipped: int
    stalls: int
    p99_ms: float

    def __str__(self) -> str:
        return (
            f"{self.skipped} of {self.ticks} ticks skipped, {self.stalls} by a bystander, "
            f"late p99 {self.p99_ms:.1f} ms"
        )


def spell(
    driving: Driving, duration_s: float, bystander_busy_s: float, *beside: Callable[[], None]
) -> Spell:
    """Seconds of driving; `beside` is done meanwhile, by processes of their own."""
    return ready(driving, duration_s, bystander_busy_s, *beside)()


def ready(
    driving: Driving, duration_s: float, bystander_busy_s: float, *beside: Callable[[], None]
) -> Callable[[], Spell]:
    """The same, begun by calling what is returned: it drives and every process is there."""
    path = driving.stand.folder / "late_ticks"
    bystander = functools.partial(reference_ticks.run, path, duration_s, bystander_busy_s)
    works: list[Callable[[], None]] = [bystander, *beside]
    begins = [driving.stand.held(work) for work in works]
    driving.until_driving()

    def measured() -> Spell:
        before = driving.client.health()
        for begin in begins:
            begin()
        wait_until(path.exists, "the bystander", duration_s + 60)
        after, stalls = driving.client.health(), reference_ticks.skipped(path)
        path.unlink()
        skipped = after["ticks"]["skipped"] - before["ticks"]["skipped"]
        done = after["ticks"]["done"] - before["ticks"]["done"]
        p99_ms = (after["ticks"]["lateness_p99_us"] or 0) / 1000
        return Spell(skipped + done, skipped, stalls, p99_ms)

    return measured


@pytest.mark.parametrize(
    "duration_s",
    [
        pytest.param(5, marks=pytest.mark.ci),
        pytest.param(60, marks=[pytest.mark.slow, pytest.mark.timeout(400)]),
    ],
)
def test_f34_a_full_bus_costs_no_tick_and_every_dropped_frame_is_counted(
    flooded: Driving, seen: Seen, duration_s: int
):
    counts: Counter[int] = Counter()
    # One in eight is for us: more is more than the lab's one processor reads.
    flood = Flood((*FOREIGN * 7, *OWN, OWN[0]), 8000, duration_s)

    def costs_no_tick() -> bool:
        quiet = spell(flooded, duration_s, QUIET_BUSY_S)
        counts_path = flooded.stand.folder / f"counts-{counts.total()}"
        pour = functools.partial(flood.pour, counts_path)
        flooded_spell = ready(flooded, duration_s, FLOOD_BUSY_S, pour)
        begun_s = time.monotonic()
        full = flooded_spell()
        sent = poured(counts_path)
        counts.update(sent)
        rate_hz = sent.total() / (time.monotonic() - begun_s)
        seen(f"{rate_hz:.0f} frames/s for {duration_s} s: {full}; as long without them: {quiet}")
        # What the machine takes from every process is no fault of the flood; one tick in twenty
        # of leeway tells from a gateway that is held up by it, which would miss most.
        return full.skipped <= 2 * (full.stalls + quiet.skipped) + full.ticks // 20

    undisturbed_by_it = costs_no_tick() or costs_no_tick()
    state = accounted_for(flooded, counts, seen)
    flooded.check()
    assert state["bus"]["receiver_bugs"] == 0
    assert undisturbed_by_it, seen.sentences


@pytest.mark.parametrize("duration_s", [2, pytest.param(4, marks=pytest.mark.ci)])
def test_f34_what_is_for_us_and_more_than_can_be_read_is_dropped_and_counted_exactly(
    flooded: Driving, seen: Seen, duration_s: int
):
    counts_path = flooded.stand.folder / "counts"
    pour = functools.partial(Flood(OWN, 8000, duration_s).pour, counts_path)
    flooded_spell = ready(flooded, duration_s, FLOOD_BUSY_S, pour)
    begun_s = time.monotonic()
    full = flooded_spell()
    counts = poured(counts_path)
    rate_hz = sum(counts.values()) / (time.monotonic() - begun_s)
    accounted_for(flooded, counts, seen)
    flooded.check()
    # How many ticks come is a question of the machine: one processor has nothing left for them.
    seen(f"{rate_hz:.0f} frames/s, all for us: {full}")


def test_f35_after_an_overflow_old_frames_count_as_old_and_the_lost_ones_are_counted(
    flooded: Driving, seen: Seen
):
    pid = flooded.gateway.popen.pid
    assert pid is not None
    counts: Counter[int] = Counter()

    def stop_ms() -> float:
        flooded.until_driving()
        os.kill(pid, signal.SIGSTOP)
        assert flooded.vehicle is not None
        flooded.vehicle.stop()
        spoken_ns = [f for f in flooded.recording.frames() if f.can_id == BMS_STATUS][-1].stamp_ns
        counts_path = flooded.stand.folder / f"counts-{counts.total()}"
        Flood(OWN, 500, 2).pour(counts_path)
        counts.update(poured(counts_path))
        held_ns = time.time_ns()
        os.kill(pid, signal.SIGCONT)
        resumed_ns = time.time_ns()
        wait_until(lambda: flooded.mode() != "active", "the disarming")
        age_ms = flooded.client.state(["BMS_Status"])["messages"]["BMS_Status"]["age_ms"]
        assert age_ms is not None
        assert age_ms >= (held_ns - spoken_ns) / MS, "as old as it is, though it was read just now"
        wait_until(lambda: len(flooded.commands(resumed_ns)) >= 8, "command frames")
        found_ms = stopped_within_ms(flooded, resumed_ns)
        seen(
            f"held for {(held_ns - spoken_ns) / MS:.0f} ms since the battery's last word: zero "
            f"torque {found_ms:.0f} ms after it went on; the word is {age_ms:.0f} ms old"
        )
        return found_ms

    found = [stop_ms()]
    if found[0] > 2 * TICK_MS:
        flooded.start_vehicle()
        found.append(stop_ms())
    wait_until(lambda: flooded.events("frames_dropped") != [], "the word")
    state = accounted_for(flooded, counts, seen)
    assert state["bus"]["dropped"] >= counts.total() - len(found) * QUEUED_FRAMES
    flooded.check()
    seen(f"stopped {told(found)} after it went on", reaction_ms=found[-1])
    assert found[-1] <= 2 * TICK_MS


def test_f35_what_waited_in_a_socket_whose_link_went_down_is_counted_as_dropped(
    alone: BusStand, seen: Seen
):
    alone.bus = ", receive_buffer_bytes: 16777216"
    driving = Driving(alone, recording=record(alone, "", TRAFFIC))
    driving.until_serving()
    wait_until(lambda: driving.events("receive_buffer_small") != [], "the caution")
    caution = driving.events("receive_buffer_small")[0]
    assert caution["command"] == "sysctl -w net.core.rmem_max=16777216"
    pid = driving.gateway.popen.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    counts_path = driving.stand.folder / "counts"
    Flood(OWN, 2000, 1).pour(counts_path)
    set_up("vcan0", up=False)
    set_up("vcan0")
    os.kill(pid, signal.SIGCONT)
    wait_until(lambda: driving.events("link_open")[1:] != [], "the second opening")
    driving.until_link("up")
    state = accounted_for(driving, poured(counts_path), seen)
    driving.let_go()
    assert state["bus"]["dropped"] >= 1000
    seen(f"a buffer of {caution['given_bytes']} of {caution['asked_bytes']} bytes was reported")


@pytest.mark.parametrize(
    ("classes", "bits", "rate_hz"),
    [
        pytest.param(0x088, 0x00, 10_000, id="bus errors"),
        pytest.param(0x004, 0x08, 2_000, id="warnings", marks=pytest.mark.ci),
    ],
)
def test_f36_a_flood_of_error_frames_neither_hides_data_nor_fills_the_log(
    driving: Driving, seen: Seen, classes: int, bits: int, rate_hz: int
):
    frame = (ERR | classes, bytes([0, bits, 0, 0, 0, 0, 0, 0]))
    stalls: list[int] = []

    def flood() -> None:
        counts_path = driving.stand.folder / f"errors-{classes:03x}-{len(stalls)}"
        pour = functools.partial(Flood([frame], rate_hz, 3).pour, counts_path)
        flooded_spell = ready(driving, 3, QUIET_BUSY_S, pour)
        begun_s, lines_before = time.monotonic(), driving.lines()
        before = driving.client.health()["frames"]
        full = flooded_spell()
        stalls.append(full.stalls)
        counts, after = poured(counts_path), driving.client.health()["frames"]
        took_s = time.monotonic() - begun_s
        confirmed = after["confirmed"]["PCU1"] - before["confirmed"]["PCU1"]
        handled = after["rejected"]["error"] - before["rejected"]["error"]
        lines = driving.lines() - lines_before
        assert driving.mode() == "active"
        assert after["dropped"] == before["dropped"], "no frame was lost to them"
        assert handled <= took_s * 80, "no more than readings of the socket"
        assert lines <= 6
        assert full.skipped <= 2 * full.stalls + full.ticks // 3
        assert confirmed >= 2 * (full.ticks - full.skipped) // 3
        seen(
            f"{counts.total()} error frames of class {classes:#05x}: {handled} looked at, "
            f"{lines} lines of log, {confirmed} own frames confirmed meanwhile, active; {full}"
        )

    undisturbed(driving, flood, lambda: sum(stalls))
    send((ERR | 0x004, bytes([0, 0x40, 0, 0, 0, 0, 0, 0])))
    driving.until_link("up")
