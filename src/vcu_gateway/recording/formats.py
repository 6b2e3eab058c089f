"""Formats that python-can reads, as frames."""

import itertools
from collections.abc import Iterator
from typing import IO, Any

from vcu_gateway.python_can import can, mf4_reader

# isort: split
from can.io.generic import BinaryIOMessageReader, TextIOMessageReader

from vcu_gateway.core import j1939
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.recording.candump import LineProblems, LineReader, RecordedFrame
from vcu_gateway.units import NS_PER_S

Content = LineReader | IO[bytes] | str
"""The lines of a text format, the open file of a binary one, or the name of a database."""
_READERS = can.io.MESSAGE_READERS
SUFFIXES = sorted(_READERS)
TEXT = [one for one in SUFFIXES if issubclass(_READERS[one], TextIOMessageReader)]
BINARY = [one for one in SUFFIXES if issubclass(_READERS[one], BinaryIOMessageReader)]


def frames(suffix: str, content: Content, problems: LineProblems) -> Iterator[RecordedFrame]:
    """Every frame; ends with an error at the first damage, as python-can cannot go on."""
    messages = _messages(suffix, content)
    for number in itertools.count(1):
        try:
            message = next(messages, None)
        except Exception as error:
            # Any bytes go into python-can's parsers: their errors have no common base.
            raise problems.failure(_place(content, number), error) from error
        if message is None:
            return
        if recorded := _recorded(message, _place(content, number), problems):
            yield recorded


def _place(content: Content, number: int) -> int:
    return content.number if isinstance(content, LineReader) else number


def _messages(suffix: str, content: Content) -> Iterator[can.Message]:
    reader_type: Any = mf4_reader() if suffix == ".mf4" else _READERS[suffix]
    with reader_type(content) as reader:
        yield from reader


def _recorded(message: can.Message, place: int, problems: LineProblems) -> RecordedFrame | None:
    try:
        # A database may hold any type in its columns.
        arrival_ns = round(float(message.timestamp) * NS_PER_S)
        can_id = int(message.arbitration_id)
    except (TypeError, ValueError, OverflowError):
        what = f"time {message.timestamp!r} or identifier {message.arbitration_id!r} is no number"
        problems.damaged(place, what)
        return None
    error = message.is_error_frame
    if not error and can_id & j1939.ID_MASK != can_id:
        error = True
        if not problems.is_error_frame(place, can_id):
            return None
    frame = Frame(
        can_id & j1939.ID_MASK,
        bytes(message.data),
        arrival_ns,
        message.is_extended_id,
        message.is_remote_frame,
        error,
    )
    channel = None if message.channel is None else str(message.channel)
    return RecordedFrame(frame, channel, place, message.is_fd)
