"""Recorded drives as a source: decisions by wall time, parts of a drive, and damage."""

import gzip
import json
import re
from typing import get_args

import pytest

from tests.export.drives import record
from tests.recording.recorded import WALL_NS, RecordedDrive
from vcu_gateway.api import results
from vcu_gateway.core import calls
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.tuning import DriveMode, Tuning
from vcu_gateway.errors import DataError, MissingInputError
from vcu_gateway.export.decisions import MODES
from vcu_gateway.export.formats import tables_of
from vcu_gateway.export.html_report import page
from vcu_gateway.export.report_builder import build
from vcu_gateway.export.source import ReadOptions, Selection, Source, read, title
from vcu_gateway.time_window import Window, moment
from vcu_gateway.units import NS_PER_S


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("drives") / "20251123T174640Z-01234567")


@pytest.fixture
def folder(recorded, tmp_path):
    """A copy that may be damaged."""
    target = tmp_path / recorded.writer.folder.name
    target.mkdir()
    for path in recorded.writer.folder.iterdir():
        (target / path.name).write_bytes(path.read_bytes())
    return target


def source(path, window: Window | None = None, told: list | None = None) -> Source:
    report = (lambda _: None) if told is None else told.append
    return read(str(path), ReadOptions(window or Window(), report, lambda *_: None))


def test_every_tick_has_its_mode_and_every_event_its_tick(recorded):
    found = source(recorded.writer.folder).decisions
    assert [MODES[code] for code in found.tick_modes] == [
        one.mode.value for one in recorded.results
    ]
    expected = [event.name for one in recorded.results for event in one.events]
    assert [one.name for one in found.events] == expected
    whys = dict(found.whys)
    assert recorded.sentences[-1].split(";")[0] == found.whys[-1][1].split(";")[0]
    assert set(whys) <= {*found.tick_times_ns, WALL_NS}


def test_wall_time_is_exact(recorded):
    found = source(recorded.writer.folder)
    first_ns = found.decisions.tick_times_ns[0]
    assert (first_ns - WALL_NS) % 1_000_000 == 0
    assert found.start_ns <= first_ns < found.end_ns


def test_causes_are_stretches_of_time(recorded):
    causes = source(recorded.writer.folder).decisions.causes
    [fault] = [one for one in causes if one.key.subject == "BMS_Status.CellUndervoltage"]
    assert (fault.key.effect, fault.detail, fault.ended_ns) == ("stop", "2 (level2)", None)


def test_causes_that_stood_at_the_begin_of_a_part_are_known(recorded):
    last = recorded.writer.folder / "0003.core.jsonl.gz"
    found = source(last)
    assert [one.key.subject for one in found.decisions.causes] == ["BMS_Status.CellUndervoltage"]
    assert 0 < len(found.decisions.tick_times_ns) < len(recorded.results)
    assert title(str(last)) == "20251123T174640Z-01234567-0003"


def test_tables_have_modes_causes_events_and_sentences(recorded):
    tables = {one.name: one for one in tables_of(source(recorded.writer.folder), Selection())}
    assert {"Gateway", "Gateway_Events", "Gateway_Why", "PCU1", "PCU2"} <= tables.keys()
    [chunk] = tables["Gateway"].chunks()
    names = [channel.name for channel in tables["Gateway"].channels]
    stands = chunk.columns[names.index("BMS_Status.CellUndervoltage: stop")]
    fault = [one.mode.value for one in recorded.results].index("fault")
    assert list(stands) == [int(number >= fault) for number in range(len(stands))]
    assert tables["Gateway"].channels[0].names == dict(enumerate(MODES))


def test_commanded_beside_actual_has_a_row_for_each_command(recorded):
    [table] = tables_of(source(recorded.writer.folder), Selection(("PCU1.Throttle",)))
    assert [one.name for one in table.channels] == ["Throttle_commanded", "Throttle_actual"]
    commanded = [
        frame.data[1] * 0.39
        for one in recorded.results
        for frame in one.frames
        if frame.controller == "PCU1"
    ]
    assert [one for chunk in table.chunks() for one in chunk.columns[0]] == commanded


def test_its_files_are_attached(recorded):
    attached = source(recorded.writer.folder).attachments
    assert set(attached) == {"config.yaml", "vcu.dbc", "drive.json"}
    assert attached["config.yaml"] == b"limits: {}\n"


