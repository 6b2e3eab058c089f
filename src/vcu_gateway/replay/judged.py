"""Records of a drive, handed to the verdict's judge as plain values.

The verdict shares nothing with the core; this module is where both meet.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from vcu_gateway.core import inputs
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.inputs import CoreInput
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.drive.records import Checkpoint, CoreRecord, FrameRun, Gap, InputRecord, TickRecord
from vcu_gateway.judge import (
    DriveVerdict,
    Findings,
    GrantedDemand,
    Judge,
    JudgedDemand,
    SentFrame,
    VerdictLimits,
)

_NOT_JUDGED = (
    "I5, I7, I8, I9, I14 and I15 do not show in a recording",
    "causes that only raise an alarm are judged by what they must not do",
)


def limits_of(settings: Settings, aliases: Mapping[int, str]) -> VerdictLimits:
    """The configured values that the verdict uses."""
    names = {one.name for one in dataclasses.fields(VerdictLimits)}
    names &= {one.name for one in dataclasses.fields(settings)}
    values: dict[str, Any] = {name: getattr(settings, name) for name in names}
    bench = settings.bench_demand
    values["bench_demand"] = (
        None if bench is None else dict.fromkeys(CONTROLLERS, _demand_of(bench))
    )
    return VerdictLimits(**values, period_ms=settings.period_ns / 1e6, aliases=aliases)


def _demand_of(one: ControllerDemand) -> JudgedDemand:
    return JudgedDemand(
        float(one.throttle_pct),
        float(one.brake_pct),
        one.power_mode.value,
        one.motor_reverse,
        one.regen_brake,
        float(one.speed_limit_rpm),
        float(one.power_limit_w),
        None if one.throttle_track2_pct is None else float(one.throttle_track2_pct),
    )


class JudgedRecords:
    """Judgement of records in their order; a gap or an end begins a new stretch.

    Attributes:
        findings: violations and reaction times so far.
    """

    def __init__(self, settings: Settings, aliases: Mapping[int, str]) -> None:
        self.findings = Findings()
        self._aliases = aliases
        self._settings = settings
        self._judge: Judge | None = None
        self._pending: tuple[int, str] | None = None
        self._sent: dict[str, SentFrame] = {}
        self._unknown: set[str] = set()
        self._between: list[Frame] = []
        self._counts = {"frames": 0, "ticks": 0, "commands": 0, "torque": 0}
        self._last_ns: int | None = None
        self._widest_ns = 0

    def begin(self, settings: Settings, tick: int) -> Judge:
        """A stretch begins, with the gateway's start where `tick` is 0."""
        self.end()
        limits = limits_of(settings, self._aliases)
        judge = Judge(limits, self.findings, complete=tick == 0, tick=tick)
        if settings.auto_arm and settings.bench_demand is not None:
            judge.requests.bench()
        self._judge, self._last_ns = judge, None
        return judge

    def frames(self, frames: list[Frame]) -> None:
        """Take in frames in their order."""
        if self._unknown:
            self._between += frames  # they came between the sending of both frames
            return
        self._counts["frames"] += len(frames)
        self._ready().frames(frames)

    def note(self, record: FrameRun | CoreRecord) -> None:
        """Take in a record."""
        if isinstance(record, FrameRun):
            self.frames(record.frames)
        elif isinstance(record, TickRecord):
            self._begin_tick(record)
        elif isinstance(record, InputRecord):
            self._input(record)
        elif isinstance(record, Checkpoint):
            if self._judge is None:
                self.begin(record.settings, record.ticks)
        elif isinstance(record, Gap):
            self.end()

    def _ready(self) -> Judge:
        """The judge, with the last tick's frames handed over."""
        judge = self._judge or self.begin(self._settings, 0)
        if self._pending is not None:
            self._finish_tick(judge, *self._pending)
        return judge

    def _begin_tick(self, record: TickRecord) -> None:
        self._ready()
        self._pending = (record.now_ns, record.mode.value)
        self._sent = {
            frame.controller: SentFrame(frame.can_id, bytes(frame.data), False)
            for frame in record.frames
        }
        self._unknown = set(self._sent)

    def _finish_tick(self, judge: Judge, now_ns: int, mode: str) -> None:
        self._pending, counts = None, self._counts
        counts["ticks"] += 1
        counts["commands"] += len(self._sent)
        counts["torque"] += sum(any(one.data[1:3]) for one in self._sent.values())
        if self._last_ns is not None:
            self._widest_ns = max(self._widest_ns, now_ns - self._last_ns)
        self._last_ns = now_ns
        judge.tick(now_ns, mode, self._sent)
        between, self._between = self._between, []
        self._unknown.clear()
        if between:
            self.frames(between)

    def _input(self, record: InputRecord) -> None:
        one = record.input
        if isinstance(one, inputs.FrameInput):
            self.frames([one.frame])
        elif isinstance(one, inputs.SentInput):
            name = one.frame.controller
            self._sent[name] = self._sent[name]._replace(left=one.ok)
            self._unknown.discard(name)
        else:
            judge = self._ready()
            granted = record.answer is None or record.answer.granted
            if tell := _TOLD.get(type(one)):
                tell(judge, one, granted)
            elif granted and isinstance(one, inputs.ReloadInput):
                judge.reload(limits_of(one.settings, self._aliases))

    def end(self) -> None:
        """The stretch is over."""
        if self._judge is not None:
            self._ready().end()
        self._judge = None

    def verdict(self) -> DriveVerdict:
        """What was found so far."""
        self.end()
        counts = self._counts
        return DriveVerdict(
            ticks=counts["ticks"],
            commands=counts["commands"],
            frames=counts["frames"],
            with_torque=counts["torque"],
            latest_tick_ms=self._widest_ns / 1e6,
            counts=dict(self.findings.counts),
            violations=tuple(self.findings.kept),
            reactions=self.findings.reactions,
            not_judged=_NOT_JUDGED,
        )


