"""The verdict holds a drive against its curves, drive modes and slip limiter, one thing broken."""

import dataclasses
import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import pytest

from tests.golden.recording import FOLDER
from tests.judge.test_judge import Records, judged, judged_from, tick, ticks
from tests.replay.drives import SimulatedDrive
from vcu_gateway.core import calls
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.tuning import DERATINGS, of_values
from vcu_gateway.judge.arrivals import Arrivals
from vcu_gateway.judge.demands import GrantedDemands
from vcu_gateway.judge.tuning_rules import TuningRules, TuningTick, value_at
from vcu_gateway.judge.wire import INPUTS, RECEIVED_IDS, CommandBytes, command_bytes
from vcu_gateway.protocol import DEFAULT_ALIASES
from vcu_gateway.recording.core_lines import FrameRun, InputRecord
from vcu_gateway.recording.reader import open_drive
from vcu_gateway.replay.judged import limits_of

MOTORS, BATTERY = "curves-of-motors", "curves-of-the-battery"
MODES, SPEED, SLIP = "drive-modes", "modes-over-speed", "slip"
TUNED = (MOTORS, BATTERY, "curves-outside-active", MODES, SPEED, SLIP)
ECO, NORMAL, TURBO = 0x00, 0x04, 0x08
REGEN = 0x20


@cache
def settings_of(name: str) -> Settings:
    return open_drive(FOLDER / name).info.settings


@cache
def _read(name: str) -> Records:
    return list(open_drive(FOLDER / name).runs())


def golden(name: str) -> Records:
    return [*_read(name)]


@pytest.mark.parametrize("name", TUNED)
def test_the_verdict_has_nothing_against_a_drive_with_tuning(name):
    verdict = judged(golden(name))
    assert verdict.holds, verdict.violations
    assert verdict.with_torque > 50


@pytest.mark.parametrize("first", [90, 152, 211])
@pytest.mark.parametrize("name", TUNED)
def test_it_has_nothing_against_one_that_begins_in_the_middle(name, first):
    verdict = judged_from(golden(name), settings_of(name), first)
    assert verdict.holds, verdict.violations


Change = Callable[[bytes], bytes]
Where = Callable[[CommandBytes], bool]


def more(at: int, by: int, width: int = 1) -> Change:
    """A field of the command changed by so many bits."""

    def change(data: bytes) -> bytes:
        field = int.from_bytes(data[at : at + width], "little") + by
        return data[:at] + field.to_bytes(width, "little") + data[at + width :]

    return change


def throttle(by: int) -> Change:
    return more(1, by)


def brake(by: int) -> Change:
    return more(2, by)


def speed_limit(by: int) -> Change:
    return more(4, by, 2)


def power_limit(by: int) -> Change:
    return more(6, by, 2)


def first_byte(value: int) -> Change:
    return lambda data: bytes([data[0] & 0xD3 | value]) + data[1:]


class Forged(NamedTuple):
    """One tick of a golden drive changed; both commands, or one of them.

    Attributes:
        where: true of the command that is changed; `which` of them all.
        seen: rule that is broken, and a part of what the verdict says.
    """

    drive: str
    where: Where
    change: Change
    seen: tuple[str, str]
    which: int = 0
    mode: Mode = Mode.ACTIVE
    alone: bool = False

    def forge(self) -> Records:
        records = golden(self.drive)
        found = [
            place
            for place in ticks(records, self.mode)
            if self.where(command_bytes(tick(records, place).frames[0].data))
        ]
        place = found[self.which]
        first, second = tick(records, place).frames
        changed = first._replace(data=self.change(first.data))
        other = second if self.alone else second._replace(data=self.change(second.data))
        records[place] = tick(records, place)._replace(frames=(changed, other))
        return records


