"""Records of a tapped gateway, as a drive's reader would give them, without files."""

from collections.abc import Iterator

from vcu_gateway.core import calls
from vcu_gateway.recording.core_lines import CoreRecord, InputRecord, TickRecord
from vcu_gateway.recording.tap import Tap


def records(tap: Tap) -> Iterator[CoreRecord]:
    """Everything that was noted since the last call, in its order."""
    frames, noted = tap.take()
    done = 0
    for call in noted:
        for frame in frames[done : call[0]]:
            yield InputRecord(calls.Receive(frame), None)
        done = max(done, call[0])
        yield record(call[1], call[2])
    for frame in frames[done:]:
        yield InputRecord(calls.Receive(frame), None)


def record(what, answer) -> CoreRecord:
    if isinstance(what, calls.RunTick):
        return TickRecord(what.now_ns, answer.frames, answer.mode, answer.events)
    return InputRecord(what, answer) if type(what) in calls.WORDS else what
