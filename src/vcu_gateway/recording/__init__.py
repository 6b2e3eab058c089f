"""Recordings of the bus, read frame by frame whatever their format.

candump text is read here, line by line, and a damaged line does not end the reading. Every
other format is read by python-can, which ends at the first damage.

No identifier is ever shortened to 29 bits: a number beyond them is an error frame or damage
(docs/protocol.md E2), and python-can's own candump reader would decode it as data. BLF and MF4
are the exception, because python-can cuts their identifiers itself.
"""

from vcu_gateway.recording.problems import LineProblems
from vcu_gateway.recording.recorded import RecordedFrame
from vcu_gateway.recording.recording import STANDARD_INPUT, Recording, open_recording

__all__ = ["STANDARD_INPUT", "LineProblems", "RecordedFrame", "Recording", "open_recording"]
