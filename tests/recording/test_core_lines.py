"""Core lines: every call of a tapped gateway, written and read again."""

import contextlib
import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.core.simulated_drive import MS, ZERO_TORQUE
from tests.core.test_invariants import ASKED, SETTINGS
from tests.core.test_tuning import WHOLE as TUNING
from tests.recording.tapped import TappedDrive, lines_of, parsed
from vcu_gateway.core import calls
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.demand import (
    CONTROLLERS,
    GRANTED,
    ControllerDemand,
    Demand,
    PowerMode,
    Refusal,
)
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.recording.call_text import settings_json, settings_of
from vcu_gateway.recording.core_lines import (
    Gap,
    InputRecord,
    LineParser,
    LineWriter,
    NotedCall,
    Placed,
    ShellEvent,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.recording.datagram import CoreLineError

NOW = 1_000_950_000_000
BOTH = dict.fromkeys(CONTROLLERS, ControllerDemand(throttle_pct=12.5))
APART = {"PCU1": ControllerDemand(), "PCU2": ControllerDemand(throttle_track2_pct=3)}
EVERYTHING = dict.fromkeys(
    CONTROLLERS,
    ControllerDemand(90.5, 3.25, PowerMode.TURBO, True, True, 8000.0, 30_000.0, 91.0),
)
DEMAND = Demand("driver", 7, 200, BOTH)
ALMOST_UP = LinkStatus(LinkState.WARNING, 5)

CALLS = [
    calls.LoseLink(NOW),
    calls.OpenLink(ALMOST_UP, None, NOW),
    calls.OpenLink(ALMOST_UP, Carrier(True, 6), NOW),
    calls.ChangeCarrier(Carrier(False, 6)),
    calls.CountRestarts(2),
    calls.BeginFrom(None, {}),
    calls.BeginFrom('under"voltage\n', {"PCU1": True, "PCU2": False}),
    calls.NoteRestartState(None),
    calls.NoteRestartState('no "space"'),
    calls.Offer(DEMAND, NOW),
    calls.Offer(replace(DEMAND, controllers=APART, made_ns=-3), NOW),
    calls.Offer(replace(DEMAND, made_ns=NOW + 3), NOW),
    calls.Offer(replace(DEMAND, made_ns=NOW - 1, sequence=NOW // 1000 - 1), NOW),
    calls.Offer(replace(DEMAND, controllers=EVERYTHING), NOW),
    calls.Offer(replace(DEMAND, controllers={}, ttl_ms=None), NOW),
    calls.EndDemand("driver", NOW),
    calls.Arm(NOW),
    calls.Disarm(NOW),
    calls.Reset(FaultClass.SERVICE, NOW),
    calls.EmergencyStop(),
    calls.Terminate(),
    calls.ReloadSettings(Settings(bench_demand=ControllerDemand(), priorities={"driver": 2})),
    calls.ReloadSettings(Settings(tuning=TUNING)),
    calls.SetDriveMode("sport", FaultClass.DRIVER, NOW),
    calls.BeginInMode("valet"),
    calls.NoteSent(OutFrame("PCU1", 0x0008A7D0, ZERO_TORQUE), False, NOW),
]


@pytest.mark.parametrize("call", CALLS, ids=lambda call: type(call).__name__)
def test_every_call_is_read_as_it_was_written(call):
    text = LineWriter().lines([NotedCall(3, call)], 5)
    assert text.startswith('{"f":3,"')
    assert parsed(text) == [Placed(3, InputRecord(call, None))]


def test_every_kind_of_call_has_its_line():
    kinds = {type(call) for call in CALLS} | {calls.RunTick}
    assert kinds == set(calls.WORDS)


def test_answers_and_what_is_noted_beside_calls_are_read_too():
    drive = TappedDrive()
    drive.tick()
    drive.tap.take()
    assert not drive.arm().granted
    drive.gateway.apply(calls.EmergencyStop())
    drive.tap.note(WhyRecord(drive.now_ns, "starting: waits"))
    drive.tap.note(ShellEvent(drive.now_ns, Event("link_lost", Severity.ERROR, {"reason": "?"})))
    arm, estop, why, event = [one.record for one in parsed(lines_of(drive.tap))]
    assert arm.answer.refusal is Refusal.NOT_ALLOWED_NOW
    assert "listening" in arm.answer.sentence
    assert estop == InputRecord(calls.EmergencyStop(), GRANTED)
    assert why == WhyRecord(drive.now_ns, "starting: waits")
    assert event.event == Event("link_lost", Severity.ERROR, {"reason": "?"})


def test_a_tick_has_its_frames_mode_events_and_how_they_were_sent():
    drive = TappedDrive().until(Mode.STANDBY)
    drive.tap.take()
    drive.echo = False
    result = drive.tick()
    text = lines_of(drive.tap)
    offer, tick, *sent = [one.record for one in parsed(text)]
    assert offer.answer == GRANTED
    assert tick == TickRecord(drive.now_ns, result.frames, result.mode, result.events)
    assert [one.input for one in sent] == [
        calls.NoteSent(frame, True, drive.now_ns) for frame in result.frames
    ]
    assert '"ok":[true,true]' in text


def test_a_frame_between_two_sends_keeps_its_place():
    drive = TappedDrive().until(Mode.STANDBY)
    drive.tap.take()
    drive.tick()  # each echo comes before the next frame is sent
    placed = parsed(lines_of(drive.tap))
    places = [one.frames_before for one in placed]
    assert places[-2:] == [places[-3], places[-3] + 1]
    assert isinstance(placed[-3].record, TickRecord)


def test_a_frame_that_is_sent_at_another_time_has_a_line_of_its_own():
    drive = TappedDrive().until(Mode.STANDBY)
    drive.tap.take()
    result = drive.gateway.tick(drive.now_ns + 50 * MS)
    for frame in result.frames:
        drive.gateway.apply(calls.NoteSent(frame, True, drive.now_ns + 51 * MS))
    tick, *sent = [one.record for one in parsed(lines_of(drive.tap))]
    assert isinstance(tick, TickRecord)
    times = [one.input.now_ns for one in sent if isinstance(one.input, calls.NoteSent)]
    assert times == [drive.now_ns + 51 * MS] * 2


def test_a_tick_that_ended_the_process_is_a_call_without_answer():
    text = LineWriter().lines([NotedCall(2, calls.RunTick(NOW))], 2)
    assert parsed(text) == [Placed(2, InputRecord(calls.RunTick(NOW), None))]


def test_the_mode_stands_on_the_line_of_its_change_alone():
    drive, writer, parser = TappedDrive(), LineWriter(), LineParser()
    drive.until(Mode.STANDBY)
    text = lines_of(drive.tap, writer)
    assert text.count('"mode":') == 2
    drive.run(500)
    text = lines_of(drive.tap, writer)
    assert '"mode":' not in text
    parser.records('{"f":0,"tick":1,"frames":[],"mode":"standby"}')
    ticks = [one.record for one in parsed(text, parser) if isinstance(one.record, TickRecord)]
    assert {tick.mode for tick in ticks} == {Mode.STANDBY}


def test_frames_of_a_segment_are_counted_on():
    writer = LineWriter()
    writer.lines([], 4)
    assert writer.lines([NotedCall(1, calls.Arm(NOW))], 1).startswith('{"f":5,')
    assert writer.frames == 5


def test_numbers_that_json_does_not_have_are_words():
    odd = ControllerDemand(throttle_pct=math.inf, brake_pct=-math.inf, power_limit_w=math.nan)
    demand = replace(DEMAND, controllers=dict.fromkeys(CONTROLLERS, odd))
    text = LineWriter().lines([NotedCall(0, calls.Offer(demand, NOW))], 0)
    json.loads(text, parse_constant=pytest.fail)
    read = parsed(text)[0].record.input.demand.controllers["PCU2"]
    assert (read.throttle_pct, read.brake_pct) == (math.inf, -math.inf)
    assert math.isnan(read.power_limit_w)


@given(settings=SETTINGS, bench=st.none() | ASKED)
def test_any_settings_are_read_as_they_were_written(settings, bench):
    settings = replace(settings, bench_demand=bench)
    assert settings_of(json.loads(json.dumps(settings_json(settings)))) == settings


def test_settings_of_an_older_version_have_their_defaults():
    assert settings_of({"auto_arm": True}) == Settings(auto_arm=True)


def test_settings_that_are_not_known_are_named():
    with pytest.raises(ValueError, match="does not know: tomorrows_limit_w"):
        settings_of({"tomorrows_limit_w": 1})


@pytest.mark.parametrize(
    "values",
    [
        [],
        {"auto_arm": 1},
        {"period_ns": "1"},
        {"required_messages": "BMS"},
        {"priorities": {"driver": "2"}},
        {"derated_power_w": True},
        {"bench_demand": {"power_mode": "eco", "throttle_pct": "much"}},
    ],
    ids=str,
)
def test_settings_of_another_kind_are_refused(values):
    with pytest.raises((ValueError, KeyError)):
        settings_of(values)


def test_a_gap_says_what_is_missing():
    text = '{"f":9,"gap":{"frames":5,"ticks":null,"datagrams":1,"why":"the disk was full"}}'
    assert parsed(text) == [Placed(9, Gap(5, None, 1, "the disk was full"))]


@pytest.mark.parametrize("line", ['{"f":1}', '{"f":0,"begin":{"frames":1}}', '{"f":0,"new":1}'])
def test_a_line_of_another_kind_is_passed_by(line):
    assert parsed(line) == []


@pytest.mark.parametrize(
    "line",
    [
        "",
        "{",
        "[]",
        "3",
        "null",
        '{"arm":5}',
        '{"f":true,"arm":5}',
        '{"f":1,"arm":"now"}',
        '{"f":1,"tick":5,"frames":[["PCU1","0008A7D0"]]}',
        '{"f":1,"tick":5,"frames":[],"mode":"flying"}',
        '{"f":1,"tick":5,"frames":[["PCU1","1","00"]],"ok":[]  ,"events":[[1,2,3]]}',
        '{"f":1,"tick":5,"frames":[["PCU1","1","00"]],"ok":[true,true]}',
        '{"f":1,"tick":5,"frames":[["PCU1","1","00"]],"ok":[1]}',
        '{"f":1,"reload":[]}',
        '{"f":1,"carrier_changed":null}',
        '{"f":1,"begin_from":5,"reverse":{}}',
        '{"f":1,"restart_state":true}',
        '{"f":1,"offer":{"source":5,"sequence":1,"ttl_ms":1,"age_ns":null,"each":{}},"now":1}',
        '{"f":1,"offer":{"source":"a","sequence":1.5,"ttl_ms":1,"age_ns":null,"each":{}},"now":1}',
        '{"f":1,"arm":1,"refused":["never","no"]}',
        '{"checkpoint":{},"f":0}',
        "[" * 100_000,
    ],
    ids=lambda line: line[:40],
)
def test_a_line_that_is_none_is_refused_with_its_text(line):
    with pytest.raises(CoreLineError, match="is no core line"):
        parsed(line + "\n")


@given(data=st.data())
def test_a_damaged_line_is_read_or_refused_never_more(data):
    drive = TappedDrive()
    drive.run(100)
    drive.offer(ControllerDemand())
    lines = lines_of(drive.tap).splitlines()
    line = bytearray(data.draw(st.sampled_from(lines)).encode())
    at = data.draw(st.integers(0, len(line) - 1))
    line[at] = data.draw(st.integers(0, 255))
    with contextlib.suppress(CoreLineError):
        LineParser().records(bytes(line))
