"""A drive decided again: in open loop as recorded, in closed loop with a simulated vehicle.

Open loop: the recorded inputs given to a core with another configuration.

The recorded vehicle does not react: from the first differing command on, what it answered is what
it answered to the recorded one. Its echoes of throttle and direction are held against the recorded
commands.

Closed loop: the simulated vehicle answers, and the recorded demands drive.

Requests, demands and ticks come when they were recorded; every frame comes from the simulator. It
knows nothing of what was wrong with the recorded vehicle. Frames of pedals on CAN are the driver's.
"""

import json
from collections.abc import Sequence

from vcu_gateway import simulator
from vcu_gateway.core import calls
from vcu_gateway.core.codec import Codec, MessageCodec
from vcu_gateway.core.demand import ControllerDemands, RequestResult
from vcu_gateway.core.gateway import CoreCall, Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.recording import checkpoint
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    CoreRecord,
    FrameRun,
    Gap,
    InputRecord,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.replay.commands import CommandSeries, RecordedCommands, send
from vcu_gateway.replay.curve_use import CurveUses
from vcu_gateway.replay.what_if import WhatIf

REQUESTS: dict[type, str] = {
    calls.Offer: "demand",
    calls.EndDemand: "end demand",
    calls.Arm: "arm",
    calls.Disarm: "disarm",
    calls.Reset: "reset",
    calls.SetDriveMode: "drive mode",
    calls.EmergencyStop: "estop",
}


class OpenLoop:
    """Recorded inputs, replayed with one configuration for the whole drive.

    Attributes:
        what_if: the recorded results beside the replayed ones.
        reloads: times of recorded reloads, which were left out.
        gaps: places where the replay began anew with the recorded state.
        curves: where the drive was on each curve; None before its first checkpoint.
    """

    def __init__(
        self, codec: Codec, settings: Settings, series: CommandSeries | None = None
    ) -> None:
        self.what_if = WhatIf(codec, series)
        self.reloads: list[int] = []
        self.gaps: list[tuple[int, Gap]] = []
        self.curves: CurveUses | None = None
        self._codec = codec
        self._settings = settings
        self._told = RecordedCommands(codec)
        self._gateway: Gateway | None = None
        self._frames: dict[str, OutFrame] = {}
        self._stopped_before = False
        self._now_ns = 0

    def note(self, record: FrameRun | CoreRecord) -> None:
        gateway = self._gateway
        if gateway is None:
            if isinstance(record, Checkpoint):
                self._begin(record)
        elif isinstance(record, FrameRun):
            receive = gateway.receive
            for frame in record.frames:
                receive(frame)
        elif isinstance(record, Gap):
            self._gap(record)
        else:
            self._replay(gateway, record)

    def _replay(self, gateway: Gateway, record: CoreRecord) -> None:
        if isinstance(record, InputRecord):
            self._input(gateway, record.input, record.answer)
        elif isinstance(record, TickRecord):
            self._tick(gateway, record)
        elif isinstance(record, WhyRecord):
            self._explain(record)

    def _begin(self, record: Checkpoint) -> None:
        gateway = self._gateway = begun(record, self._codec, self._settings)
        held = gateway.causes.held
        self.curves = self.curves or CurveUses(record.settings, self._settings)
        self.what_if.begin(held, held, record.mode, record.now_ns)

    def _input(
        self, gateway: Gateway, one: CoreCall[object], recorded: RequestResult | None
    ) -> None:
        if isinstance(one, calls.NoteSent):
            self._sent(gateway, one)
            return
        if isinstance(one, calls.ReloadSettings):
            self.reloads.append(self._now_ns)
            return
        if isinstance(one, calls.RunTick):  # it ended the gateway's process by a bug
            self._gateway = None
            return
        answer = one.apply(gateway)
        if recorded is not None and isinstance(answer, RequestResult):
            now_ns = getattr(one, "now_ns", self._now_ns)
            self.what_if.answer(now_ns, REQUESTS[type(one)], recorded, answer)

    def _sent(self, gateway: Gateway, one: calls.NoteSent) -> None:
        """Ours went as the recorded one did; the controller was told the recorded one."""
        frame, recorded = self._frames.get(one.frame.controller), one.frame
        if frame is not None:
            gateway.sent(frame, one.ok, one.now_ns)
        if one.ok and (frame is None or frame.data != recorded.data):
            keep = self._told.add if frame is None else self._told.put
            keep(gateway, recorded.controller, recorded.data, one.now_ns)

    def _tick(self, gateway: Gateway, record: TickRecord) -> None:
        now_ns = self._now_ns = record.now_ns
        mode = gateway.mode
        result = gateway.tick(now_ns)
        if self.curves is not None:
            self.curves.tick(result.snapshot, mode)
        self._frames = {frame.controller: frame for frame in result.frames}
        if len(record.frames) != len(result.frames):
            recorded = {frame.controller for frame in record.frames}
            send(gateway, [one for one in result.frames if one.controller not in recorded], now_ns)
        was_left, is_left = self.what_if.tick(now_ns, record, result)
        self._stopped_before = self._stopped_before or was_left
        if is_left:
            self.what_if.after.explain_stop(gateway.why(now_ns).sentence())

    def _explain(self, record: WhyRecord) -> None:
        if self._stopped_before:
            self._stopped_before = False
            self.what_if.before.explain_stop(record.sentence)

    def _gap(self, record: Gap) -> None:
        self.gaps.append((self._now_ns, record))
        self.what_if.gap(self._now_ns)
        self._gateway = None


