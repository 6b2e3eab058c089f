"""The log: one line an event, and nobody waits for its reader."""

import fcntl
import io
import json
import os
import subprocess
import sys
import threading
import time
from typing import TextIO

import pytest

from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.daemon import log
from vcu_gateway.daemon.log import QueuedWriter

F_SETPIPE_SZ = 1031
PATIENCE_S = 30.0
A_MOMENT_S = log._DRAIN_S


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """What is written is waited for longer than at the end of a program: a machine may be busy."""
    monkeypatch.setattr(log, "_DRAIN_S", PATIENCE_S)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def written(stream: io.StringIO, writer: QueuedWriter) -> str:
    writer.drain()
    return stream.getvalue()


@pytest.mark.parametrize("severity", list(Severity))
def test_an_event_is_one_json_line_with_its_fields(severity):
    stream = io.StringIO()
    writer = log.configure("debug", "auto", stream)
    log.log_event(Event("mode_changed", severity, {"before": "standby", "after": "active"}))
    entry = json.loads(written(stream, writer))
    assert entry.pop("timestamp").endswith("Z")
    assert entry == {
        "event": "mode_changed",
        "level": severity.name.lower(),
        "before": "standby",
        "after": "active",
    }


def test_less_severe_events_than_the_level_are_not_written():
    stream = io.StringIO()
    writer = log.configure("warning", "json", stream)
    log.log_event(Event("quiet", Severity.INFO))
    log.log_event(Event("loud", Severity.ERROR))
    assert [json.loads(line)["event"] for line in written(stream, writer).splitlines()] == ["loud"]


def test_a_person_at_a_terminal_reads_words_not_json():
    stream = Terminal()
    writer = log.configure("info", "auto", stream)
    log.log_event(Event("link_open", Severity.INFO))
    text = written(stream, writer)
    assert "link_open" in text
    assert not text.startswith("{")


