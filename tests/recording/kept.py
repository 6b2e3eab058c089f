"""Recordings as the recorder leaves them, written by its own writer."""

import json
from pathlib import Path
from typing import Any

from vcu_gateway.recording import layout
from vcu_gateway.recording.chain import file_digests
from vcu_gateway.recording.datagram import EXTENDED
from vcu_gateway.recording.members import NO_LINK
from vcu_gateway.recording.segment import SegmentWriter, frame_line
from vcu_gateway.units import NS_PER_MS, NS_PER_S

START_S = 1_763_920_000  # 2025-11-23T17:46:40Z
FRAMES_A_SECOND = 20
COMMAND_ID = 0x0008A7D0
_CHANGED_PLACE = 4
SECONDS = 3  # of a segment
FRAMES = FRAMES_A_SECOND * SECONDS
_DESCRIPTION = {
    "format": 1,
    "run": "1f3a9c2e-0000",
    "channel": "can0",
    "config_digest": "abc",
    "number": 1,
}


class WrittenDrive:
    """A drive that grows by segments; each has 60 frames in 3 s, and each frame is an echo.

    Attributes:
        folder: of all recordings.
        path: of the drive.
    """

    def __init__(self, folder: Path, start_s: int = START_S, chained: bool = True) -> None:
        self.folder = folder
        self.path = folder / layout.DRIVES / layout.drive_name(start_s * NS_PER_S, "1f3a9c2e-0000")
        files = {
            layout.DRIVE_FILE: layout.description_bytes(_DESCRIPTION),
            layout.CONFIG_FILE: b"bus: {channel: can0}\n",
            layout.DBC_FILE: b"VERSION\n",
        }
        layout.create_folder(self.path, files)
        self._second = start_s
        self._number = self._handed_on = self._ticks = 0
        self._other = ""
        self._lost = {"frames": 0, "ticks": 0, "gaps": 0}
        self._link: bytes | None = NO_LINK if chained else None

    @property
    def name(self) -> str:
        return self.path.name

    def segment(
        self,
        gap_frames: int = 0,
        ended: bool = True,
        silently: int = 0,
        ticks_silently: int = 0,
        closes: bool = True,
        other: str = "",
    ) -> Path:
        """The next segment, after a gap that it tells and one that it does not; its core file.

        `other`: which copy of its fifth command is not as it was: "sent", "echo" or "both".
        """
        self._number += 1
        self._handed_on += gap_frames + silently
        self._ticks += gap_frames + silently + ticks_silently
        self._other = other
        writer = SegmentWriter(self.path, self._number, self._link)
        writer.add(self._begin(gap_frames))
        for _ in range(SECONDS):
            self._one_second(writer)
        if ended:
            end = {"frames": writer.frames, "ticks": writer.frames, "closes": closes, "why": "end"}
            writer.add(_line({"f": writer.frames, "end": end}))
            writer.flush(self._second)
        self._link = writer.link
        self._handed_on += writer.frames
        self._ticks += writer.frames
        writer.close()
        return self.path / layout.core_name(self._number)

    def _begin(self, gap_frames: int) -> str:
        begin = {
            "frames": self._handed_on,
            "ticks": self._ticks,
            "wall_ns": self._second * NS_PER_S,
            "recorder": "0",
            "lost": self._lost,
        }
        if self._link is not None:
            begin |= {"segment": self._number, "files": file_digests(self.path)}
        gap = ""
        if gap_frames:
            one = {"frames": gap_frames, "ticks": gap_frames, "gaps": 1}
            self._lost = {key: self._lost[key] + count for key, count in one.items()}
            begin["lost"] = self._lost
            told = {"frames": gap_frames, "ticks": gap_frames, "why": "the disk was full"}
            gap = _line({"f": 0, "gap": told})
        return _line({"checkpoint": {}, "f": 0}) + _line({"f": 0, "begin": begin}) + gap

    def _one_second(self, writer: SegmentWriter) -> None:
        for frame in range(FRAMES_A_SECOND):
            wall_ns = self._second * NS_PER_S + frame * 50 * NS_PER_MS
            echo = self._command("echo", writer.frames)
            line = frame_line("can0", wall_ns, EXTENDED | COMMAND_ID, echo, True)
            sent = self._command("sent", writer.frames).hex()
            command = ["PCU1", f"{COMMAND_ID:08X}", sent]
            tick = {"f": writer.frames, "tick": wall_ns, "frames": [command], "ok": [True]}
            writer.add(_line(tick))
            writer.add("", line, 1)
        why = f"active; {self._second % 60} s"
        writer.add(_line({"f": writer.frames, "why": why, "now": wall_ns}))
        writer.flush(self._second)
        self._second += 1

    def _command(self, copy: str, place: int) -> bytes:
        changed = self._other in (copy, "both") and place == _CHANGED_PLACE
        return bytes([changed, *bytes(7)])


def _line(values: dict[str, Any]) -> str:
    return json.dumps(values) + "\n"


def torn(path: Path, size_bytes: int = 10) -> None:
    """Cut the end of a file off, as a power cut does."""
    data = path.read_bytes()
    path.write_bytes(data[:-size_bytes])


def zeroed(path: Path, offset: int, size_bytes: int = 40) -> None:
    """Bytes of a file that a bad disk has lost."""
    data = bytearray(path.read_bytes())
    data[offset : offset + size_bytes] = bytes(size_bytes)
    path.write_bytes(data)
