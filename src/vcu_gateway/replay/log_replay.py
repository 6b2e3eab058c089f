"""Replay of a log of the bus: its frames, and ticks on a grid of 50 ms.

A log holds frames alone: no demand, no request, no tick. So nobody arms here, and what is decided
is what this program would decide with these frames, not what anything did decide.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from vcu_gateway.core import j1939
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, PowerMode
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.recording.candump import RecordedFrame
from vcu_gateway.recording.log import open_recording
from vcu_gateway.replay import report
from vcu_gateway.replay.commands import CommandSeries, RecordedCommands, send
from vcu_gateway.replay.configuration import Changes
from vcu_gateway.replay.report import ReplayReport, TimeOfDay
from vcu_gateway.replay.what_if import WhatIf
from vcu_gateway.text import Progress, counted
from vcu_gateway.time_window import Window

_LONGEST_PAUSE_NS = 60_000_000_000
_MOST_PAUSES = 10
_DECISIONS = (
    "a log of the bus holds frames alone: these are decisions on them, with a tick every 50 ms from"
    " the first frame on, and no more; nobody recorded when the ticks really were, so no reaction"
    " time is judged"
)
_NO_DEMAND = (
    "no demand is known, so nobody arms: modes up to standby, causes, and what would have stopped"
    " a drive (--demand 30 holds a throttle)"
)


def replay_log(
    name: str,
    changes: Changes,
    window: Window,
    demand_pct: float | None,
    plotted: bool,
    progress: Progress,
    complain: Callable[[Problem], None],
) -> ReplayReport:
    """Decide on every frame of a log, of standard input where the name is "-".

    A configuration of the changes counts for all of it, or every default; assignments ask what if.
    `demand_pct`: hold this throttle. `complain` is given what cannot be read. MissingInputError,
    DataError, ConfigError.
    """
    before, after, codec, without_effect = _settings(changes, demand_pct)
    series = CommandSeries(codec) if plotted else None
    replay, clock = LogReplay(codec, before, after, series), TimeOfDay(0)
    with open_recording(name, complain) as recording:
        recorded = recording.watched(progress)
        replay.run(one for one in recorded if window.holds(one.frame.arrival_ns))
        unreadable = recording.problems.unreadable
    if not replay.frames:
        what, remedy = "holds no frame that can be read", "it is empty"
        if not window.open:
            what, remedy = "has nothing of that time that can be read", "all times are UTC"
        raise DataError(Problem(what, name, remedy))
    result = replay.what_if.result()
    notes = [*_notes(replay, demand_pct, unreadable, clock), *without_effect]
    lines = [
        f"{name}: {counted(replay.frames, 'frame')}, {counted(result.ticks, 'tick')}",
        *(*notes, ""),
    ]
    values: dict[str, Any] = {
        "recording": name,
        "frames": replay.frames,
        "ticks": result.ticks,
        "notes": notes,
        "decisions": report.values_of(result.after, clock),
    }
    if after is None:
        lines += report.decision_lines(result.after, clock)
        lines.append(f"at the end: {replay.sentence}")
        values["why"] = replay.sentence
    else:
        lines.append(f"what if: {', '.join(changes.assignments)}")
        lines += report.what_if_lines(result, clock)
        values["what_if"] = {"same": result.same, **report.values_of(result, clock)}
    overlay = report.overlay_of(result, clock, notes, series)
    return ReplayReport(name, lines, values, overlay, 0 if result.same else 1)


def _settings(
    changes: Changes, demand_pct: float | None
) -> tuple[Settings, Settings | None, Codec, tuple[str, ...]]:
    """Both configurations, the second None where no key is set; the codec; what has no effect."""
    protocol = dbc.load(packaged("vcu.dbc"))
    used = first = changes._replace(assignments=()).configuration(None, "defaults", protocol)
    after: Settings | None = None
    without_effect: tuple[str, ...] = ()
    if changes.assignments:
        used = changes.configuration(None, "defaults", protocol)
        after, without_effect = _holding(used.settings, demand_pct), used.without_effect
    codec = Codec(dbc.with_aliases(protocol, used.aliases))
    return _holding(first.settings, demand_pct), after, codec, without_effect


def _holding(settings: Settings, throttle_pct: float | None) -> Settings:
    """With a demand that never ends, armed by itself; None: as they are."""
    if throttle_pct is None:
        return settings
    demand = ControllerDemand(throttle_pct=throttle_pct, power_mode=PowerMode.NORMAL)
    return dataclasses.replace(settings, bench_demand=demand, auto_arm=True)


def _notes(
    replay: "LogReplay", demand_pct: float | None, unreadable: int, clock: TimeOfDay
) -> Iterator[str]:
    yield _DECISIONS
    if demand_pct is None:
        yield _NO_DEMAND
    else:
        yield (
            f"a throttle of {demand_pct:g} % is held from standby on, armed once; the recorded"
            " vehicle does not react to it"
        )
    if replay.commands:
        yield (
            f"{replay.commands:,} recorded commands of a gateway count as what the controllers were"
            " told; they are not compared"
        )
    if unreadable:
        yield f"{unreadable:,} lines or frames could not be read"
    if replay.backwards:
        yield f"{replay.backwards:,} frames are stamped before the frame in front of them"
    for began_ns, ended_ns in replay.pauses[:_MOST_PAUSES]:
        yield (
            f"not replayed: from {clock.clock(began_ns)} to {clock.clock(ended_ns)} there is no"
            " frame; everything begins anew"
        )


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
        series: CommandSeries | None,
    ) -> None:
        self.what_if = WhatIf(codec, series)
        self.frames = self.commands = self.backwards = 0
        self.pauses: list[tuple[int, int]] = []
        self._codec = codec
        self._told = RecordedCommands(codec)
        self._settings = (before,) if after is None else (before, after)
        self._period_ns = before.period_ns
        self._own = {codec.by_name[message_name(name)].spec.can_id: name for name in CONTROLLERS}
        self._own = {j1939.match_key(can_id): name for can_id, name in self._own.items()}
        self._cores: list[Gateway] = []
        self._next_ns = 0
        self._last_ns = 0

    def run(self, recorded: Iterable[RecordedFrame]) -> None:
        for one in recorded:
            self._take(one.frame)
        if self._cores:
            self._tick_until(self._last_ns + self._period_ns)

    def _take(self, frame: Frame) -> None:
        self.frames += 1
        at_ns = frame.arrival_ns
        if not self._cores:
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
            for core in self._cores:
                core.receive(frame)
            return
        self.commands += 1
        for core in self._cores:
            self._told.add(core, controller, frame.data, at_ns)

    def _begin(self, at_ns: int) -> None:
        self._cores = [Gateway(self._codec, settings, at_ns) for settings in self._settings]
        for core in self._cores:
            core.link_opened(LinkStatus(LinkState.UP, at_ns), None, at_ns)
        self._next_ns, self._last_ns = at_ns + self._period_ns, at_ns
        self.what_if.begin((), (), self._cores[0].mode, at_ns)

    def _tick_until(self, at_ns: int) -> None:
        while self._next_ns <= at_ns:
            now_ns = self._next_ns
            results = [core.tick(now_ns) for core in self._cores]
            for core, result in zip(self._cores, results, strict=True):
                send(core, result.frames, now_ns)
            self.what_if.decided(now_ns, results, self._cores)
            self._next_ns += self._period_ns

    @property
    def sentence(self) -> str:
        """The answer of `why` at the end, of the last configuration."""
        return self._cores[-1].why(self._next_ns - self._period_ns).sentence()
