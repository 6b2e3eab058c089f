"""Closed loop: the simulated vehicle answers, and the recorded demands drive.

Requests, demands and ticks come when they were recorded; every frame comes from the simulator. It
knows nothing of what was wrong with the recorded vehicle.
"""

from vcu_gateway import simulator
from vcu_gateway.core import calls
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.gateway import CoreCall, Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    CoreRecord,
    FrameRun,
    Gap,
    InputRecord,
    TickRecord,
)
from vcu_gateway.replay.commands import CommandSeries
from vcu_gateway.replay.open_loop import REQUESTS, begun
from vcu_gateway.replay.what_if import WhatIf

_LEFT_OUT = (
    calls.NoteSent,
    calls.ReloadSettings,
    calls.LoseLink,
    calls.OpenLink,
    calls.ChangeCarrier,
    calls.RunTick,  # it ended the gateway's process by a bug
)


class _Loop:
    """A core and a simulated vehicle that obeys it."""

    def __init__(self, codec: Codec, record: Checkpoint, settings: Settings) -> None:
        self.gateway: Gateway = begun(record, codec, settings)
        self._nodes = simulator.build(codec, record.now_ns)

    def tick(self, now_ns: int) -> TickResult:
        """Let the vehicle go on until now, and decide."""
        nodes, receive = self._nodes, self.gateway.receive
        while (due_ns := nodes.next_due_ns()) <= now_ns:
            for one in nodes.due(due_ns):
                receive(Frame(one.can_id, one.data, due_ns))
        result = self.gateway.tick(now_ns)
        for frame in result.frames:
            self.gateway.sent(frame, True, now_ns)
            nodes.receive(frame.can_id, frame.data, now_ns)
            receive(Frame(frame.can_id, frame.data, now_ns, own_echo=True))
        return result

    @property
    def speed_m_s(self) -> float:
        """Of the vehicle, positive forwards."""
        return self._nodes.vehicle.speed_m_s


class ClosedLoop:
    """Recorded requests given to two cores, each with a simulated vehicle of its own.

    Attributes:
        what_if: the recorded configuration beside the given one.
        reloads: how many recorded reloads were left out.
        speeds_km_h: highest speed of the vehicle, before and after.
        distances_m: distance driven, before and after.
    """

    def __init__(
        self,
        codec: Codec,
        before: Settings | None,
        after: Settings,
        series: CommandSeries | None = None,
    ) -> None:
        self.what_if = WhatIf(codec)
        self.reloads = 0
        self.speeds_km_h = [0.0, 0.0]
        self.distances_m = [0.0, 0.0]
        self._codec = codec
        self._given = (before, after)
        self._series = series
        self._loops: list[_Loop] = []
        self._now_ns = 0

    def note(self, record: FrameRun | CoreRecord) -> None:
        if not self._loops:
            if isinstance(record, Checkpoint):
                self._begin(record)
        elif isinstance(record, InputRecord):
            self._input(record.input)
        elif isinstance(record, TickRecord):
            self._tick(record.now_ns)
        elif isinstance(record, Gap):
            self.what_if.gap(self._now_ns)
            self._loops = []

    def _begin(self, record: Checkpoint) -> None:
        settings = [record.settings if one is None else one for one in self._given]
        self._loops = [_Loop(self._codec, record, one) for one in settings]
        held = [loop.gateway.causes.held for loop in self._loops]
        self.what_if.begin(held[0], held[1], record.mode, record.now_ns)
        self._now_ns = record.now_ns

    def _input(self, one: CoreCall[object]) -> None:
        if isinstance(one, _LEFT_OUT):
            self.reloads += isinstance(one, calls.ReloadSettings)
            return
        answers = [one.apply(loop.gateway) for loop in self._loops]
        before, after = answers
        if isinstance(before, RequestResult) and isinstance(after, RequestResult):
            now_ns = getattr(one, "now_ns", self._now_ns)
            self.what_if.answer(now_ns, REQUESTS[type(one)], before, after)

    def _tick(self, now_ns: int) -> None:
        results = [loop.tick(now_ns) for loop in self._loops]
        left = self.what_if.tick(now_ns, *results)
        timelines = (self.what_if.before, self.what_if.after)
        for ended, timeline, loop in zip(left, timelines, self._loops, strict=True):
            if ended:
                timeline.explain_stop(loop.gateway.why(now_ns).sentence())
        elapsed_s = (now_ns - self._now_ns) / 1e9
        for side, loop in enumerate(self._loops):
            speed_m_s = abs(loop.speed_m_s)
            self.speeds_km_h[side] = max(self.speeds_km_h[side], speed_m_s * 3.6)
            self.distances_m[side] += speed_m_s * elapsed_s
        self._now_ns = now_ns
        if self._series is not None:
            self._series.add(now_ns, results[1].frames)
