"""The verdict on drives with pedals on CAN: its own reading of every frame of them."""

from collections.abc import Callable

import pytest

from tests.core.pedal_node import MS
from tests.replay.test_pedals import CONFIG, EXAMPLES, PedalDrive
from vcu_gateway.config import core_settings, parse
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import REQUIRED_MESSAGES, Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.judge.result import DriveVerdict
from vcu_gateway.protocol import dbc
from vcu_gateway.recording.core_lines import FrameRun, TickRecord
from vcu_gateway.recording.reader import open_drive
from vcu_gateway.replay.judged import JudgedRecords, limits_of

PEDALS_ID = 0x0810D021
SETTINGS = core_settings(parse(CONFIG, "f"))
PROTOCOL = dbc.load(EXAMPLES / "pedals.dbc")
CRUISE, DOUBTED, LATCHED, COAST = 100, 120, 140, 170


@pytest.fixture(scope="module")
def records(tmp_path_factory) -> list:
    """Ticks 90 to 110 at 60 %, then a broken wire, a latch and a released pedal."""
    drive = PedalDrive(tmp_path_factory.mktemp("judged") / "drive")
    drive.begin()
    ticks = drive.gateway.tap.ticks
    drive.press(60).run((110 - ticks) / 20)
    drive.press(60, Throttle2=0).run(1.0)
    drive.press(60).run(1.0)
    drive.press(0).run(2.0)
    assert drive.gateway.mode is Mode.ACTIVE
    return list(open_drive(drive.end()).runs())


def verdict(records: list, settings: Settings = SETTINGS) -> DriveVerdict:
    judge = JudgedRecords(settings, {}, PROTOCOL)
    for record in records:
        judge.note(record)
    return judge.verdict()


def with_command(records: list, number: int, change: Callable[[bytearray], None]) -> list:
    """The records with one tick's commands changed."""
    changed, ticks = list(records), 0
    for place, record in enumerate(records):
        if isinstance(record, TickRecord):
            if ticks == number:
                frames = []
                for frame in record.frames:
                    data = bytearray(frame.data)
                    change(data)
                    frames.append(frame._replace(data=bytes(data)))
                changed[place] = record._replace(frames=tuple(frames))
            ticks += 1
    return changed


def without(records: list, dropped: Callable[[Frame], bool]) -> list:
    """The records without some frames."""
    return [
        FrameRun([one for one in record.frames if not dropped(one)])
        if isinstance(record, FrameRun)
        else record
        for record in records
    ]


def rules(found: DriveVerdict) -> set[str]:
    return {one.rule for one in found.violations}


def test_a_drive_with_pedals_holds(records):
    found = verdict(records)
    assert found.violations == ()
    assert found.with_torque > 30


def test_a_required_message_that_the_judge_has_no_table_of_is_judged_by_its_period(tmp_path):
    """Pedals_Position comes every 20 ms: it is missing after ten of them."""
    required = [*REQUIRED_MESSAGES, "Pedals_Position"]
    config = f"{CONFIG}safety: {{required_messages: {required}}}\n"
    settings = core_settings(parse(config, "f"))
    drive = PedalDrive(tmp_path / "drive", config=config)
    drive.begin()
    drive.press(60).run(1.0)
    records = list(open_drive(drive.end()).runs())
    whole = verdict(records, settings)
    assert whole.violations == ()
    assert whole.with_torque > 10
    last_ns = max(one.now_ns for one in records if isinstance(one, TickRecord))

    def stopped(silent_ms: int) -> bool:
        begin_ns = last_ns - silent_ms * MS
        silent = without(records, lambda one: one.can_id == PEDALS_ID and one.arrival_ns > begin_ns)
        return any(
            "Pedals_Position stale" in one.sentence for one in verdict(silent, settings).violations
        )

    assert not stopped(150)
    assert stopped(300)


def test_what_the_configuration_says_of_the_age_of_such_a_message_wins():
    required = [*REQUIRED_MESSAGES, "Pedals_Position"]
    ages = "freshness: {stale_after_ms: {Pedals_Position: 350}}\n"
    settings = core_settings(
        parse(f"{CONFIG}safety: {{required_messages: {required}}}\n{ages}", "f")
    )
    assert limits_of(settings, {}, PROTOCOL).stale_after_ms == {"Pedals_Position": 350}


def add_throttle(data: bytearray) -> None:
    data[1] += 3


def add_brake(data: bytearray) -> None:
    data[2] += 3


@pytest.mark.parametrize("number", [CRUISE, DOUBTED, LATCHED, COAST])
def test_throttle_above_what_the_pedal_says_is_seen(records, number):
    assert "I1 throttle as demanded" in rules(verdict(with_command(records, number, add_throttle)))


def test_brake_above_what_a_released_pedal_coasts_with_is_seen(records):
    found = verdict(with_command(records, COAST, add_brake))
    assert rules(found) == {"I1 brake as demanded"}


def test_active_without_frames_of_the_pedals_is_seen(records):
    ticks = [one.now_ns for one in records if isinstance(one, TickRecord)]
    begin_ns, end_ns = ticks[CRUISE], ticks[CRUISE] + 101_000_000
    silent = without(
        records,
        lambda one: one.can_id == PEDALS_ID and begin_ns < one.arrival_ns < end_ns,
    )
    assert "an expired demand ends ACTIVE" in rules(verdict(silent))


@pytest.mark.parametrize("byte", [1, 3, 6])
def test_frames_with_a_wrong_bit_are_no_demands_of_the_verdict_either(records, byte):
    ticks = [one.now_ns for one in records if isinstance(one, TickRecord)]
    broken = []
    for record in records:
        if isinstance(record, FrameRun):
            frames = []
            for one in record.frames:
                data = bytearray(one.data)
                if one.can_id == PEDALS_ID and 0 < one.arrival_ns - ticks[CRUISE] < 200_000_000:
                    data[byte] ^= 1
                frames.append(Frame(one.can_id, bytes(data), one.arrival_ns, own_echo=one.own_echo))
            broken.append(FrameRun(frames))
        else:
            broken.append(record)
    assert "an expired demand ends ACTIVE" in rules(verdict(broken))
