"""Records of a foreign recording: its frames, and ticks on a grid of 50 ms.

A log of the bus holds frames alone: no demand, no request, no tick. So nobody arms here, and what
is decided is what this program would decide with these frames, not what anything did decide.
"""

from collections.abc import Iterable, Iterator

from vcu_gateway.core import j1939
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.recording.recorded import RecordedFrame
from vcu_gateway.replay.commands import CommandSeries, RecordedCommands
from vcu_gateway.replay.what_if import WhatIf

_LONGEST_PAUSE_NS = 60_000_000_000


class _Side:
    """A core that decides with one configuration."""

    def __init__(self, codec: Codec, settings: Settings, begin_ns: int) -> None:
        self.gateway = Gateway(codec, settings, begin_ns)
        self.gateway.link_opened(LinkStatus(LinkState.UP, begin_ns), None, begin_ns)

    def send(self, frames: tuple[OutFrame, ...], now_ns: int) -> None:
        """The bus takes the frames, and they come back."""
        for frame in frames:
            self.gateway.sent(frame, True, now_ns)
            self.gateway.receive(Frame(frame.can_id, frame.data, now_ns, own_echo=True))


class LogReplay:
    """Decisions of two configurations on the frames of a log; they may be the same one.

    Attributes:
        what_if: both sides; frames, commands: how many the log has.
        pauses: stretches of more than a minute without a frame, which were left out.
        backwards: frames stamped earlier than the one before.
    """

    def __init__(
        self,
        codec: Codec,
        before: Settings,
        after: Settings | None,
        series: CommandSeries | None = None,
    ) -> None:
        self.what_if = WhatIf(codec)
        self.frames = self.commands = self.backwards = 0
        self.pauses: list[tuple[int, int]] = []
        self._codec = codec
        self._series = series
        self._told = RecordedCommands(codec)
        self._settings = (before,) if after is None else (before, after)
        self._period_ns = before.period_ns
        self._own = {codec.by_name[message_name(name)].spec.can_id: name for name in CONTROLLERS}
        self._own = {j1939.match_key(can_id): name for can_id, name in self._own.items()}
        self._sides: list[_Side] = []
        self._next_ns = 0
        self._last_ns = 0

    def run(self, recorded: Iterable[RecordedFrame]) -> Iterator[None]:
        """Replay every frame; yields after each, for progress."""
        for one in recorded:
            self._take(one.frame)
            yield
        if self._sides:
            self._tick_until(self._last_ns + self._period_ns)

    def _take(self, frame: Frame) -> None:
        self.frames += 1
        at_ns = frame.arrival_ns
        if not self._sides:
            self._begin(at_ns)
        elif at_ns - self._last_ns > _LONGEST_PAUSE_NS:
            self.pauses.append((self._last_ns, at_ns))
            self.what_if.gap(self._next_ns)
            self._begin(at_ns)
        self.backwards += at_ns < self._last_ns
        self._tick_until(at_ns)
        self._last_ns = max(at_ns, self._last_ns)
        controller = self._own.get(j1939.match_key(frame.can_id)) if frame.extended else None
        if controller is None or frame.error or len(frame.data) != 8:
            for side in self._sides:
                side.gateway.receive(frame)
            return
        self.commands += 1
        for side in self._sides:
            self._told.add(side.gateway, controller, frame.data, at_ns)

    def _begin(self, at_ns: int) -> None:
        self._sides = [_Side(self._codec, settings, at_ns) for settings in self._settings]
        self._next_ns, self._last_ns = at_ns + self._period_ns, at_ns
        mode = self._sides[0].gateway.mode
        self.what_if.begin((), (), mode, at_ns)

    def _tick_until(self, at_ns: int) -> None:
        while self._next_ns <= at_ns:
            now_ns = self._next_ns
            results = [side.gateway.tick(now_ns) for side in self._sides]
            for side, result in zip(self._sides, results, strict=True):
                side.send(result.frames, now_ns)
            left = self.what_if.tick(now_ns, results[0], results[-1])
            self._explain(left, now_ns)
            if self._series is not None:
                self._series.add(now_ns, results[-1].frames)
            self._next_ns += self._period_ns

    def _explain(self, left: tuple[bool, bool], now_ns: int) -> None:
        for ended, timeline, side in (
            (left[0], self.what_if.before, self._sides[0]),
            (left[1], self.what_if.after, self._sides[-1]),
        ):
            if ended:
                timeline.explain_stop(side.gateway.why(now_ns).sentence())

    @property
    def sentence(self) -> str:
        """The answer of `why` at the end, of the last configuration."""
        return self._sides[-1].gateway.why(self._next_ns - self._period_ns).sentence()
