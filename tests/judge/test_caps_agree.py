"""The verdict's caps are those of the core, tick by tick, in a random drive with all of tuning.

Two readings of docs/safety.md, Tuning, that share no code: what the verdict alone would let
through, or would hold against a drive that is right, is a difference here.
"""

import math
import random
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.judge.test_judge import Records, tick
from tests.replay.drives import MS, SimulatedDrive
from vcu_gateway import config as configuration
from vcu_gateway.core import calls
from vcu_gateway.core.caps import Caps
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand, PowerMode
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.judge.tuning_rules import TuningCaps
from vcu_gateway.judge.wire import PERCENT_PER_BIT, POWER_MODES, RECEIVED_IDS
from vcu_gateway.protocol import DEFAULT_ALIASES
from vcu_gateway.recording.core_lines import TickRecord
from vcu_gateway.recording.reader import open_drive
from vcu_gateway.replay.judged import JudgedRecords

# As those of the golden drives, but along all that a random drive has.
CURVES = """
curves:
  power_limit_w:
    by_motor_temperature_c: [[95, 14000], [110, 6000], [125, 0]]
    by_controller_temperature_c: [[75, 14000], [95, 2000]]
    by_pack_temperature_max_c: [[45, 14000], [55, 4000], [60, 0]]
    by_pack_temperature_min_c: [[-10, 3000], [5, 14000]]
    by_soc_pct: [[3, 1500], [10, 5000], [25, 14000]]
    by_battery_voltage_v: [[40, 1000], [46, 14000]]
  brake_pct:
    by_soc_pct: [[90, 100], [98, 0]]
    by_pack_temperature_max_c: [[45, 100], [60, 0]]
    by_controller_temperature_c: [[75, 100], [95, 10]]
    by_motor_speed_rpm: [[150, 20], [600, 100]]
  speed_limit_rpm:
    by_soc_pct: [[5, 500], [15, 12000]]
"""
MODES = """
drive_modes:
  start: eco
  modes:
    eco:
      throttle_pct: {by_pedal_pct: [[0, 0], [40, 20], [80, 55], [100, 80]]}
      throttle_rise_pct_per_s: {by_speed_kmh: [[0, 30], [65, 80]]}
      power_mode_max: normal
      power_limit_w: 8000
      speed_limit_kmh: 45
    sport: {}
    rain:
      throttle_pct:
        by_pedal_pct: [[0, 0], [50, 20], [100, 60]]
        by_speed_kmh: [[0, 30], [65, 100]]
      brake_max_pct: 30
    valet: {power_mode_max: eco, speed_limit_kmh: 30}
"""
VEHICLE = """
vehicle: {motor_rpm_per_kmh: 50}
limits:
  power_limit_max_w: 14000
  derated_power_w: 4000
  brake_return_pct_per_s: 70
  speed_fall_rpm_per_s: 4000
"""
SLIP = "laws: {slip: {wait_ms: 150, return_pct_per_s: 50, allowed_pct: 25, allowed_kmh: 5}}\n"
OTHER_MODES = MODES.replace("rain:", "snow:").replace("speed_limit_kmh: 45", "speed_limit_kmh: 44")
STRICTER = CURVES.replace("[110, 6000]", "[110, 5000]")
# A reload takes neither the first drive modes nor the last: drive_modes.start needs a restart.
FAMILIES = (
    (CURVES + MODES + SLIP, CURVES + OTHER_MODES, STRICTER + MODES + SLIP, MODES + SLIP, MODES),
    (CURVES + SLIP, STRICTER + SLIP, CURVES, SLIP, ""),
    (SLIP, SLIP.replace("wait_ms: 150", "wait_ms: 200")),
)
NAMES = ("eco", "sport", "rain", "valet", "snow")
IDS = {name: can_id for can_id, name in RECEIVED_IDS.items()}
WHEELS = "ARD2_SteeringWheel"
SILENT = ("BMS_Temperatures", WHEELS)
THROTTLES_PCT = (0.0, 0.0, 4.9, 5.5, 20.0, 60.0, 100.0, 100.0)
TICKS = 1500