def test_a_part_of_a_drive_has_its_frames_and_ticks(recorded):
    found = source(recorded.writer.folder, Window(moment("2"), moment("4")))
    for stamps in (found.decisions.tick_times_ns, [found.start_ns, found.end_ns]):
        assert all(2 * NS_PER_S <= stamp - WALL_NS <= 4.2 * NS_PER_S for stamp in stamps)
    assert len(found.decisions.tick_times_ns) in (40, 41)


def test_a_torn_member_is_told_and_the_rest_is_read(folder):
    whole = source(folder)
    path = folder / "0002.frames.log.gz"
    contents = path.read_bytes()
    path.write_bytes(contents[:-20])
    told: list = []
    lost = whole.store.summary.frames - source(folder, told=told).store.summary.frames
    assert 0 < lost < 500  # one member, a second
    assert [one.where.partition(",")[0] for one in told] == [str(path)]


def test_a_damaged_core_line_is_told_with_file_and_line(folder):
    path = folder / "0001.core.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    lines[9] = b"{}\n"
    path.write_bytes(gzip.compress(b"".join(lines)))
    told: list = []
    assert source(folder, told=told).unreadable == 1
    assert [one.where for one in told] == [f"{path}:10"]


def test_a_state_of_another_version_costs_the_causes_that_stood_alone(folder):
    path = folder / "0003.core.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    checkpoint = json.loads(lines[0])
    checkpoint["checkpoint"]["state"] = {"unknown": 1}
    lines[0] = json.dumps(checkpoint).encode() + b"\n"
    path.write_bytes(gzip.compress(b"".join(lines)))
    assert source(path).decisions.causes == []


def test_without_drive_json_it_is_said_what_to_give(folder):
    (folder / "drive.json").unlink()
    with pytest.raises(MissingInputError, match="give the folder of a drive or an incident"):
        source(folder)


def test_without_clocks_it_is_damaged(folder):
    described = json.loads((folder / "drive.json").read_text())
    del described["clock"]
    (folder / "drive.json").write_text(json.dumps(described))
    with pytest.raises(DataError, match="has no pair of clocks"):
        source(folder)


def test_a_folder_without_segments_is_told(folder):
    for path in folder.glob("0*"):
        path.unlink()
    with pytest.raises(MissingInputError, match="has no segment"):
        source(folder)


def test_a_report_tells_a_stop_by_its_sentence(folder):
    path = folder / "0003.core.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    fields = {"stage": "cut", "sentence": "Power is cut: PCU1 and PCU2 confirm"}
    now_ns = json.loads(lines[0])["checkpoint"]["now"]
    event = {"f": 0, "event": ["stop_stage", "INFO", fields], "now": now_ns}
    path.write_bytes(gzip.compress(b"".join([*lines, json.dumps(event).encode() + b"\n"])))
    [told] = [one for one in build(source(folder), Selection()).events if one.name == "stop_stage"]
    assert told.text == "Power is cut: PCU1 and PCU2 confirm"


def test_a_gap_is_told_in_the_tables(folder):
    path = folder / "0002.core.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    gap = b'{"f":0,"gap":{"frames":12,"ticks":3,"why":"the recorder was slow"}}\n'
    path.write_bytes(gzip.compress(b"".join([lines[0], gap, *lines[1:]])))
    [(stamp, text)] = source(folder).decisions.gaps
    assert text == "12 frames, 3 ticks missing; the recorder was slow"
    assert stamp > WALL_NS


@pytest.mark.parametrize(
    ("config", "frames"), [("protocol: {aliases: {}}\n", 0), ("damaged: [", 1)]
)
def test_the_aliases_are_those_of_the_drives_configuration(folder, config, frames):
    (folder / "config.yaml").write_text(config)
    for path in folder.glob("000[2-9]*"):
        path.unlink()
    line = b"(1763920000.500000000) can0 08F02DE2#0011223344556677 R\n"
    (folder / "0001.frames.log.gz").write_bytes(gzip.compress(line))
    assert source(folder).store.rows["IMU_Attitude"].count == frames


@pytest.mark.parametrize("contents", ['{"format": 1, "reason": "undervoltage"}', "[]", "damaged"])
def test_an_incident_says_why_it_is_kept(folder, contents):
    (folder / "incident.json").write_text(contents)
    facts = dict(build(source(folder), Selection()).facts)
    reason = "undervoltage" if "reason" in contents else None
    assert facts.get("kept because of") == reason


