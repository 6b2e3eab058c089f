"""A pedal node whose wires, tracks or frames are wrong, in simulated time: faults 85 to 91."""

import pytest

from tests.faults.conftest import Seen
from tests.simulator.driving import Drive
from tests.simulator.pedals import BREAKS_S, DRIVEN_PCT, driven, throttle_pct
from vcu_gateway.core.supervisor import Mode

LETS_GO_S = 8.0
LETS_GO = "[4.5, 43], [8, 43], [8.02, 0], [9, 0], [9.02, 43]"  # and presses again
TRACK1, TRACK2 = "Pedals_Position.Throttle1", "Pedals_Position.Throttle2"


def told(done: Drive, at_s: float) -> set[str]:
    """Causes that are told."""
    why = done.tick_at(at_s).why
    return {one.finding.key[0] for one in (*why.alarms, *why.blocks)}


def until_zero_ms(done: Drive, from_s: float = BREAKS_S) -> float:
    """From then to the first tick without throttle; none has any after it."""
    assert throttle_pct(done, from_s) > DRIVEN_PCT
    ticks = [tick for tick in done.ticks if tick.at_s > from_s]
    zero = [number for number, tick in enumerate(ticks) if not tick.frames[0][1]]
    assert zero == [*range(zero[0], len(ticks))]
    return (ticks[zero[0]].at_s - from_s) * 1000


@pytest.mark.parametrize("fault", [
    f"signal: {TRACK1}, value: 0",
    f"signal: {TRACK2}, value: 5",
    "signal: Pedals_Position.BrakePressure, raw: 1023",
    "signal: Pedals_Position.ReverseSwitch, raw: 3",
])  # fmt: skip
def test_f85_an_open_wire_takes_the_throttle_at_once_until_the_foot_is_off(fault, seen: Seen):
    done = driven(f"fault: set, {fault}, for_s: 1")
    reaction_ms = until_zero_ms(done)
    assert reaction_ms <= 20 + 50  # the node's period and a tick
    assert "pedal_signal" in told(done, 9.9)
    assert done.tick_at(9.9).mode is Mode.ACTIVE
    seen(f"{fault} for 1 s: throttle 0 to the end, the foot did not let go", reaction_ms)


@pytest.mark.parametrize("track", [TRACK1, TRACK2])
def test_f86_a_stuck_track_takes_the_throttle_when_the_foot_lets_go(track, seen: Seen):
    done = driven(
        f"fault: freeze, signal: {track}", f"foot: {{throttle_pct: [[0, 0], [4, 0], {LETS_GO}]}}"
    )
    reaction_ms = until_zero_ms(done, LETS_GO_S)
    assert reaction_ms <= 20 + 100 + 20 + 50  # the foot, the rule, the node's period, a tick
    seen(
        f"{track} stuck at 43 %, the foot lets go and presses again: no throttle any more",
        reaction_ms,
    )


def test_f87_swapped_tracks_take_the_throttle(seen: Seen):
    done = driven(f"fault: swap, signal: {TRACK1}, with_signal: {TRACK2}")
    reaction_ms = until_zero_ms(done)
    assert reaction_ms <= 100 + 20 + 50
    seen("throttle 0 to the end, the foot did not let go", reaction_ms)


def must_end_the_drive(done: Drive) -> float:
    """The demand expires 60 ms after the last frame that was one; by then it is told."""
    reaction_ms = until_zero_ms(done)
    assert reaction_ms <= 60 + 50
    assert done.tick_at(9.9).mode is Mode.STANDBY
    assert "pedal_frame" in told(done, BREAKS_S + 0.2)
    return reaction_ms


def test_f88_a_frozen_counter_ends_the_drive(seen: Seen):
    reaction_ms = must_end_the_drive(driven("fault: freeze, signal: Pedals_Position.Counter"))
    seen("throttle 0, standby", reaction_ms)


@pytest.mark.parametrize("fault", [
    "fault: set, signal: Pedals_Position.Checksum, raw: 1, for_s: 1",
    "fault: corrupt, of: PEDALS",
])  # fmt: skip
def test_f89_frames_with_a_wrong_checksum_end_the_drive_until_armed_again(fault, seen: Seen):
    reaction_ms = must_end_the_drive(driven(fault))
    seen(f"{fault}: throttle 0, standby", reaction_ms)


def must_drive_on(done: Drive) -> None:
    since = [tick for tick in done.ticks if tick.at_s > BREAKS_S]
    assert {tick.mode for tick in since} == {Mode.ACTIVE}
    assert len({tick.frames[0][1] for tick in since}) == 1
    assert throttle_pct(done, 9.9) > DRIVEN_PCT


@pytest.mark.parametrize("fault", [
    "fault: delay, of: PEDALS, delay_ms: 30",
    "fault: drop, of: Pedals_Position, share_pct: 2, seed: 3",
])  # fmt: skip
def test_f90_a_late_or_lost_frame_changes_nothing(fault, seen: Seen):
    must_drive_on(driven(fault))
    seen(f"{fault}: the same throttle in every tick")


def test_f91_frames_that_come_twice_change_nothing_and_are_counted(seen: Seen):
    done = driven("fault: duplicate, of: PEDALS")
    must_drive_on(done)
    heard = done.heard_of("Pedals_Position", BREAKS_S)
    doubled = sum(at_s <= done.ticks[-1].at_s for at_s, _ in heard) // 2
    rejected = {reason.value: count for reason, count in done.gateway.counters.rejected.items()}
    assert rejected["pedal_counter"] == doubled
    seen(f"{rejected['pedal_counter']} second ones counted as `pedal_counter`, throttle the same")
