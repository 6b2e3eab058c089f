"""Frames of a log by message: whole blocks at once give what each line alone gives."""

import gzip
import itertools
import random
import tempfile

import can
import pytest

from tests.export.logs import PROTOCOL, START_NS, line, random_frames
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.errors import UnavailableError
from vcu_gateway.export import frame_store
from vcu_gateway.export.frame_store import FrameStore
from vcu_gateway.export.source import ReadOptions, Source, read
from vcu_gateway.recording.candump import LineProblems, RecordedFrame
from vcu_gateway.recording.log import open_recording
from vcu_gateway.time_window import Window, moment

CODEC = Codec(PROTOCOL)
FRAMES = random_frames(500)
ODD = [
    "(1763920000.000001) can0 123#11 R\n",
    "(1763920000.000002) can0 20000040#0000000000000000\n",
    "(1763920000.000003) can0 0808D0A7#R8\n",
    "(1763920000.000004) can0 0808D0A7##1112233\n",
    "(1763920000.000005) can0 0808D0A7#1122\n",
    "(1763920000.000006) can0 1FFFFFFF#0011223344556677\n",
    "damaged\n",
    "(1763920000.000007) can0 0808d0a7#0011223344556677\n",
    "  (1763920000.5) can0 0808D0A7#0011223344556677\n",
    "(1763920000.123456) can0 0808D0A7#0011223344556677 T\r\n",
]


def options(window: Window | None = None, told: list | None = None) -> ReadOptions:
    report = (lambda _: None) if told is None else told.append
    return ReadOptions(window or Window(), report, lambda *_: None)


def contents(store: FrameStore) -> dict:
    """Stamps and payloads of every message, and the summary."""
    rows = {
        name: [
            (stamp, chunk.payloads[8 * i : 8 * i + 8])
            for chunk in one.chunks()
            for i, stamp in enumerate(chunk.times_ns)
        ]
        for name, one in store.rows.items()
    }
    return {**rows, "summary": list(store.summary.lines(0))}


def one_by_one(path) -> dict:
    store = FrameStore(CODEC, Window())
    with open_recording(str(path), lambda _: None) as recording:
        for recorded in recording:
            store.add(recorded)
    return contents(store)


def source(path, **given) -> Source:
    return read(str(path), options(**given))


@pytest.mark.parametrize("place", [None, 0, 250, 499])
@pytest.mark.parametrize("odd", ODD)
def test_a_block_with_an_odd_line_is_read_as_line_by_line(tmp_path, odd, place):
    lines = [line(one) for one in FRAMES]
    if place is not None:
        lines.insert(place, odd)
    path = tmp_path / "drive.log"
    path.write_bytes("".join(lines).encode())
    assert contents(source(path).store) == one_by_one(path)


def test_microseconds_are_read_too(tmp_path):
    path = tmp_path / "drive.log"
    path.write_text("(1763920000.000123) can0 0808D0A7#0011223344556677\n")
    store = source(path).store
    assert contents(store)["PCU1_Status1"] == [
        (1_763_920_000_000_123_000, bytes.fromhex("0011223344556677"))
    ]


def test_a_damaged_line_is_told_with_its_number(tmp_path):
    lines = [line(one) for one in FRAMES]
    lines[333] = "damaged\n"
    path = tmp_path / "drive.log"
    path.write_text("".join(lines))
    told: list = []
    found = source(path, told=told)
    assert found.unreadable == 1
    assert [one.where for one in told] == [f"{path}:334"]


@pytest.mark.parametrize("size_bytes", [1, 60, 1000, 1 << 20])
def test_blocks_of_any_size_are_whole_lines(tmp_path, size_bytes):
    text = "".join(line(one) for one in FRAMES)
    path = tmp_path / "drive.log.gz"
    path.write_bytes(gzip.compress(text.encode()))
    with open_recording(str(path), lambda _: None) as recording:
        blocks = list(recording.blocks(size_bytes))
    if size_bytes >= 60:
        assert all(block.endswith(b"\n") for _, block in blocks)
    assert b"".join(block for _, block in blocks).decode() == text
    lines_before = itertools.accumulate((block.count(b"\n") for _, block in blocks), initial=0)
    assert [first for first, _ in blocks] == list(lines_before)[:-1]


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".csv"])
def test_other_formats_give_the_same_payloads(tmp_path, suffix):
    path = tmp_path / f"drive{suffix}"
    with can.Logger(path) as writer:
        for one in FRAMES:
            writer(can.Message(one.stamp_ns / 1e9, one.can_id, data=one.data, channel=0))
    found = source(path).store
    log = tmp_path / "drive.log"
    log.write_text("".join(line(one) for one in FRAMES))
    for name, rows in source(log).store.rows.items():
        payloads = [chunk.payloads for chunk in rows.chunks()]
        assert [chunk.payloads for chunk in found.rows[name].chunks()] == payloads


def test_what_is_outside_the_window_is_passed_over(tmp_path):
    path = tmp_path / "drive.log"
    path.write_text("".join(line(one) for one in FRAMES))
    window = Window(moment("1"), moment("2"))
    store = source(path, window=window).store
    inside = [one for one in FRAMES if 10**9 <= one.stamp_ns - START_NS <= 2 * 10**9]
    assert store.summary.decoded.total() == len(inside) > 0
    assert store.summary.passed_over == len(FRAMES) - len(inside)


def test_many_frames_wait_on_the_disk_and_come_back_in_order(monkeypatch):
    monkeypatch.setattr(frame_store, "CHUNK_ROWS", 64)
    store = FrameStore(CODEC, Window())
    frames = random_frames(14 * 300, seed=5)
    for one in frames:
        store.add(RecordedFrame(Frame(one.can_id, one.data, one.stamp_ns), "can0", 1))
    rows = store.rows["BMS_Status"]
    first = rows.chunks()
    next(first)
    again = [stamp for chunk in rows.chunks() for stamp in chunk.times_ns]
    assert again == [one.stamp_ns for one in frames if one.message == "BMS_Status"]
    assert next(first).times_ns[0] == again[64]
    assert (rows.first_ns, rows.last_ns) == (again[0], again[-1])
    store.close()


def test_a_disk_without_room_for_waiting_frames_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(frame_store, "CHUNK_ROWS", 1)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    store = FrameStore(CODEC, Window())
    one = FRAMES[0]
    with pytest.raises(UnavailableError, match=r"frames cannot wait here.*set TMPDIR"):
        store.add(RecordedFrame(Frame(one.can_id, one.data, one.stamp_ns), "can0", 1))


def test_a_flood_of_identifiers_is_counted_in_bounded_memory():
    generator = random.Random(2)
    text = "".join(
        f"(1763920000.{i:09d}) can0 {generator.randrange(1 << 29):08X}#0011223344556677 R\n"
        for i in range(20_000)
    )
    store = FrameStore(CODEC, Window())
    problems = LineProblems(str, lambda _: None)
    lines = text.splitlines(keepends=True)
    for first in range(0, len(lines), 2000):
        store.add_lines("".join(lines[first : first + 2000]).encode(), first, problems)
    assert store.summary.frames == 20_000
    assert problems.unreadable == 0
