"""Recorded drives: written in simulated time, read, and replayed to the byte."""

import gzip
import json
from itertools import pairwise
from pathlib import Path

import pytest

from tests.core.simulated_drive import CODEC, MS
from tests.recording.recorded import WALL_NS, RecordedDrive
from vcu_gateway.core import calls
from vcu_gateway.core.calls import RunTick
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.errors import DataError, MissingInputError
from vcu_gateway.recording import layout
from vcu_gateway.recording.checkpoint import restore, state_of
from vcu_gateway.recording.core_lines import Checkpoint, FrameRun, Gap, TickRecord, WhyRecord
from vcu_gateway.recording.log import open_recording
from vcu_gateway.recording.reader import Drive, open_drive
from vcu_gateway.units import NS_PER_S


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> RecordedDrive:
    """Some 40 s in segments of 10 s: driving, a fault, the end."""
    drive = RecordedDrive(tmp_path_factory.mktemp("drives") / "drive", 10 * NS_PER_S)
    drive.open_link()
    drive.until(Mode.STANDBY).run(1500)
    drive.gateway.receive(Frame(0x123, b"\x01", drive.now_ns, extended=False))
    drive.gateway.receive(Frame(0x20, bytes(8), drive.now_ns, error=True))
    drive.gateway.receive(Frame(0x18FF00AA, b"", drive.now_ns, remote=True))
    drive.gateway.receive(Frame(0x18FF00AA, bytes(64), drive.now_ns, own_echo=True))
    assert drive.arm().granted
    drive.demanded = ControllerDemand(throttle_pct=20)
    drive.run(15_000)
    drive.gateway.apply(calls.ReloadSettings(Settings(derated_power_w=5_000)))
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.run(10_000)
    drive.gateway.apply(calls.EmergencyStop())
    drive.run(10_000)
    drive.gateway.apply(calls.Terminate())
    drive.run(200)
    drive.close()
    return drive


def replayed(drive: Drive, first_segment: int | None = None) -> tuple[int, int]:
    """Replay and compare everything; how many ticks and sentences were the same."""
    gateway, ticks, sentences = None, 0, 0
    for record in drive.runs(first_segment):
        match record:
            case Checkpoint():
                gateway = gateway or restore(record.state, CODEC, record.settings)
                assert state_of(gateway) == record.state
            case TickRecord():
                result = RunTick(record.now_ns).apply(gateway)
                assert result[3:] == record[1:2] + record[3:]
                assert result.mode is record.mode
                ticks += 1
            case WhyRecord(now_ns, sentence):
                assert gateway.why(now_ns).sentence() == sentence
                sentences += 1
            case FrameRun(frames):
                for frame in frames:
                    gateway.receive(frame)
            case (one, answer):
                assert one.apply(gateway) == answer
            case _:
                raise AssertionError(record)
    return ticks, sentences


def test_a_drive_is_replayed_to_the_byte(recorded):
    ticks, sentences = replayed(open_drive(recorded.writer.folder))
    assert ticks == len(recorded.results)
    assert sentences >= 8


@pytest.mark.parametrize("first_segment", [2, 3, 4])
def test_it_is_replayed_to_the_byte_from_each_segment(recorded, first_segment):
    ticks, _ = replayed(open_drive(recorded.writer.folder), first_segment)
    assert ticks == len(recorded.results) - (first_segment - 1) * 200


def test_the_records_have_what_really_happened(recorded):
    records = list(open_drive(recorded.writer.folder).runs())
    ticks = [one for one in records if isinstance(one, TickRecord)]
    assert [tick[1:] for tick in ticks] == [
        (one.frames, one.mode, one.events) for one in recorded.results
    ]
    kinds = {one.severity for tick in ticks for one in tick.events}
    assert len(kinds) > 2


def test_what_a_gateway_said_of_itself_is_in_the_info(recorded):
    info = open_drive(recorded.writer.folder).info
    assert (info.channel, info.settings, info.config) == ("can0", Settings(), "limits: {}\n")
    assert info.clock.wall_ns == WALL_NS
    assert "BO_" in info.dbc
    assert info.versions["gateway"]


def test_the_settings_of_a_later_segment_are_those_in_effect_then(recorded):
    records = open_drive(recorded.writer.folder).runs()
    derated = [one.settings.derated_power_w for one in records if isinstance(one, Checkpoint)]
    assert derated == [10_000, 10_000, 5_000, 5_000]


def frames_of(drive: Drive) -> list[Frame]:
    return [frame for run in drive.runs() if isinstance(run, FrameRun) for frame in run.frames]


def test_the_frames_are_candump_lines_with_nanoseconds(recorded, tmp_path):
    drive = open_drive(recorded.writer.folder)
    frames, distance_ns = frames_of(drive), drive.info.clock.distance_ns
    path = recorded.writer.folder / "0001.frames.log.gz"
    with open_recording(str(path), lambda problem: pytest.fail(str(problem))) as recording:
        read = [one.frame for one in recording]
    assert [(one.can_id, one.data, one.arrival_ns) for one in read] == [
        (one.can_id, one.data, one.arrival_ns + distance_ns) for one in frames[: len(read)]
    ]


def test_odd_frames_are_read_as_they_were(recorded):
    frames = {one.can_id: one for one in frames_of(open_drive(recorded.writer.folder))}
    assert not frames[0x123].extended
    assert frames[0x20].error
    assert frames[0x18FF00AA].own_echo
    assert len(frames[0x18FF00AA].data) == 64


def test_one_file_of_a_segment_is_that_segment(recorded):
    path = recorded.writer.folder / "0002.core.jsonl.gz"
    assert [files.number for files in open_drive(path).segments] == [2]


