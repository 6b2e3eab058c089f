"""Frame pairs: both frames in every tick, none while listening before talking."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from vcu_gateway.replay.verdict.limits import VerdictLimits
from vcu_gateway.replay.verdict.wire import CONTROLLERS, MS, REVERSE

_LENGTH = 8


class SentFrame(NamedTuple):
    """A command frame of one tick, and whether the bus took it."""

    can_id: int
    data: bytes
    left: bool


SentFrames = Mapping[str, SentFrame]
"""Frames of a tick, by controller."""


class FramePairs:
    """Listening time and pairs, from tick to tick; `complete`: from the gateway's start on."""

    def __init__(self, *, complete: bool) -> None:
        self._complete = complete
        self._talking = False
        self._quiet_until_ns: int | None = None

    def listen(self, limits: VerdictLimits, now_ns: int) -> None:
        """The listening time begins."""
        self._quiet_until_ns = now_ns + round(limits.listen_before_talk_ms * MS)

    def broken(
        self, sent: SentFrames, limits: VerdictLimits, now_ns: int, *, disturbed: bool
    ) -> Iterator[tuple[str, str]]:
        """Rules that the frames of a tick break together; `disturbed`: it has to listen again."""
        if disturbed and not self._talking:
            self.listen(limits, now_ns)
        listening = self._quiet_until_ns is not None and now_ns < self._quiet_until_ns
        if len(sent) not in (0, len(CONTROLLERS)) or (not sent and self._talking):
            yield "I13 both frames in every tick", f"{len(sent)} frames"
        if sent and not self._talking and listening and self._complete:
            yield "listening before talking", "a frame while it has to listen"
        self._talking = self._talking or bool(sent)
        if not limits.independent_directions and _two_directions(sent):
            yield "gate directions", "throttle with two directions"


def _two_directions(sent: SentFrames) -> bool:
    """True where one turns forwards and one in reverse, with throttle."""
    whole = [one.data for one in sent.values() if len(one.data) == _LENGTH]
    return len({data[0] & REVERSE for data in whole}) > 1 and any(data[1] for data in whole)
