"""The log: one line an event, and nobody waits for its reader."""

import io
import json
import os
import threading

import pytest

from vcu_gateway import log
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.log import QueuedWriter


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


def test_a_reader_that_does_not_read_costs_lines_and_never_the_writer():
    reading, writing = os.pipe()
    stream = os.fdopen(writing, "w")
    writer = QueuedWriter(stream)
    done = threading.Event()

    def fill() -> None:
        for _ in range(5000):
            writer.write("x" * 100 + "\n")
        done.set()

    threading.Thread(target=fill, daemon=True).start()
    assert done.wait(5), "writing waited for the reader"
    assert writer.dropped > 0
    reader = threading.Thread(target=os.fdopen(reading).read)
    reader.start()
    writer.drain()
    stream.close()
    reader.join()


def test_a_closed_stream_is_survived_and_counted():
    stream = io.StringIO()
    stream.close()
    writer = QueuedWriter(stream)
    writer.write("lost\n")
    writer.drain()
    assert writer.dropped == 1
    assert log.configure("info", "auto", stream) is not None