def _offered(judge: Judge, one: inputs.OfferInput, granted: bool) -> None:
    judge.offered(one.now_ns)
    if granted:
        demand = one.demand
        controllers = {name: _demand_of(each) for name, each in demand.controllers.items()}
        made_ns = one.now_ns if demand.made_ns is None else demand.made_ns
        judge.demand(GrantedDemand(demand.source, controllers, made_ns, demand.ttl_ms), one.now_ns)


def _ended(judge: Judge, one: inputs.EndDemandInput, granted: bool) -> None:
    del one
    if granted:
        judge.end_demand()


def _armed(judge: Judge, one: inputs.ArmInput, granted: bool) -> None:
    if granted:
        judge.armed(one.now_ns)


def _disarmed(judge: Judge, one: inputs.DisarmInput, granted: bool) -> None:
    del one, granted
    judge.disarmed()


def _reset(judge: Judge, one: inputs.ResetInput, granted: bool) -> None:
    if granted:
        judge.reset(one.now_ns, service=one.level is FaultClass.SERVICE)


def _emergency_stop(judge: Judge, one: inputs.EmergencyStopInput, granted: bool) -> None:
    del one, granted
    judge.emergency_stop()


def _link_lost(judge: Judge, one: inputs.LinkLostInput, granted: bool) -> None:
    del granted
    judge.link_lost(one.at_ns)


def _link_opened(judge: Judge, one: inputs.LinkOpenedInput, granted: bool) -> None:
    del granted
    off = one.link.state is LinkState.BUS_OFF or (one.carrier and not one.carrier.present)
    judge.link_opened(one.now_ns, up=not off)


def _carrier(judge: Judge, one: inputs.CarrierInput, granted: bool) -> None:
    del granted
    judge.carrier(one.carrier.present, one.carrier.since_ns)


def _begun(judge: Judge, one: inputs.BeginInput, granted: bool) -> None:
    del granted
    if one.cut_reason is not None:
        judge.requests.cut_latched = True


def _restart_state(judge: Judge, one: inputs.RestartStateInput, granted: bool) -> None:
    del granted
    judge.restart_state(kept=one.failure is None)


_TOLD: Mapping[type[CoreInput], Callable[[Judge, Any, bool], None]] = {
    inputs.OfferInput: _offered,
    inputs.EndDemandInput: _ended,
    inputs.ArmInput: _armed,
    inputs.DisarmInput: _disarmed,
    inputs.ResetInput: _reset,
    inputs.EmergencyStopInput: _emergency_stop,
    inputs.LinkLostInput: _link_lost,
    inputs.LinkOpenedInput: _link_opened,
    inputs.CarrierInput: _carrier,
    inputs.BeginInput: _begun,
    inputs.RestartStateInput: _restart_state,
}
