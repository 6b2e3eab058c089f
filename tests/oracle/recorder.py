"""Everything on vcan0 with the kernel's stamps, read when somebody looks."""

import math
import struct
import time
from collections.abc import Iterator
from typing import NamedTuple

from tests.oracle import wire
from tests.oracle.wire import Command

# The vehicle beats every 10 ms. Beyond these its machine was slow, and stood still.
SLOW_S, STALL_S = 0.016, 0.030
_QUIET = {wire.IDENTIFIERS["IMU_Acceleration"], wire.IDENTIFIERS["IMU_AngularRate"]}


class Frame(NamedTuple):
    t: float  # the kernel's stamp, as time.monotonic() tells it
    can_id: int
    data: bytes

    @property
    def command(self) -> Command:
        return Command.of(self.data)


class Recorder:
    def __init__(self) -> None:
        self.bus = wire.open_recorder()
        self.frames: list[Frame] = []  # of all but the inertial unit and the beat
        self.commands: list[Frame] = []  # the gateway's
        self.last: dict[int, float] = {}
        self.stalls: list[tuple[float, float]] = []
        self.offset = time.time() - time.monotonic()

    def drain(self) -> list[Frame]:
        """Read what waits; the frames that are new, in order."""
        fresh = list(self._waiting())
        for frame in fresh:
            self._take(frame)
        return fresh

    def _waiting(self) -> Iterator[Frame]:
        while True:
            try:
                packed, ancillary, _, _ = self.bus.recvmsg(16, 64)
            except BlockingIOError:
                return
            except OSError:
                continue  # the interface was down: told once
            seconds, nanoseconds = struct.unpack("qq", ancillary[0][2])
            can_id, data = wire.unpacked(packed)
            yield Frame(seconds + nanoseconds / 1e9 - self.offset, can_id, data)

    def _take(self, frame: Frame) -> None:
        before = self.last.get(frame.can_id, frame.t)
        self.last[frame.can_id] = frame.t
        if frame.can_id == wire.BEAT:
            if frame.t - before > SLOW_S:
                self.stalls.append((before, frame.t))
        elif frame.can_id not in _QUIET:
            self.frames.append(frame)
            if self.is_gateways(frame):
                self.commands.append(frame)

    @staticmethod
    def is_gateways(frame: Frame) -> bool:
        return frame.can_id in wire.COMMANDS and frame.data[3:4] != bytes([wire.INTRUDER_MARK])

    def forget(self) -> None:
        """Keep the latest minute: a long list would cost the tests' process its pauses."""
        since = time.monotonic() - 60.0
        self.frames = self._since(self.frames, since)
        self.commands = self._since(self.commands, since)
        del self.stalls[:-200]

    def of(self, name: str, since: float = 0.0) -> list[Frame]:
        wanted = wire.IDENTIFIERS[name]
        return [f for f in self._since(self.frames, since) if f.can_id == wanted]

    def intruders(self, since: float) -> list[Frame]:
        """Commands that the vehicle's intruder sent."""
        marked = bytes([wire.INTRUDER_MARK])
        return [f for f in self._since(self.frames, since) if f.data[3:4] == marked]

    def errors(self, since: float) -> list[Frame]:
        return [f for f in self._since(self.frames, since) if f.can_id < 0]

    def commands_since(self, t: float) -> list[Frame]:
        return self._since(self.commands, t)

    @staticmethod
    def _since(frames: list[Frame], t: float) -> list[Frame]:
        low = len(frames)
        while low and frames[low - 1].t >= t:
            low -= 1
        return frames[low:]

    def stalled(self, since: float, until: float = math.inf, for_s: float = STALL_S) -> bool:
        return any(
            end > since and began < until and end - began > for_s for began, end in self.stalls
        )

    def reopen(self) -> None:
        self.bus.close()
        self.bus = wire.open_recorder()
