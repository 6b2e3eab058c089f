"""Records of a drive, handed to the verdict's judge as plain values.

The verdict shares nothing with the core; this module is where both meet.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from vcu_gateway.core import calls
from vcu_gateway.core.can_pedals import CanPedals, PedalTrack
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand
from vcu_gateway.core.gateway import CoreCall
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.judge.command_rules import SentFrame
from vcu_gateway.judge.demands import GrantedDemand
from vcu_gateway.judge.judge import Judge
from vcu_gateway.judge.limits import (
    STALE_AFTER_MS,
    JudgedDemand,
    JudgedPedals,
    JudgedSignal,
    JudgedTrack,
    VerdictLimits,
    stale_after_ms,
)
from vcu_gateway.judge.result import DriveVerdict, Findings
from vcu_gateway.recording.call_text import settings_json
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    CoreRecord,
    FrameRun,
    Gap,
    InputRecord,
    TickRecord,
)

_NOT_JUDGED = (
    "I5, I7, I8, I9, I14 and I15 do not show in a recording",
    "causes that only raise an alarm are judged by what they must not do",
)

_NEVER_MS = 1 << 40


def limits_of(
    settings: Settings, aliases: Mapping[int, str], protocol: ProtocolSpec | None = None
) -> VerdictLimits:
    """Limits of the verdict.

    The DBC gives the layout of pedals on CAN, and which of its own messages are required.
    """
    names = {one.name for one in dataclasses.fields(VerdictLimits)}
    names &= {one.name for one in dataclasses.fields(settings)} - {"pedals"}
    values: dict[str, Any] = {name: getattr(settings, name) for name in names}
    bench = settings.bench_demand
    values["bench_demand"] = bench and dict.fromkeys(CONTROLLERS, _demand_of(bench))
    values["tuning"] = settings_json(settings).get("tuning", {})
    if settings.pedals is not None and protocol is not None:
        message = protocol.message(settings.pedals.message)
        values["pedals"] = _pedals_of(settings.pedals, message, settings.priorities)
    for message in () if protocol is None else protocol.messages:
        if message.name in settings.required_messages and message.name not in STALE_AFTER_MS:
            aliases = {**aliases, message.can_id: message.name}
            age_ms = _NEVER_MS if message.period_ms is None else stale_after_ms(message.period_ms)
            values["stale_after_ms"] = {message.name: age_ms, **values["stale_after_ms"]}
    return VerdictLimits(**values, period_ms=settings.period_ns / 1e6, aliases=aliases)


def _pedals_of(
    pedals: CanPedals, message: MessageSpec, priorities: Mapping[str, int]
) -> JudgedPedals:
    def signal(name: str) -> JudgedSignal:
        one = message.signal(name)
        return JudgedSignal(
            one.bit_positions(), one.signed, one.factor, one.offset,
            one.raw_minimum, one.raw_maximum, one.saturated_raw,
        )  # fmt: skip

    def or_none(name: str | None) -> JudgedSignal | None:
        return None if name is None else signal(name)

    def track(one: PedalTrack) -> JudgedTrack:
        return JudgedTrack(signal(one.signal), one.released, one.pressed)

    second, brake, curve = pedals.throttle_track2, pedals.brake, pedals.coast_brake
    checksum: tuple[int, str] | None = None
    if pedals.checksum is not None:
        place = min(message.signal(pedals.checksum.signal).bit_positions())
        checksum = place // 8, pedals.checksum.kind
    return JudgedPedals(
        can_id=message.can_id,
        period_ms=message.period_ms or 0,
        throttle=track(pedals.throttle),
        track2=None if second is None else track(second),
        brake=None if brake is None else track(brake),
        counter=or_none(pedals.counter),
        checksum=checksum,
        reverse=or_none(pedals.reverse),
        power_mode=pedals.power_mode.value,
        regen_brake=pedals.regen_brake,
        dead_zone_pct=pedals.dead_zone_pct,
        coast=() if curve is None else curve.points,
        priorities=priorities,
    )


def _demand_of(one: ControllerDemand) -> JudgedDemand:
    """Its fields have the same names there."""
    values = JudgedDemand._make(getattr(one, name) for name in JudgedDemand._fields)
    return values._replace(power_mode=one.power_mode.value)


class JudgedRecords:
    """Judgement of records in their order; a gap or an end begins a new stretch.

    Attributes:
        findings: violations and reaction times so far.
    """

    def __init__(
        self, settings: Settings, aliases: Mapping[int, str], protocol: ProtocolSpec | None = None
    ) -> None:
        self.findings = Findings()
        self._aliases = aliases
        self._protocol = protocol
        self._settings = settings
        self._judge: Judge | None = None
        self._pending: tuple[int, str] | None = None
        self._sent: dict[str, SentFrame] = {}
        self._unknown: set[str] = set()
        self._between: list[Frame] = []
        self._ticks = self._commands = self._with_torque = 0
        self._last_ns: int | None = None
        self._widest_ns = 0

    def begin(self, settings: Settings, tick: int) -> Judge:
        """A stretch begins, with the gateway's start where `tick` is 0."""
        self.end()
        limits = limits_of(settings, self._aliases, self._protocol)
        judge = Judge(limits, self.findings, complete=tick == 0, tick=tick)
        if settings.auto_arm and settings.bench_demand is not None:
            judge.requests.bench()
        self._judge, self._last_ns = judge, None
        return judge

    def frames(self, frames: list[Frame]) -> None:
        if self._unknown:
            self._between += frames  # they came between the sending of both frames
            return
        self._ready().frames(frames)

    def note(self, record: FrameRun | CoreRecord) -> None:
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
        self._pending = None
        self._ticks += 1
        self._commands += len(self._sent)
        self._with_torque += sum(any(one.data[1:3]) for one in self._sent.values())
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
        if isinstance(one, calls.Receive):
            self.frames([one.frame])
        elif isinstance(one, calls.NoteSent):
            name = one.frame.controller
            self._sent[name] = self._sent[name]._replace(left=one.ok)
            self._unknown.discard(name)
        else:
            judge = self._ready()
            if isinstance(one, calls.Offer):
                judge.offered(one.now_ns)
            if record.answer is not None and not record.answer.granted:
                return
            if isinstance(one, calls.ReloadSettings):
                judge.reload(limits_of(one.settings, self._aliases, self._protocol))
            elif tell := _GRANTED.get(type(one)):
                tell(judge, one)

    def end(self) -> None:
        if self._judge is not None:
            self._ready().end()
        self._judge = None

    def verdict(self) -> DriveVerdict:
        self.end()
        return DriveVerdict(
            ticks=self._ticks,
            commands=self._commands,
            with_torque=self._with_torque,
            longest_between_ticks_ms=self._widest_ns / 1e6,
            violations_by_rule=dict(self.findings.counts),
            violations=tuple(self.findings.kept),
            reactions=self.findings.reactions,
            not_judged=_NOT_JUDGED,
        )