def test_a_drive_without_its_beginning_begins_with_a_checkpoint(recorded, tmp_path):
    drive = copied(recorded, tmp_path, without=("0001",))
    assert replayed(open_drive(drive))[0] == len(recorded.results) - 200


def copied(recorded: RecordedDrive, tmp_path: Path, without: tuple[str, ...] = ()) -> Path:
    folder = tmp_path / "copied"
    folder.mkdir()
    for path in recorded.writer.folder.iterdir():
        if not path.name.startswith(without or ("-",)):
            (folder / path.name).write_bytes(path.read_bytes())
    return folder


def gaps(drive: Drive) -> list[Gap]:
    return [one for one in drive.runs() if isinstance(one, Gap)]


def test_segments_that_are_not_there_are_a_gap(recorded, tmp_path):
    drive = open_drive(copied(recorded, tmp_path, without=("0002", "0003")))
    (gap,) = gaps(drive)
    assert gap.why == "segments 2 to 3 are not there"
    assert gap.ticks == 400
    assert gap.frames > 4_000


@pytest.mark.parametrize("name", ["0002.frames.log.gz", "0002.core.jsonl.gz"])
def test_a_damaged_member_is_a_gap_up_to_the_next_checkpoint(recorded, tmp_path, name):
    folder = copied(recorded, tmp_path)
    data = bytearray((folder / name).read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    (folder / name).write_bytes(data)
    records = list(open_drive(folder).runs())
    ticks = sum(isinstance(one, TickRecord) for one in records)
    first, second = [one for one in records if isinstance(one, Gap)]
    assert name in first.why
    assert ticks + second.ticks == len(recorded.results)
    assert 0 < second.ticks < 200
    after = records[records.index(second) + 1]
    assert isinstance(after, Checkpoint)


@pytest.mark.parametrize("name", ["0004.frames.log.gz", "0004.core.jsonl.gz"])
def test_a_torn_end_is_a_gap_of_unknown_size(recorded, tmp_path, name):
    folder = copied(recorded, tmp_path)
    path = folder / name
    path.write_bytes(path.read_bytes()[:-10])
    (gap,) = gaps(open_drive(folder))
    assert gap[:3] == (None, None, None)
    assert "cut off" in gap.why


def test_a_segment_without_checkpoint_is_passed_by(recorded, tmp_path):
    folder = copied(recorded, tmp_path, without=("0002.core",))
    first, second = gaps(open_drive(folder))
    assert "not there" in first.why
    assert second.ticks == 200


def test_a_drive_whose_beginning_cannot_be_read_begins_behind_it(recorded, tmp_path):
    folder = copied(recorded, tmp_path, without=("0001.core",))
    (gap,) = gaps(open_drive(folder))
    assert gap.ticks is None
    assert ticks_of(open_drive(folder)) == len(recorded.results) - 200


def ticks_of(drive: Drive) -> int:
    return sum(isinstance(one, TickRecord) for one in drive.runs())


def test_a_line_that_is_whole_and_wrong_is_an_error_with_its_place(recorded, tmp_path):
    folder = copied(recorded, tmp_path)
    path = folder / "0003.core.jsonl.gz"
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    lines[6] = b'{"f":"many","tick":5}\n'
    path.write_bytes(gzip.compress(b"".join(lines)))
    with pytest.raises(DataError, match=r"0003\.core\.jsonl\.gz:7: .*no core line"):
        gaps(open_drive(folder))


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("(5.123456789) can0 123#00", "no frame line"),
        ("(5.12345678) can0 123#00 R", "no frame line"),
        ("(5.123456789) can0 123#00 X", "no frame line"),
        ("(5.123456789) can0 12x#00 R", "no frame line"),
        ("(5.123456789) can0 123#0 R", "payload '0' is damaged"),
    ],
)
def test_a_frame_line_that_is_whole_and_wrong_is_an_error(recorded, tmp_path, line, reason):
    folder = copied(recorded, tmp_path)
    path = folder / "0001.frames.log.gz"
    path.write_bytes(gzip.compress(f"{line}\n".encode()))
    with pytest.raises(DataError, match=rf"0001\.frames\.log\.gz:1: .*{reason}"):
        gaps(open_drive(folder))


def test_what_is_no_drive_is_an_error_that_says_what_to_give(tmp_path):
    for path in (tmp_path, tmp_path / "nothing", tmp_path / "a.log"):
        if path.suffix:
            path.write_text("")
        with pytest.raises(MissingInputError, match="give "):
            open_drive(path)


@pytest.mark.parametrize(
    "changes",
    [{"clock": None}, {"settings": {"no": 1}}, {"run": None, "versions": 5}],
    ids=str,
)
def test_a_description_that_cannot_be_used_names_who_wrote_it(recorded, tmp_path, changes):
    folder = copied(recorded, tmp_path)
    path = folder / "drive.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(DataError, match=r"drive\.json: cannot be used .*written by"):
        open_drive(folder)


def test_a_drive_is_held_while_it_is_written(tmp_path):
    drive = RecordedDrive(tmp_path / "drive")
    assert layout.is_held(tmp_path / "drive")
    drive.close()
    assert not layout.is_held(tmp_path / "drive")


def test_the_wall_clock_of_a_checkpoint_is_that_of_its_tick(recorded):
    records = open_drive(recorded.writer.folder).runs()
    times = [(one.now_ns, one.wall_ns) for one in records if isinstance(one, Checkpoint)]
    assert [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(times)] == [
        (10_000 * MS, 10_000 * MS)
    ] * 3
