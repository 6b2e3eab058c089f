"""Recorded frame, the common result of every reader."""

from typing import NamedTuple

from vcu_gateway.core.j1939 import Frame


class RecordedFrame(NamedTuple):
    """One frame of a recording.

    Attributes:
        frame: its arrival_ns is the recording's own stamp, on whatever clock that was.
        channel: the interface's name or number; None where the format has none.
        position: line of a text format, else number of the frame, from 1.
        fd: a CAN FD frame.
    """

    frame: Frame
    channel: str | None
    position: int
    fd: bool = False
