"""Writer of a drive in simulated time: a tapped gateway straight to files, without a recorder."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vcu_gateway.recording import layout
from vcu_gateway.recording.datagram import FrameRecord
from vcu_gateway.recording.segment import SegmentWriter, frame_line
from vcu_gateway.recording.tap import TappedGateway, TapStream, recorded_frame
from vcu_gateway.units import NS_PER_S

_SEGMENT_NS = 60 * NS_PER_S


class DriveWriter:
    """Records a gateway from now on, until `close`.

    `hello` is what `Hello.values` gives. Call `after_tick` when the frames of a tick were sent.

    Attributes:
        folder: of the drive; it was not there.
    """

    def __init__(
        self,
        folder: Path,
        hello: Mapping[str, Any],
        gateway: TappedGateway,
        now_ns: int,
        segment_ns: int = _SEGMENT_NS,
    ) -> None:
        layout.create_folder(folder, layout.drive_files(hello))
        self.folder = folder
        self._hold = layout.hold(folder)
        self._distance_ns = hello["clock"]["wall_ns"] - hello["clock"]["monotonic_ns"]
        self._channel = hello["channel"]
        self._gateway = gateway
        self._stream = TapStream(gateway)
        self._segment_ns = segment_ns
        self._number = 0
        self._segment = self._begin(now_ns)

    def _begin(self, now_ns: int) -> SegmentWriter:
        self._stream.begin(now_ns, now_ns + self._distance_ns)
        self._number += 1
        self._next_segment_ns = now_ns + self._segment_ns
        self._next_member_ns = now_ns + NS_PER_S
        return SegmentWriter(self.folder, self._number)

    def after_tick(self, now_ns: int) -> None:
        """Write what the tick made of its inputs; a second is a member."""
        self._stream.note_why(now_ns, self._gateway.reasons(now_ns).signature())
        self._take()
        if now_ns >= self._next_member_ns:
            self._next_member_ns += NS_PER_S
            self._flush(now_ns)
        if now_ns >= self._next_segment_ns:
            self._flush(now_ns)
            self._segment.close()
            self._segment = self._begin(now_ns)

    def _take(self) -> None:
        frames, lines = self._stream.batch()
        text = "".join([self._frame_line(recorded_frame(frame)) for frame in frames])
        self._segment.add(lines, text, len(frames))

    def _frame_line(self, frame: FrameRecord) -> str:
        wall_ns = frame.arrival_ns + self._distance_ns
        return frame_line(self._channel, wall_ns, frame.can_id, frame.data, frame.own_echo)

    def _flush(self, now_ns: int) -> None:
        self._segment.flush((now_ns + self._distance_ns) // NS_PER_S)

    def close(self, now_ns: int) -> None:
        self._take()
        self._flush(now_ns)
        self._segment.close()
        os.close(self._hold)
