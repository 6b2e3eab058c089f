"""The verdict finds every rule that a recording breaks: one drive, one thing broken in it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.replay.drives import MS, SimulatedDrive
from tests.replay.ran import replay
from vcu_gateway.core import calls
from vcu_gateway.core.calls import (
    Arm,
    EmergencyStop,
    NoteRestartState,
    NoteSent,
    Offer,
    Reset,
)
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.judge.arrivals import Arrivals
from vcu_gateway.judge.demands import GrantedDemands
from vcu_gateway.judge.limits import JudgedDemand
from vcu_gateway.judge.mode_rules import ModeRules, TickCauses
from vcu_gateway.judge.result import DriveVerdict, Findings
from vcu_gateway.protocol import DEFAULT_ALIASES
from vcu_gateway.recording.core_lines import CoreRecord, FrameRun, InputRecord, TickRecord
from vcu_gateway.recording.reader import open_drive
from vcu_gateway.replay.judged import JudgedRecords, limits_of

Records = list[FrameRun | CoreRecord]
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")


def stops(folder: Path) -> Path:
    """A drive that a STOP ends, a reset and an arm begin again, and an emergency stop ends."""
    drive = SimulatedDrive(folder).begin()
    drive.throttle(40.0)
    drive.run(3.0)
    drive.change = lambda name, data: (
        data[:5] + bytes([data[5] | 0b1000]) + data[6:] if name == "BMS_Status" else data
    )
    drive.run(1.0)  # undervoltage 2
    drive.change = lambda name, data: data
    drive.throttle(0.0)
    drive.run(2.0)
    assert drive.gateway.apply(calls.Reset(FaultClass.DRIVER, drive.now_ns)).granted
    drive.run(1.0)
    assert drive.arm()
    drive.throttle(20.0)
    drive.run(2.0)
    drive.gateway.apply(calls.EmergencyStop())
    drive.run(1.0)
    return drive.end()


@pytest.fixture(scope="session")
def records(recorded, tmp_path_factory) -> dict[str, Records]:
    folders = recorded | {"stops": stops(tmp_path_factory.mktemp("stops") / "drive")}
    return {name: list(open_drive(folder).runs()) for name, folder in folders.items()}


def judged(records: Records) -> DriveVerdict:
    judge = JudgedRecords(next(iter(records)).settings, DEFAULT_ALIASES)
    for record in records:
        judge.note(record)
    return judge.verdict()


def ticks(records: Records, mode: Mode = Mode.ACTIVE) -> list[int]:
    return [
        place
        for place, record in enumerate(records)
        if isinstance(record, TickRecord) and record.mode is mode
    ]


def tick(records: Records, place: int) -> TickRecord:
    record = records[place]
    assert isinstance(record, TickRecord)
    return record


def with_data(
    change: Callable[[bytes], bytes], which: int = 60, mode: Mode = Mode.ACTIVE
) -> Callable[[Records], None]:
    """Both commands of one tick changed, as they were decided and as they were sent."""

    def mutate(records: Records) -> None:
        place = ticks(records, mode)[which]
        one = tick(records, place)
        frames = tuple(frame._replace(data=change(frame.data)) for frame in one.frames)
        records[place] = one._replace(frames=frames)

    return mutate


def put(**bytes_at: int) -> Callable[[bytes], bytes]:
    """Bytes of a command replaced: b0=..., b1=..."""

    def change(data: bytes) -> bytes:
        made = bytearray(data)
        for name, value in bytes_at.items():
            made[int(name[1:])] = value
        return bytes(made)

    return change


def with_mode(which: int, mode: Mode, begin: Mode = Mode.ACTIVE) -> Callable[[Records], None]:
    def mutate(records: Records) -> None:
        place = ticks(records, begin)[which]
        records[place] = tick(records, place)._replace(mode=mode)

    return mutate


def without(kind: type, which: int = 0) -> Callable[[Records], None]:
    def mutate(records: Records) -> None:
        inputs = [
            place
            for place, record in enumerate(records)
            if isinstance(record, InputRecord) and isinstance(record.input, kind)
        ]
        del records[inputs[which]]

    return mutate


def one_frame(records: Records) -> None:
    place = ticks(records)[50]
    one = tick(records, place)
    records[place] = one._replace(frames=one.frames[:1])
    del records[place + 2]


def other_identifier(records: Records) -> None:
    place = ticks(records)[50]
    one = tick(records, place)
    first, second = one.frames
    records[place] = one._replace(frames=(OutFrame("PCU1", 0x0408A7D0, first.data), second))


def opposite_directions(records: Records) -> None:
    place = ticks(records)[50]
    one = tick(records, place)
    first, second = one.frames
    turned = second._replace(data=put(b0=second.data[0] ^ 0x10)(second.data))
    records[place] = one._replace(frames=(first, turned))


def too_early(records: Records) -> None:
    place = ticks(records)[50]
    records[place] = tick(records, place)._replace(now_ns=tick(records, place).now_ns - 30 * MS)


def still_driving(records: Records) -> None:
    """After the STOP the commands before it are sent again, in ACTIVE."""
    last = tick(records, [one for one in ticks(records) if one < ticks(records, Mode.FAULT)[0]][-1])
    for place in ticks(records, Mode.FAULT)[:3]:
        records[place] = tick(records, place)._replace(frames=last.frames, mode=Mode.ACTIVE)


def late_reaction(records: Records) -> None:
    """The frame with the cause is older than it was."""
    first = ticks(records, Mode.FAULT)[0]
    for place in range(first, 0, -1):
        record = records[place]
        if isinstance(record, FrameRun):
            for frame in record.frames:
                if frame.can_id == 0x1808D0F4 and frame.data[5] & 0b1000:
                    frame.arrival_ns -= 40 * MS
                    return


def no_cut(records: Records) -> None:
    """The emergency stop is latched, and one frame of it has no PowerCut."""
    place = ticks(records, Mode.FAULT)[-5]
    one = tick(records, place)
    frames = tuple(frame._replace(data=put(b0=0x0C)(frame.data)) for frame in one.frames)
    records[place] = one._replace(frames=frames)


def safety_for_a_tick(records: Records) -> None:
    """PowerMode safety of PCU1 ends at once, though PCU2 has throttle."""
    place = ticks(records, Mode.ACTIVE)[60]
    one = tick(records, place)
    first = one.frames[0]
    safety = first._replace(data=put(b0=0x0C, b1=0)(first.data))
    records[place] = one._replace(frames=(safety, *one.frames[1:]))


def armed_without_restart_state(records: Records) -> None:
    records.insert(1, InputRecord(NoteRestartState("No space"), None))


def first_frames(records: Records) -> int:
    """The first tick that sends, at the end of the listening time."""
    return next(
        place
        for place, record in enumerate(records)
        if isinstance(record, TickRecord) and record.frames
    )


def says_nothing(records: Records) -> None:
    place = first_frames(records)
    records[place] = tick(records, place)._replace(frames=())
    del records[place + 1 : place + 3]


def talks_at_once(records: Records) -> None:
    frames = tick(records, first_frames(records)).frames
    place = ticks(records, Mode.STARTING)[5]
    records[place] = tick(records, place)._replace(frames=frames)


def reset_in_standby(records: Records) -> None:
    place = ticks(records, Mode.STANDBY)[-1]
    reset = Reset(FaultClass.DRIVER, tick(records, place).now_ns)
    records.insert(place, InputRecord(reset, None))


def stopped_before(kind: type) -> Callable[[Records], None]:
    """An emergency stop is asked for right before that request is granted."""

    def mutate(records: Records) -> None:
        place = next(
            place
            for place, record in enumerate(records)
            if isinstance(record, InputRecord) and isinstance(record.input, kind)
        )
        records.insert(place, InputRecord(EmergencyStop(), None))

    return mutate


def with_demands(**changes: Any) -> Callable[[Records], None]:
    """Every demand asks for something else than the gateway was asked."""

    def mutate(records: Records) -> None:
        for place, record in enumerate(records):
            if isinstance(record, InputRecord) and isinstance(record.input, Offer):
                demand = record.input.demand
                both = {name: replace(one, **changes) for name, one in demand.controllers.items()}
                changed = record.input._replace(demand=replace(demand, controllers=both))
                records[place] = record._replace(input=changed)

    return mutate


SEEDED: dict[str, tuple[str, str, Callable[[Records], None]]] = {
    "unused bits": ("ordinary", "gate unused bits", with_data(put(b3=1))),
    "POWER_CUT with torque": ("ordinary", "gate POWER_CUT without torque", with_data(put(b0=0x84))),
    "throttle and brake": ("ordinary", "I11 throttle and brake", with_data(put(b1=90, b2=40))),
    "SpeedLimit too high": ("ordinary", "gate SpeedLimit", with_data(put(b5=0x30))),
    "SpeedLimit too low": ("ordinary", "gate SpeedLimit", with_data(put(b4=0, b5=1))),
    "SpeedLimit falls": ("ordinary", "gate SpeedLimit slew", with_data(put(b5=0x20))),
    "direction at speed": ("ordinary", "I12 direction", with_data(put(b0=0x14))),
    "torque in standby": (
        "ordinary",
        "I2 zero torque outside ACTIVE",
        with_data(put(b0=4, b1=5), 10, Mode.STANDBY),
    ),
    "throttle rises": ("ordinary", "I3 throttle slew", with_data(put(b1=200), 3)),
    "more than demanded": ("ordinary", "I1 throttle as demanded", with_data(put(b1=110), 60)),
    "SpeedLimit more than demanded": (
        "limits",
        "gate SpeedLimit",
        with_data(put(b4=0xE0, b5=0x2E), 300),
    ),
    "PowerMode more than demanded": (
        "ordinary",
        "PowerMode as demanded",
        with_demands(power_mode=PowerMode.ECO),
    ),
    "POWER_CUT without a cause": (
        "ordinary",
        "POWER_CUT in ACTIVE",
        with_data(put(b0=0x8C, b1=0, b6=0, b7=0)),
    ),
    "silent after listening": ("ordinary", "I13 both frames in every tick", says_nothing),
    "talks before listening": ("ordinary", "listening before talking", talks_at_once),
    "brake not demanded": ("ordinary", "I1 brake as demanded", with_data(put(b2=10), 60)),
    "safety mode": ("ordinary", "gate throttle in PowerMode safety", with_data(put(b0=0x0C), 60)),
    "power mode": ("ordinary", "gate PowerMode rise", with_data(put(b0=0x08), 60)),
    "from safety": ("ordinary", "gate PowerMode rise", safety_for_a_tick),
    "nobody regenerates": ("ordinary", "I10 regeneration", with_data(put(b0=0x24), 60)),
    "power above the limit": ("limits", "I1 PowerLimit", with_data(put(b6=0x60, b7=0xEA), 110)),
    "not eco": ("limits", "POWER_LIMIT", with_data(put(b0=0x04), 110)),
    "brake above the limit": ("limits", "I1 Brake", with_data(put(b2=140), 150)),
    "another identifier": ("ordinary", "gate identifier and length", other_identifier),
    "two directions": ("ordinary", "gate directions", opposite_directions),
    "one frame": ("ordinary", "I13 both frames in every tick", one_frame),
    "too early": ("ordinary", "I4 half a period apart", too_early),
    "restart state": ("ordinary", "arming", armed_without_restart_state),
    "arm with throttle": ("ordinary", "arming", with_demands(throttle_pct=5.0)),
    "arm with another direction": ("ordinary", "arming", with_demands(motor_reverse=True)),
    "arm after an emergency stop": ("ordinary", "arming", stopped_before(Arm)),
    "reset after an emergency stop": ("stops", "reset", stopped_before(Reset)),
    "reset with throttle": ("stops", "reset", with_demands(throttle_pct=5.0)),
    "reset in STANDBY": ("ordinary", "reset", reset_in_standby),
    "no arm": ("ordinary", "I2 ACTIVE by arm alone", without(Arm)),
    "no reset": ("stops", "I6 modes", without(Reset)),
    "a fault that ends by itself": ("stops", "I6 modes", with_mode(10, Mode.STANDBY, Mode.FAULT)),
    "drives on": ("stops", "a STOP or CUT leaves no torque", still_driving),
    "stays active": ("stops", "a STOP or CUT ends ACTIVE", still_driving),
    "does not latch": ("stops", "a STOP in ACTIVE latches FAULT", still_driving),
    "cut without fault": (
        "every",
        "a CUT latches FAULT",
        with_mode(0, Mode.STANDBY, Mode.FAULT),
    ),
    "no PowerCut": ("stops", "I6 POWER_CUT while a CUT stands", no_cut),
    "late": ("stops", "reaction time", late_reaction),
}


@pytest.mark.parametrize("name", ["ordinary", "every", "limits", "stops"])
def test_the_verdict_has_nothing_against_what_the_gateway_did(records, name):
    verdict = judged(records[name])
    assert verdict.holds, verdict.violations
    assert verdict.ticks > 200
    assert verdict.with_torque > 100


@pytest.mark.parametrize("what", SEEDED)
def test_the_verdict_sees_what_is_broken(recorded, records, tmp_path, what):
    name, rule, mutate = SEEDED[what]
    mutated = list(open_drive(recorded[name]).runs()) if name != "stops" else [*records[name]]
    if what == "late":
        mutated = list(open_drive(stops(tmp_path / "drive")).runs())
    mutate(mutated)
    verdict = judged(mutated)
    assert rule in verdict.violations_by_rule, verdict.violations_by_rule
    kept = next(one for one in verdict.violations if one.rule == rule)
    assert kept.sentence
    assert kept.tick > 0


def judged_from(records: Records, settings: Settings, first: int) -> DriveVerdict:
    """From this tick on, as where a recording begins in the middle."""
    judge = JudgedRecords(settings, DEFAULT_ALIASES)
    judge.begin(settings, first)
    place = [at for at, one in enumerate(records) if isinstance(one, TickRecord)][first]
    for record in records[place:]:
        judge.note(record)
    return judge.verdict()


def test_regeneration_where_a_recording_begins_in_the_middle_is_no_violation(records):
    every = [one for one in records["ordinary"] if isinstance(one, TickRecord)]
    first = [place for place, one in enumerate(every) if one.frames and one.frames[0].data[0] & 32]
    verdict = judged_from(records["ordinary"], Settings(), first[1])
    assert verdict.holds, verdict.violations


def test_an_expired_demand_ends_the_drive(records):
    mutated = [
        record
        for number, record in enumerate(records["ordinary"])
        if not (isinstance(record, InputRecord) and isinstance(record.input, Offer))
        or number < ticks(records["ordinary"])[60]
    ]
    assert "an expired demand ends ACTIVE" in judged(mutated).violations_by_rule


@pytest.mark.parametrize("armed", [False, True])
def test_a_drive_that_a_request_ended_or_began_is_one_that_a_stop_or_a_late_tick_ends(armed):
    calm = TickCauses(stop="", cut="", foreign=False, late=False, demand_fresh=True)
    findings = Findings()
    rules = ModeRules(findings)
    if armed:
        rules.tick(0, 0, "standby", calm)
        rules.armed(0, 0, "")
        rules.tick(1, 50 * MS, "standby", calm._replace(stop="BMS_Status stale"))
        assert list(findings.counts) == ["a STOP in ACTIVE latches FAULT"]
    else:
        rules.armed(0, 0, "")
        rules.tick(0, 0, "active", calm)
        rules.left_active()
        rules.tick(1, 300 * MS, "standby", calm._replace(late=True))
        assert list(findings.counts) == ["a late tick latches FAULT"]


def test_a_static_demand_of_a_bench_reads_as_released_until_it_drives():
    one = JudgedDemand(5.0, 0.0, 1, False, False, 12_000.0, 60_000.0)
    demands = GrantedDemands({"PCU1": one, "PCU2": one}, known=True)
    assert demands.released_for_ns(1_000 * MS) == 1_000 * MS
    assert not demands.asks_throttle(1_000 * MS)


@pytest.mark.parametrize(("ahead_ns", "stale"), [(20 * MS, False), (20 * MS + 1, True)])
def test_a_frame_from_the_future_is_as_good_as_none(ahead_ns, stale):
    arrivals = Arrivals(limits_of(Settings(), {}), complete=True)
    arrivals.receive([Frame(0x1808D0F4, bytes(8), ahead_ns)])
    assert arrivals.stale("BMS_Status", 0) is stale


def test_reaction_times_are_told_with_their_bound(records):
    verdict = judged(records["stops"])
    by_cause = {one.cause: one for one in verdict.reactions}
    stop = by_cause["BMS_Status.CellUndervoltage 2"]
    assert (stop.effect, stop.times) == ("STOP", 1)
    assert 0 < stop.longest_ms <= stop.bound_ms == 52.0
    stop = by_cause["emergency stop"]
    assert stop.effect == "CUT"
    assert stop.bound_ms == 102.0, "a recording says in which period it came, and no more"


def test_frames_that_the_bus_did_not_take_are_not_what_the_next_ones_follow(records):
    """Slews count from what was sent: with every second frame lost the same rise is too steep."""
    mutated: Records = []
    for number, record in enumerate(records["ordinary"]):
        sent = isinstance(record, InputRecord) and isinstance(record.input, NoteSent)
        lost = sent and number % 2 == 0
        mutated.append(record._replace(input=record.input._replace(ok=False)) if lost else record)
    assert "I3 throttle slew" in judged(mutated).violations_by_rule


def test_a_drive_that_breaks_a_rule_is_exit_1_with_the_rule(recorded, monkeypatch):
    """The replay is equal, and what it is equal to is wrong."""

    def stricter(*given):
        return replace(limits_of(*given), throttle_slew_pct_per_s=50.0)

    monkeypatch.setattr("vcu_gateway.replay.judged.limits_of", stricter)
    ran = replay(recorded["ordinary"])
    assert ran.code == 1
    assert "equal: 461 of 461 ticks to the byte" in ran.out
    assert "verdict: BROKEN;" in ran.out
    assert "I3 throttle slew" in ran.out


def test_the_emergency_stop_is_an_input_that_the_verdict_needs(records):
    mutated = [*records["stops"]]
    without(EmergencyStop)(mutated)
    assert judged(mutated).reactions != judged(records["stops"]).reactions


def test_an_arm_after_a_disarm_between_the_same_two_ticks_is_right(tmp_path):
    drive = SimulatedDrive(tmp_path / "drive").begin()
    drive.throttle(0.0)
    drive.run(1.0)
    assert drive.gateway.apply(calls.Disarm(drive.now_ns)).granted
    assert drive.arm()
    drive.run(0.5)
    records = list(open_drive(drive.end()).runs())
    assert judged(records).violations_by_rule == {}
    place = ticks(records)[-2]
    arm = InputRecord(Arm(tick(records, place).now_ns), None)
    found = judged([*records[: place + 1], arm, *records[place + 1 :]])
    assert found.violations_by_rule == {"arming": 1}