def settings_of(tuning: str) -> Settings:
    return configuration.core_settings(configuration.parse(VEHICLE + tuning, "config.yaml"))


class Bytes(NamedTuple):
    """A field of a message that wanders, as little-endian codes; odd: no value, or saturated."""

    message: str
    at: int
    width: int
    codes: range
    step: int
    odd: int | None = None


FIELDS = (
    *(Bytes(f"{name}_Status1", 6, 1, range(60, 100), 6, 151) for name in CONTROLLERS),
    *(Bytes(f"{name}_Status1", 7, 1, range(80, 128), 6) for name in CONTROLLERS),
    *(Bytes(f"{name}_Status2", 0, 2, range(5_000, 7_700), 256, 65_535) for name in CONTROLLERS),
    *(Bytes(f"{name}_Status2", 6, 2, range(5999), 400, 6001) for name in CONTROLLERS),
    *(Bytes("BMS_Temperatures", at, 1, range(35, 112), 8, 251) for at in range(5)),
    Bytes("BMS_Status", 4, 1, range(101), 20, 101),
    *(Bytes("ARD2_SteeringWheel", at, 2, range(65_536), 16_000, 65_535) for at in (2, 4)),
)
MESSAGES = sorted({one.message for one in FIELDS} - {"BMS_Status"})  # which has a life signal
OF_CONTROLLERS = {one for one in MESSAGES if one.startswith("PCU")}