def _demanded(judge: Judge, one: calls.Offer) -> None:
    demand = one.demand
    controllers = {name: _demand_of(each) for name, each in demand.controllers.items()}
    made_ns = one.now_ns if demand.made_ns is None else demand.made_ns
    judge.demand(GrantedDemand(demand.source, controllers, made_ns, demand.ttl_ms), one.now_ns)


def _link_opened(judge: Judge, one: calls.OpenLink) -> None:
    off = one.link.state is LinkState.BUS_OFF or (one.carrier and not one.carrier.present)
    judge.link_opened(one.now_ns, up=not off)


def _drive_mode_asked(judge: Judge, one: calls.SetDriveMode) -> None:
    judge.drive_mode_asked(one.mode, one.now_ns, service=one.level is FaultClass.SERVICE)


def _begun(judge: Judge, one: calls.BeginFrom) -> None:
    if one.cut_reason is not None:
        judge.requests.cut_latched = True


_GRANTED: Mapping[type[CoreCall[object]], Callable[[Judge, Any], None]] = {
    calls.Offer: _demanded,
    calls.EndDemand: lambda judge, _: judge.end_demand(),
    calls.Arm: lambda judge, one: judge.armed(one.now_ns),
    calls.Disarm: lambda judge, _: judge.disarmed(),
    calls.Reset: lambda judge, one: judge.reset(
        one.now_ns, service=one.level is FaultClass.SERVICE
    ),
    calls.EmergencyStop: lambda judge, _: judge.emergency_stop(),
    calls.LoseLink: lambda judge, one: judge.link_lost(one.at_ns),
    calls.OpenLink: _link_opened,
    calls.ChangeCarrier: lambda judge, one: judge.carrier(
        one.carrier.present, one.carrier.since_ns
    ),
    calls.SetDriveMode: _drive_mode_asked,
    calls.BeginInMode: lambda judge, one: judge.begun_in_drive_mode(one.mode),
    calls.BeginFrom: _begun,
    calls.NoteRestartState: lambda judge, one: judge.restart_state(kept=one.failure is None),
}
"""What the judge is told of a call that was not refused."""
