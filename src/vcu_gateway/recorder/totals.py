"""Counts of this process: what was recorded, what was lost, and how the disk did."""

import time
from collections import deque
from dataclasses import dataclass, field

_MINUTE_S = 60.0


@dataclass(slots=True)
class Totals:
    """Counts since the start; written by the writer's thread, read by any.

    Attributes:
        bytes: of members written, both files.
        frames, ticks: recorded.
        gaps, frames_lost, ticks_lost: told in the recordings.
        syncs, sync_failures: calls of fdatasync for one segment.
        last_sync_s: how long the latest took; None before it.
    """

    bytes: int = 0
    frames: int = 0
    ticks: int = 0
    gaps: int = 0
    frames_lost: int = 0
    ticks_lost: int = 0
    syncs: int = 0
    sync_failures: int = 0
    last_sync_s: float | None = None
    _sync_times: deque[tuple[float, float]] = field(default_factory=deque)

    def lost(self, frames: int, ticks: int) -> None:
        self.gaps += 1
        self.frames_lost += frames
        self.ticks_lost += ticks

    def synced(self, took_s: float) -> None:
        now_s = time.monotonic()
        self.syncs += 1
        self.last_sync_s = took_s
        times = self._sync_times
        times.append((now_s, took_s))
        while times[0][0] < now_s - _MINUTE_S:
            times.popleft()

    @property
    def longest_sync_s(self) -> float | None:
        """The longest of the last minute before the latest; None before the first."""
        times = list(self._sync_times)
        return max((took_s for _, took_s in times), default=None)