def test_a_cause_ends_where_its_event_says(tmp_path):
    drive = record(tmp_path / "drive", seconds=8)
    found = source(drive.writer.folder).decisions
    ended = {(one.key.subject, one.ended_ns) for one in found.causes if one.ended_ns is not None}
    events = [one for one in found.events if one.name == "cause_ended"]
    assert ended == {(one.fields["subject"], one.wall_ns) for one in events}
    assert ended


def test_behind_a_missing_segment_causes_are_known_again(folder):
    for path in folder.glob("0002*"):
        path.unlink()
    found = source(folder).decisions
    assert [text for _, text in found.gaps] == ["no segment before 0003"]
    [fault] = [one for one in found.causes if one.key.subject == "BMS_Status.CellUndervoltage"]
    assert fault.began_ns > found.gaps[0][0]


def test_behind_a_gap_causes_are_known_again(folder):
    for path in folder.glob("0001*"):
        path.unlink()
    path = folder / "0002.core.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    gap = b'{"f":0,"gap":{"frames":1,"ticks":1,"why":"full"}}\n'
    path.write_bytes(gzip.compress(lines[0] + gap))
    found = source(folder).decisions
    assert "BMS_Status.CellUndervoltage" in [one.key.subject for one in found.causes]


# Tuning.

HOT = Curve(((60.0, 100.0), (90.0, 10.0)))
TUNED = Tuning(
    curves={"power_limit_w.by_controller_temperature_c": HOT, "brake_pct.by_soc_pct": HOT},
    start="eco",
    modes={"eco": DriveMode(), "sport": DriveMode()},
)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """Some seconds in eco, two in sport, the last of them with hot controllers and an alarm."""
    drive = RecordedDrive(tmp_path_factory.mktemp("drives") / "tuned", 2 * NS_PER_S, tuning=TUNED)
    drive.open_link()
    drive.until(Mode.STANDBY).run(3000)
    drive.gateway.apply(calls.SetDriveMode("sport", FaultClass.DRIVER, drive.now_ns))
    drive.run(1000)
    drive.codes |= {f"PCU{n}_Status1.ControllerTemperature": 140 for n in (1, 2)}
    drive.codes["BMS_Status.TemperatureImbalance"] = 1
    drive.run(1000)
    drive.close()
    return drive


def test_drive_modes_are_a_band_from_where_each_counts(tuned):
    found = source(tuned.writer.folder)
    report = build(found, Selection())
    [band] = [one for one in report.bands if one.title == "drive mode"]
    eco, sport = band.spans
    [changed] = [one for one in found.decisions.events if one.name == "drive_mode_changed"]
    assert (eco.text, sport.text) == ("eco", "sport")
    assert eco.begin_ns == report.start_ns
    assert eco.end_ns == sport.begin_ns == changed.wall_ns
    assert "mode sport" in [one.text for one in report.events if one.name == "drive_mode_changed"]
    part = source(tuned.writer.folder, Window(begin=moment("5.3 s")))
    [sport] = next(one for one in build(part, Selection()).bands if one.title == "drive mode").spans
    assert sport.text == "sport"


def test_without_drive_modes_there_is_no_band_of_them(recorded):
    bands = build(source(recorded.writer.folder), Selection()).bands
    assert "drive mode" not in [one.title for one in bands]


def test_what_a_curve_limits_is_a_band_of_its_key_above_the_alarms(tuned):
    titles = [one.title for one in build(source(tuned.writer.folder), Selection()).bands]
    power = titles.index("curves.power_limit_w.by_controller_temperature_c: cap")
    assert titles.index("curves.brake_pct.by_soc_pct: cap") != power
    assert power < titles.index("BMS_Status.TemperatureImbalance: alarm")


def test_every_effect_has_a_colour_in_the_page(tuned):
    text = page(build(source(tuned.writer.folder), Selection()))
    [kinds] = re.findall(r"const KINDS = \{(.*?)\}", text)
    named = {one.strip(' "') for one in re.findall(r'([\w" ]+):', kinds)}
    plain = {one for one in get_args(results.EffectName) if f"--{one}: #" in text}
    assert named | plain == set(get_args(results.EffectName))