class World:
    """A vehicle whose values wander, and whose messages come twice, late or not."""

    def __init__(self, drive: SimulatedDrive, chance: random.Random) -> None:
        self.drive, self.chance = drive, chance
        self.values = {one: one.codes[0] + 2 * one.step for one in FIELDS}
        self.silent = set(SILENT)
        drive.change = self.said

    def said(self, message: str, data: bytes) -> bytes:
        if self.chance.random() < 0.02:
            self.wander()  # also between two frames of a tick
        for one, value in self.values.items():
            if one.message == message:
                field = value.to_bytes(one.width, "little")
                data = data[: one.at] + field + data[one.at + one.width :]
        return data

    def go_on(self) -> None:
        self.wander()
        if self.chance.random() < 0.01:
            self.silent = set() if self.silent else {self.chance.choice(SILENT)}
        lost = {self.chance.choice(MESSAGES)} if self.chance.random() < 0.05 else set()
        self.drive.silent = self.silent | lost
        if self.chance.random() < 0.4:
            self.speak_twice()

    def wander(self) -> None:
        """Each field a step, a leap, or to what is no value."""
        for one in FIELDS:
            chance = self.chance.random()
            if chance < 0.1:
                moved = self.values[one] + self.chance.randint(-4, 4) * one.step // 4
                self.values[one] = min(max(moved, one.codes[0]), one.codes[-1])
            elif chance < 0.103 and one.odd is not None:
                self.values[one] = one.odd
            elif chance < 0.105:
                self.values[one] = self.chance.choice(one.codes[:: max(1, one.step // 4)])

    def speak_twice(self) -> None:
        """Another frame before the next tick, older or newer than those that come by themselves."""
        message = self.chance.choice(MESSAGES)
        self.wander()
        at_ns = self.drive.now_ns + self.chance.randint(-60, 40) * MS
        data = self.said(message, bytes(8))
        self.drive.gateway.receive(Frame(IDS[message], data, at_ns))


class Driver:
    """Somebody who presses and lets go, now and then each pedal for one controller alone."""

    def __init__(self, drive: SimulatedDrive, chance: random.Random) -> None:
        self.drive, self.chance = drive, chance
        self.drive.demanded = None
        self.throttles_pct = [0.0, 0.0]
        self.sequence = 0

    def ask(self) -> None:
        gateway, chance = self.drive.gateway, self.chance
        if gateway.mode is not Mode.ACTIVE:
            self.throttles_pct = [0.0, 0.0]
            gateway.apply(calls.Reset(FaultClass.SERVICE, self.drive.now_ns))
            self.drive.arm()
        elif chance.random() < 0.05:
            self.throttles_pct = [chance.choice(THROTTLES_PCT)] * 2
            if chance.random() < 0.3:
                self.throttles_pct[1] = chance.choice(THROTTLES_PCT)
        self.sequence += 1
        each = [
            ControllerDemand(throttle_pct=one, power_mode=PowerMode.TURBO)
            for one in self.throttles_pct
        ]
        demanded = dict(zip(CONTROLLERS, each, strict=True))
        demand = Demand("driver", self.sequence, 200, demanded)
        if chance.random() < 0.9:
            gateway.apply(calls.Offer(demand, self.drive.now_ns))
        if chance.random() < 0.01:
            gateway.apply(calls.Disarm(self.drive.now_ns))
        if chance.random() < 0.03:
            name = chance.choice(NAMES)
            gateway.apply(calls.SetDriveMode(name, FaultClass.SERVICE, self.drive.now_ns))


def driven(drive: SimulatedDrive, files: Sequence[str], chance: random.Random) -> Iterator[None]:
    """Anything that a driver and a vehicle may do; each step is a tick."""
    gateway, world, driver = drive.gateway, World(drive, chance), Driver(drive, chance)
    for number in range(TICKS):
        driver.ask()
        if number % 125 == 124:
            if number % 250 == 249:
                gateway.apply(calls.Disarm(drive.now_ns))
                drive.tick()
                yield
            gateway.apply(calls.ReloadSettings(settings_of(chance.choice(files))))
        elif number % 25 == 24:
            gateway.apply(calls.ReloadSettings(gateway.settings))
        world.go_on()
        drive.tick(chance.choice((50, 50, 50, 50, 60)) * MS)
        yield


class CoreTick(NamedTuple):
    """What the core had at the end of a tick.

    Attributes:
        slips: the slip limiter leaves less than all.
        waits: a drive mode waits for the pedal's release.
        silent: messages of which nothing, or one frame less, came.
    """

    caps: Mapping[str, Caps]
    settings: Settings
    slips: bool
    waits: bool
    silent: Set[str]


class Both(NamedTuple):
    """A tick in both readings, and the mode in which it ended."""

    mode: Mode
    core: CoreTick
    judge: TuningCaps


Recorded = tuple[Records, dict[int, CoreTick]]


def recording(folder: Path, files: Sequence[str], seed: int) -> Recorded:
    drive = SimulatedDrive(folder, VEHICLE + files[0])
    gateway, core = drive.gateway, {}
    gateway.apply(calls.BeginInMode("a mode of an older file"))
    drive.open_link()
    for _ in driven(drive, files, random.Random(seed)):
        current, asked = gateway.drive_modes
        core[drive.now_ns] = CoreTick(
            dict(gateway._commander.caps),
            gateway.settings,
            min(gateway.slip_caps_pct.values()) < 100,
            current != asked,
            drive.silent,
        )
    return list(open_drive(drive.end()).runs()), core


def both(recorded: Recorded, first: int = 0, ticks: int = TICKS) -> list[Both]:
    """So many ticks from this one on, as where a recording begins in the middle."""
    records, core = recorded
    places = [at for at, one in enumerate(records) if isinstance(one, TickRecord)]
    settings = core[tick(records, places[first]).now_ns].settings
    judged = JudgedRecords(settings, DEFAULT_ALIASES)
    judge = judged.begin(settings, first)
    found: list[Both] = []
    before: TickRecord | None = None
    end = places[first + ticks] if first + ticks < len(places) else None
    for record in records[places[first] if first else 0 : end]:
        judged.note(record)
        if isinstance(record, TickRecord):  # which ends the one before
            if before is not None:
                found.append(Both(before.mode, core[before.now_ns], judge.caps))
            before = record
    return found


def differences(one: Both) -> Iterator[tuple[str, float, float]]:
    """Each cap that both do not have alike while it counts: its name, the core's, the judge's."""
    core, judge = one.core.settings, one.judge
    if one.mode not in (Mode.STANDBY, Mode.ACTIVE):
        return
    for name, caps in one.core.caps.items():
        pairs = {
            "power_w": (caps.power_w, judge.power_w),
            "brake_pct": (caps.brake_pct, min(judge.brake_pct, 100.0)),
            "speed_rpm": (max(caps.speed_rpm, 500), judge.speed_rpm),
        }
        if one.mode is Mode.ACTIVE:
            rise = min(caps.throttle_rise_pct_per_s, core.throttle_slew_pct_per_s)
            pairs |= {
                "rise": (rise, judge.rise_pct_per_s),
                "power_mode": (POWER_MODES.index(caps.power_mode.name.lower()), judge.power_mode),
                f"throttle of {name}": (caps.throttle_pct, judge.throttle_pct[name]),
            }
        for field, (own, others) in pairs.items():
            if not math.isclose(own, others, abs_tol=1e-6):
                yield field, own, others


CI = pytest.mark.ci
UNSURE_SHARE_MAX = 0.1
HALF_A_BIT_PCT = PERCENT_PER_BIT / 2
DRIVES = [
    pytest.param((family, seed), marks=[CI] * seed)
    for family in range(len(FAMILIES))
    for seed in range(2)
]


@pytest.fixture(scope="module", params=DRIVES, ids=str)
def random_drive(request, tmp_path_factory) -> Recorded:
    family, seed = request.param
    return recording(tmp_path_factory.mktemp("random") / "drive", FAMILIES[family], seed)


def test_both_have_the_same_caps_in_every_tick(random_drive):
    """But for the throttle sent last, which the verdict has as a code, and a wheel at its limit."""
    ticks = both(random_drive)
    driving = [one for one in ticks if one.mode is Mode.ACTIVE]
    assert len(driving) > TICKS / 3
    unsure = 0
    for number, one in enumerate(ticks):
        for cap, core, judge in differences(one):
            assert judge > core, (number, cap, core, judge)
            assert cap.startswith("throttle of"), (number, cap, core, judge)
            unsure += judge - core > HALF_A_BIT_PCT
    assert unsure < len(driving) * UNSURE_SHARE_MAX


BEGINS: Mapping[str, Callable[[CoreTick, CoreTick], bool]] = {
    "anywhere": lambda before, now: True,
    "after a cut of the slip limiter": lambda before, now: now.slips,
    "where a drive mode begins to wait": lambda before, now: now.waits and not before.waits,
    "without a controller's frame": lambda before, now: bool(now.silent & OF_CONTROLLERS),
    "without the wheels": lambda before, now: WHEELS in now.silent,
}


@CI
@pytest.mark.parametrize("begin", BEGINS)
def test_from_the_middle_on_the_verdict_allows_more_until_it_has_seen_enough(random_drive, begin):
    core = list(random_drive[1].values())
    places = [at for at, ticks in enumerate(pairwise(core)) if BEGINS[begin](*ticks)]
    assert len(places) > 1 or not core[0].settings.tuning.modes, "there is no such beginning"
    for first in places[1 :: max(1, len(places) // 40)]:
        for number, one in enumerate(both(random_drive, first, 30)):
            for cap, core_cap, judge_cap in differences(one):
                assert judge_cap > core_cap, (first, number, cap, core_cap, judge_cap)


@CI
def test_begun_in_the_middle_both_have_the_same_caps_in_the_end(random_drive):
    for one in both(random_drive, 300)[800:]:
        assert all(cap.startswith("throttle of") for cap, _, _ in differences(one))