FORGED = {
    "a curve of power": Forged(
        MOTORS, lambda one: one.power_limit_w == 6000, power_limit(2), ("I1 PowerLimit", "6000")
    ),
    "a return of power": Forged(
        MOTORS, lambda one: one.power_limit_w == 2400, power_limit(2), ("I1 PowerLimit", "2400")
    ),
    "a curve of Brake": Forged(
        MOTORS, lambda one: one.brake_raw == 128, brake(2), ("I1 Brake", "at most 50.0"), -1
    ),
    "a cap of power of 0": Forged(
        MOTORS,
        lambda one: one.power_limit_w == 0,
        throttle(1),
        ("no throttle where a cap of power is 0", "throttle 0.4 %"),
        -1,
    ),
    "a cap of Brake of 0": Forged(
        MOTORS,
        lambda one: not one.brake_raw and not one.throttle_raw and not one.regenerates,
        first_byte(REGEN | NORMAL),
        ("I10 regeneration", "where a cap of Brake is 0"),
        -1,
    ),
    "a cap of SpeedLimit": Forged(
        MODES, lambda one: one.speed_limit_rpm == 3838, speed_limit(3), ("I1 SpeedLimit", "3838")
    ),
    "a SpeedLimit that falls to its cap": Forged(
        BATTERY, lambda one: one.speed_limit_rpm < 12_000, speed_limit(-3),
        ("gate SpeedLimit slew", "at least"),
    ),
    "a SpeedLimit that does not fall": Forged(
        BATTERY, lambda one: one.speed_limit_rpm < 12_000, speed_limit(3),
        ("I1 SpeedLimit", "at most"), 1,
    ),
    "a SpeedLimit in STANDBY": Forged(
        MODES, lambda one: one.speed_limit_rpm < 11_000, speed_limit(3),
        ("I1 SpeedLimit", "at most"), mode=Mode.STANDBY,
    ),
    "a pedal map": Forged(
        MODES, lambda one: one.throttle_raw == 205, throttle(1), ("I1 Throttle", "at most 80.0")
    ),
    "a rise over speed": Forged(
        MODES, lambda one: 8 < one.throttle_raw < 30, throttle(3), ("I3 throttle slew", "50.0 ms")
    ),
    "a throttle over speed": Forged(
        SPEED, lambda one: one.throttle_raw > 100, throttle(2), ("I1 Throttle", "at most"), 10
    ),
    "a PowerMode": Forged(
        MODES, lambda one: one.power_mode == 1, first_byte(TURBO),
        ("PowerMode of the drive mode", "2, at most 1"),
    ),
    "a wheel that slips": Forged(
        SLIP, lambda one: 30 < one.throttle_raw < 100, throttle(3), ("I1 Throttle", "at most"), 20
    ),
    "throttles of equal demands": Forged(
        MODES, lambda one: one.throttle_raw > 150, throttle(-55),
        ("gate asymmetry", "at most 20.0 %"), alone=True,
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", FORGED)
def test_the_verdict_sees_a_command_above_its_cap(what):
    forged = FORGED[what]
    verdict = judged(forged.forge())
    said = [(one.rule, one.sentence) for one in verdict.violations]
    rule, part = forged.seen
    assert any(each == rule and part in sentence for each, sentence in said), said


class Worse(NamedTuple):
    """A field of a message that was worse from the middle of a golden drive on."""

    drive: str
    message: str
    at: int
    value: int
    seen: str
    width: int = 1

    def put(self, data: bytes | bytearray) -> bytes:
        field = self.value.to_bytes(self.width, "little")
        return bytes(data[: self.at]) + field + bytes(data[self.at + self.width :])


IDS = {name: can_id for can_id, name in RECEIVED_IDS.items()}
POWER, BRAKE, SPEEDS = "I1 PowerLimit", "I1 Brake", "I1 SpeedLimit"
WORSE = {
    "motor temperature": Worse(MOTORS, "PCU2_Status1", 7, 130, POWER),
    "controller temperature": Worse(MOTORS, "PCU1_Status1", 6, 100, POWER),
    "controller temperature, braking": Worse(MOTORS, "PCU1_Status1", 6, 100, BRAKE),
    "a controller temperature that is none": Worse(MOTORS, "PCU1_Status1", 6, 151, POWER),
    "highest pack temperature": Worse(BATTERY, "BMS_Temperatures", 3, 115, POWER),
    "highest pack temperature, braking": Worse(BATTERY, "BMS_Temperatures", 3, 115, BRAKE),
    "lowest pack temperature": Worse(BATTERY, "BMS_Temperatures", 4, 30, POWER),
    "lowest pack temperature, braking": Worse(BATTERY, "BMS_Temperatures", 4, 30, BRAKE),
    "a pack temperature that is none": Worse(MOTORS, "BMS_Temperatures", 0, 251, POWER),
    "charge": Worse(MOTORS, "BMS_Status", 4, 2, POWER),
    "charge, braking": Worse(MOTORS, "BMS_Status", 4, 99, BRAKE),
    "charge, speed": Worse(MOTORS, "BMS_Status", 4, 2, SPEEDS),
    "battery voltage": Worse(MOTORS, "PCU2_Status2", 0, 40 * 128, POWER, 2),
    "motor speed": Worse(MOTORS, "PCU1_Status2", 6, 100, BRAKE, 2),
    "front wheels": Worse(SPEED, "ARD2_SteeringWheel", 2, 0, "I1 Throttle", 4),
    "a motor that spins": Worse(SLIP, "PCU1_Status2", 6, 6000, "I1 Throttle", 2),
}


@pytest.mark.parametrize("what", WORSE)
def test_the_verdict_reads_what_limits_from_the_bus(what):
    one = WORSE[what]
    can_id = IDS[one.message]
    records = golden(one.drive)
    for place, record in enumerate(records):
        if isinstance(record, FrameRun) and place > len(records) // 2:
            frames = [
                dataclasses.replace(frame, data=one.put(frame.data))
                if frame.can_id == can_id
                else frame
                for frame in record.frames
            ]
            records[place] = FrameRun(frames)
    assert one.seen in judged(records).violations_by_rule


def requests(records: Records) -> list[int]:
    return [
        place
        for place, one in enumerate(records)
        if isinstance(one, InputRecord) and isinstance(one.input, calls.SetDriveMode)
    ]


def test_a_drive_mode_is_in_force_from_its_request_and_the_pedals_release():
    """Without the request for the milder one the throttle of the other one is too much."""
    records = golden(MODES)
    sport = requests(records)[0]
    del records[sport]
    assert "I1 Throttle" in judged(records).violations_by_rule


def test_a_request_alone_does_not_bring_its_pedal_map():
    """Full pedal in eco, sport asked for: what sport's map allows is not sent yet."""
    records = golden(MODES)
    after = [place for place in ticks(records) if place > requests(records)[0]][2]
    one = tick(records, after)
    frames = tuple(each._replace(data=throttle(10)(each.data)) for each in one.frames)
    records[after] = one._replace(frames=frames)
    assert "I1 Throttle" in judged(records).violations_by_rule


def test_a_kept_drive_mode_is_the_one_of_the_start():
    records = [
        one
        for one in golden(SPEED)
        if not (isinstance(one, InputRecord) and isinstance(one.input, calls.BeginInMode))
    ]
    assert not judged(records).holds


def test_a_mode_that_only_service_leaves_is_not_left_by_the_driver():
    records = golden(MODES)
    for place in requests(records):
        record = records[place]
        assert isinstance(record, InputRecord)
        assert isinstance(record.input, calls.SetDriveMode)
        if record.input.level is FaultClass.SERVICE:
            asked = record.input._replace(level=FaultClass.DRIVER)
            records[place] = record._replace(input=asked)
    (seen,) = judged(records).violations
    assert (seen.rule, seen.sentence) == ("drive mode", "valet was left below service level")


def test_no_arm_is_granted_before_speed_limit_is_at_its_cap():
    records = golden(MODES)
    place = ticks(records, Mode.STANDBY)[20]
    records.insert(place + 3, InputRecord(calls.Arm(tick(records, place).now_ns), None))
    verdict = judged(records)
    assert verdict.violations_by_rule["arming"] == 1
    assert any("has not come down to 3838 rpm" in one.sentence for one in verdict.violations)


KEY = "curves.power_limit_w.by_motor_temperature_c"


@pytest.fixture(scope="module")
def reloaded(tmp_path_factory) -> Records:
    """A drive in which a reload brings a curve over the motors' temperature, in ACTIVE."""
    drive = SimulatedDrive(tmp_path_factory.mktemp("reloaded") / "drive").begin()
    drive.throttle(50.0)
    drive.run(1.0)
    given = {KEY: [[0, 20_000], [200, 10_000]]}
    settings = drive.gateway.settings
    changed = calls.ReloadSettings(_with_tuning(settings, given))
    assert drive.gateway.apply(changed).granted
    drive.run(2.0)
    return list(open_drive(drive.end()).runs())


def _with_tuning(settings: Settings, given: dict) -> Settings:
    return Settings(
        **{name: getattr(settings, name) for name in Settings.__dataclass_fields__}
        | {"tuning": of_values(given)}
    )


def test_a_reload_counts_from_its_place_on(reloaded):
    assert judged(reloaded).holds, judged(reloaded).violations


def test_a_command_above_a_reloaded_curve_is_seen(reloaded):
    records = [*reloaded]
    for place, one in enumerate(records):
        if isinstance(one, InputRecord) and isinstance(one.input, calls.ReloadSettings):
            lower = _with_tuning(one.input.settings, {KEY: [[0, 19_000], [200, 9_000]]})
            records[place] = one._replace(input=calls.ReloadSettings(lower))
    assert set(judged(records).violations_by_rule) == {"I1 PowerLimit"}


def test_the_judge_knows_every_curve_that_may_be_configured():
    known = {name for one in DERATINGS.values() for name, _ in one.input.messages}
    assert {one.input.quantity.key for one in DERATINGS.values()} == set(INPUTS)
    assert known == {name for one in INPUTS.values() for name in one.messages}


@pytest.mark.parametrize(
    ("x", "y"), [(-1, 3), (0, 3), (5, 4), (10, 5), (12.5, 30), (15, 55), (16, 55)]
)
def test_a_curve_is_linear_between_its_points_and_level_beyond(x, y):
    assert value_at([[0, 3], [10, 5], [15, 55]], x) == y


@pytest.mark.parametrize(("complete", "rise_pct_per_s"), [(True, 75.0), (False, 100.0)])
def test_without_a_wheel_speed_a_rise_falls_from_the_highest_y_unless_one_may_have_come_before(
    complete, rise_pct_per_s
):
    limits = limits_of(settings_of(SPEED), DEFAULT_ALIASES)
    rules = TuningRules(limits, complete=complete)
    assert rules.ask("eco", limits, service=False) == ""
    arrivals = Arrivals(limits, complete=complete)
    demands = GrantedDemands(None, known=complete)
    caps = rules.tick(TuningTick(limits, arrivals, demands, {}, 10**12, 0.05, began_active=False))
    assert caps.rise_pct_per_s == rise_pct_per_s


@pytest.mark.parametrize("complete", [True, False])
def test_an_input_that_never_came_derates_unless_it_may_have_come_before(complete):
    limits = limits_of(settings_of(MOTORS), DEFAULT_ALIASES)
    rules, arrivals = TuningRules(limits, complete=complete), Arrivals(limits, complete=complete)
    demands = GrantedDemands(None, known=complete)
    caps = rules.tick(TuningTick(limits, arrivals, demands, {}, 10**12, 0.05, began_active=False))
    assert caps.power_w == (limits.derated_power_w if complete else math.inf)
