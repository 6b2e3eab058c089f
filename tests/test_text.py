"""Text for people: durations, sizes, times, tables, progress."""

import io
import sys
from types import SimpleNamespace

import pytest

from vcu_gateway import text

WALL_NS = 1_763_920_000_500_999_999  # 2025-11-23T17:46:40.5 UTC


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("duration_ms", "shown", "narrow"),
    [
        (None, "never", "never"),
        (0.4, "0 ms", "0 ms"),
        (999, "999 ms", "999 ms"),
        (1000, "1.0 s", "1.0 s"),
        (59_900, "59.9 s", "59.9 s"),
        (60_000, "1 min 00 s", "1:00"),
        (187_400, "3 min 07 s", "3:07"),
        (3_599_000, "59 min 59 s", "59:59"),
        (3_599_600, "1 h 00 min", "59:59"),
        (93_912_000, "26 h 05 min", "26:05:12"),
    ],
)
def test_a_duration_is_as_exact_as_needed(duration_ms, shown, narrow):
    assert (text.duration(duration_ms), text.narrow_duration(duration_ms)) == (shown, narrow)


@pytest.mark.parametrize(
    ("size_bytes", "shown"),
    [(0, "0 B"), (999, "999 B"), (1000, "1 kB"), (999_600, "1 MB"), (2.5e15, "2.5e+03 TB")],
)
def test_a_size_has_three_digits_and_a_unit(size_bytes, shown):
    assert text.size(size_bytes) == shown


@pytest.mark.parametrize(
    ("form", "shown"),
    [
        (text.DATE_TIME, "2025-11-23 17:46:40"),
        (text.ISO_TIME, "2025-11-23T17:46:40Z"),
        (text.ISO_TIME_MS, "2025-11-23T17:46:40.500Z"),
        (text.TIME_OF_DAY_MS, "17:46:40.500"),
    ],
)
def test_an_instant_is_shown_in_utc(form, shown):
    assert text.utc(WALL_NS, form) == shown


def test_a_count_has_thousands_apart_and_its_plural():
    assert [text.counted(count, "tick") for count in (0, 1, 1200)] == [
        "0 ticks",
        "1 tick",
        "1,200 ticks",
    ]


def test_columns_of_a_table_are_as_wide_as_their_widest_cell():
    rows = [("NAME", "N", ""), ("a", "12", "x"), ("longer", "3", "")]
    assert text.table(rows, (1,), "> ") == ["> NAME     N", "> a       12  x", "> longer   3"]
    assert text.table([]) == []


class Gone(io.StringIO):
    def write(self, text):
        raise BrokenPipeError


@pytest.mark.parametrize("stream", [None, Gone()])
def test_nothing_is_raised_where_nobody_reads_stderr(monkeypatch, stream):
    monkeypatch.setattr(sys, "stderr", stream)
    text.say("page at http://127.0.0.1")


class TestProgress:
    @pytest.fixture
    def now_s(self, monkeypatch):
        now_s = [10.0]
        monkeypatch.setattr(text, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
        return now_s

    def test_a_line_is_shown_every_half_second_and_removed(self, now_s, monkeypatch):
        monkeypatch.setattr(sys, "stderr", terminal := Terminal())
        progress = text.Progress()
        for now_s[0], frames in ((10.4, 1), (10.5, 2), (10.9, 3), (11.0, 4)):
            progress.show_frames(None if frames == 4 else 0.5, frames)
        progress.clear()
        assert terminal.getvalue() == "\r\033[K 50%, 2 frames \r\033[K4 frames \r\033[K"

    def test_items_are_counted_as_they_pass(self, now_s, monkeypatch):
        monkeypatch.setattr(sys, "stderr", terminal := Terminal())
        progress = text.Progress()
        now_s[0] = 11.0
        passed = list(progress.over(range(20_000), lambda count: progress.show(str(count))))
        assert passed == list(range(20_000))
        assert terminal.getvalue() == "\r\033[K8192 \r\033[K"

    @pytest.mark.parametrize(("stream", "wanted"), [(Terminal(), False), (io.StringIO(), True)])
    def test_nothing_is_shown_without_a_terminal_or_the_wish(
        self, now_s, monkeypatch, stream, wanted
    ):
        monkeypatch.setattr(sys, "stderr", stream)
        progress = text.Progress(wanted=wanted)
        now_s[0] = 11.0
        progress.show("line")
        assert list(progress.over(range(9000), lambda _: progress.show("line"))) == [*range(9000)]
        progress.clear()
        assert stream.getvalue() == ""