@pytest.fixture
def pipe():
    """A pipe of one page: its end to read, and its other end as a stream."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, F_SETPIPE_SZ, 4096)
    with open(writing, "w") as stream, open(reading) as reader:
        yield reader, stream


def read_lines(reader: TextIO, count: int) -> list[str]:
    return [reader.readline().rstrip("\n") for _ in range(count)]


def fill(writer: QueuedWriter, count: int) -> None:
    """Write so many lines from a thread that must not wait."""
    done = threading.Event()

    def write() -> None:
        for number in range(count):
            writer.write(f"{number:099d}\n")
        done.set()

    threading.Thread(target=write, daemon=True).start()
    assert done.wait(PATIENCE_S), "writing waited for the reader"


def test_a_reader_that_does_not_read_costs_lines_and_never_the_writer(pipe):
    reading, stream = pipe
    writer = QueuedWriter(stream)
    fill(writer, 5000)
    in_the_pipe = 4096 // 100 + 1  # and the line that waits to be written
    assert 5000 - 1000 - in_the_pipe <= writer.dropped <= 5000 - 1000
    kept = 5000 - writer.dropped
    numbers = [int(line) for line in read_lines(reading, kept)]
    assert numbers[:1000] == list(range(1000)), "the oldest are kept"
    # Whatever the pipe takes later makes room for as many later ones.
    assert numbers == sorted(set(numbers))


def test_lost_lines_are_reported_once_the_reader_reads_again(pipe):
    reading, stream = pipe
    told: list[int] = []
    writer = QueuedWriter(stream, told.append)
    fill(writer, 3000)
    dropped = writer.dropped
    assert told == []
    read_lines(reading, 3000 - dropped)
    writer.drain()
    assert told == [dropped]


def test_the_end_waits_only_a_moment_for_a_reader_that_does_not_read(pipe, monkeypatch):
    monkeypatch.setattr(log, "_DRAIN_S", A_MOMENT_S)
    assert A_MOMENT_S < 1.0
    _, stream = pipe
    writer = QueuedWriter(stream)
    fill(writer, 100)
    begun_s = time.monotonic()
    writer.drain()
    assert time.monotonic() - begun_s < A_MOMENT_S + PATIENCE_S / 2, "it waited for the reader"


def test_a_program_ends_in_order_although_nobody_reads_its_log(pipe):
    """Python's own stderr would be locked by the waiting thread, and abort the program."""
    _, stream = pipe
    code = (
        "from vcu_gateway.daemon import log\n"
        "writer = log.configure('info', 'json')\n"
        "for number in range(200): log.log.info('line', number=number)\n"
        "writer.drain()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], stderr=stream, timeout=60)
    assert done.returncode == 0


@pytest.mark.parametrize("thread", ["main", "worker"])
def test_a_crash_is_a_line_of_the_log_and_ends_although_nobody_reads(thread, pipe):
    reading, stream = pipe
    crash = "one = threading.Thread(target=int, args=('x',), name='worker'); one.start()"
    code = (
        "import threading\n"
        "from vcu_gateway.daemon import log\n"
        "log._DRAIN_S = 2\n"
        "writer = log.configure('info', 'json')\n"
        "for number in range(9): log.log.info('line', text='x' * 200)\n"
        f"{crash + '; one.join()' if thread == 'worker' else ''}\n"
        "int('x')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], stderr=stream, timeout=60)
    assert done.returncode == 1
    crashes = [json.loads(line) for line in read_lines(reading, 10)][9:]
    assert crashes[0]["event"] == "crashed"
    assert crashes[0]["thread"] == thread
    assert crashes[0]["error"].startswith("ValueError(")
    assert crashes[0]["exception"].startswith("Traceback")


def test_a_full_disk_costs_lines_which_are_counted():
    with open("/dev/full", "w") as stream:
        writer = QueuedWriter(stream)
        for _ in range(10):
            writer.write("lost\n")
        writer.drain()
        assert writer.dropped == 10


def test_lines_come_again_when_the_disk_has_room_again(tmp_path):
    """A file-size limit stands for the full disk: it too cuts a line in the middle."""
    path = tmp_path / "log"
    code = (
        "import resource, signal\n"
        "from vcu_gateway.daemon import log\n"
        "log._DRAIN_S = 30\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (25, resource.RLIM_INFINITY))\n"
        "writer = log.QueuedWriter(open('log', 'w'))\n"
        "for number in range(5): writer.write(f'line {number} 345678\\n')\n"
        "writer.drain()\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)\n"
        "writer.write('room again\\n')\n"
        "writer.drain()\n"
        "print(writer.dropped)\n"
    )
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, capture_output=True, text=True, timeout=60, cwd=tmp_path)
    assert done.stdout == "4\n", done.stderr
    assert path.read_text().splitlines() == ["line 0 345678", "line 1 3456", "room again"]


def test_a_reader_that_is_gone_is_survived_and_counted(pipe):
    reading, stream = pipe
    reading.close()
    writer = QueuedWriter(stream)
    writer.write("lost\n")
    writer.drain()
    assert writer.dropped == 1


def test_a_stream_that_somebody_made_non_blocking_loses_nothing(pipe):
    reading, stream = pipe
    os.set_blocking(stream.fileno(), False)
    writer = QueuedWriter(stream)
    fill(writer, 900)
    assert [int(line) for line in read_lines(reading, 900)] == list(range(900))
    assert writer.dropped == 0


def test_nobody_can_close_the_log_under_the_writer(pipe):
    reading, stream = pipe
    writer = QueuedWriter(stream)
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    writer.write("still here\n")
    assert read_lines(reading, 1) == ["still here"]


def test_a_line_without_end_is_cut(pipe):
    reading, stream = pipe
    writer = QueuedWriter(stream)
    writer.write("x" * 1_000_000 + "\n")
    line = read_lines(reading, 1)[0]
    assert line.endswith("x ...")
    assert len(line) < 20_000


@pytest.mark.parametrize("stream", ["closed", None])
def test_a_stream_that_is_closed_before_the_start_is_survived_and_counted(stream):
    if stream == "closed":
        stream = io.StringIO()
        stream.close()
    writer = QueuedWriter(stream)
    writer.write("lost\n")
    writer.drain()
    assert writer.dropped == 1


def test_lost_lines_are_themselves_a_line_of_the_log(pipe):
    reading, stream = pipe
    writer = log.configure("info", "json", stream)
    fill(writer, 2000)
    dropped = writer.dropped
    lines = read_lines(reading, 2000 - dropped + 1)
    entry = json.loads(lines[-1])
    assert (entry["event"], entry["lines"]) == ("log_lines_dropped", dropped)


def test_in_the_journal_each_line_begins_with_its_priority(tmp_path, monkeypatch):
    with (tmp_path / "journal").open("w+") as stream:
        status = (tmp_path / "journal").stat()
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        writer = log.configure("debug", "auto", stream)
        for level in ("debug", "info", "warning", "error", "critical"):
            getattr(log.log, level)("told")
        writer.drain()
        stream.seek(0)
        lines = stream.read().splitlines()
    assert [line[:4] for line in lines] == ["<7>{", "<6>{", "<4>{", "<3>{", "<2>{"]
    assert json.loads(lines[2][3:])["level"] == "warning"


def test_a_stream_that_is_not_the_journals_has_no_priorities(tmp_path, monkeypatch):
    monkeypatch.setenv("JOURNAL_STREAM", "1:2")
    with (tmp_path / "file").open("w+") as stream:
        writer = log.configure("info", "json", stream)
        log.log.info("told")
        writer.drain()
        stream.seek(0)
        assert stream.read().startswith("{")