def begun(record: Checkpoint, codec: Codec, settings: Settings) -> Gateway:
    """A core in the recorded state with these settings; a new one where nothing had happened yet.

    What the settings give at the start, such as a bench demand, is part of a recorded state.
    """
    gateway = checkpoint.restore(record.state, codec, settings)
    if record.ticks:
        return gateway
    start_ns = gateway.supervisor.since_ns
    untouched = checkpoint.state_of(Gateway(codec, record.settings, start_ns))
    if json.loads(json.dumps(untouched)) != record.state:
        return gateway
    return Gateway(codec, settings, start_ns)


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
        self.vehicle = self._nodes.vehicle
        self._find = codec.find
        self._pedals = None if settings.pedals is None else settings.pedals.message

    def move_pedals(self, frames: Sequence[Frame]) -> None:
        """The driver's feet, where they are on CAN; of all recorded frames those alone count."""
        for frame in frames if self._pedals is not None else ():
            found = self._find(frame)
            if isinstance(found, MessageCodec) and found.spec.name == self._pedals:
                self.gateway.receive(frame)

    def tick(self, now_ns: int) -> TickResult:
        """Let the vehicle go on until now, and decide."""
        nodes, receive = self._nodes, self.gateway.receive
        while (due_ns := nodes.next_due_ns()) <= now_ns:
            for one in nodes.due(due_ns):
                if one.message != self._pedals:
                    receive(Frame(one.can_id, one.data, due_ns))
        result = self.gateway.tick(now_ns)
        if self._pedals is not None and (demanded := self.gateway.requests.demanded(now_ns)):
            self.press_brake(demanded)
        send(self.gateway, result.frames, now_ns)
        for frame in result.frames:
            nodes.receive(frame.can_id, frame.data, now_ns)
        return result

    def press_brake(self, demanded: ControllerDemands) -> None:
        """The driver's foot: the friction brake follows it, whatever the command leaves of it."""
        self.vehicle.brake_pedal_pct = max(one.brake_pct for one in demanded.values())


class ClosedLoop:
    """Recorded requests given to two cores, each with a simulated vehicle of its own.

    One has the recorded settings, the other those that are given.

    Attributes:
        what_if: the recorded configuration beside the given one.
        reloads: how many recorded reloads were left out.
        speeds_km_h: highest speed of the vehicle, before and after.
        distances_m: distance driven, before and after.
    """

    def __init__(self, codec: Codec, settings: Settings, series: CommandSeries | None) -> None:
        self.what_if = WhatIf(codec, series)
        self.reloads = 0
        self.speeds_km_h = [0.0, 0.0]
        self.distances_m = [0.0, 0.0]
        self._codec = codec
        self._settings = settings
        self._loops: list[_Loop] = []
        self._now_ns = 0

    def note(self, record: FrameRun | CoreRecord) -> None:
        if not self._loops:
            if isinstance(record, Checkpoint):
                self._begin(record)
        elif isinstance(record, FrameRun):
            for loop in self._loops:
                loop.move_pedals(record.frames)
        elif isinstance(record, InputRecord):
            self._input(record.input)
        elif isinstance(record, TickRecord):
            self._tick(record.now_ns)
        elif isinstance(record, Gap):
            self.what_if.gap(self._now_ns)
            self._loops = []

    def _begin(self, record: Checkpoint) -> None:
        both = record.settings, self._settings
        self._loops = [_Loop(self._codec, record, settings) for settings in both]
        held = [loop.gateway.causes.held for loop in self._loops]
        self.what_if.begin(held[0], held[1], record.mode, record.now_ns)
        self._now_ns = record.now_ns

    def _input(self, one: CoreCall[object]) -> None:
        if isinstance(one, _LEFT_OUT):
            self.reloads += isinstance(one, calls.ReloadSettings)
            return
        if isinstance(one, calls.Offer):
            for loop in self._loops:
                loop.press_brake(one.demand.controllers)
        before, after = [one.apply(loop.gateway) for loop in self._loops]
        if isinstance(before, RequestResult) and isinstance(after, RequestResult):
            now_ns = getattr(one, "now_ns", self._now_ns)
            self.what_if.answer(now_ns, REQUESTS[type(one)], before, after)

    def _tick(self, now_ns: int) -> None:
        results = [loop.tick(now_ns) for loop in self._loops]
        self.what_if.decided(now_ns, results, [loop.gateway for loop in self._loops])
        elapsed_s = (now_ns - self._now_ns) / 1e9
        for side, loop in enumerate(self._loops):
            speed_m_s = abs(loop.vehicle.speed_m_s)
            self.speeds_km_h[side] = max(self.speeds_km_h[side], speed_m_s * 3.6)
            self.distances_m[side] += speed_m_s * elapsed_s
        self._now_ns = now_ns
