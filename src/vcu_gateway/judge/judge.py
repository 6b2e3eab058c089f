"""Judge: a recorded drive against docs/safety.md, from its bytes and its modes.

Nothing of the gateway's decisions is used here: frames are decoded from their bytes, causes and
effects are those of the specification, and of the recording only what came in, what was sent and
which mode was told is believed.

    judge = Judge(limits, findings, complete=True)
    judge.frames(frames)                         # as often as frames came
    judge.demand(demand, now_ns)                 # granted demands, requests, the link
    judge.tick(now_ns, "active", {"PCU1": command, "PCU2": command})
    findings.kept, findings.reactions
"""

from collections.abc import Iterable

from vcu_gateway.judge import causes as expected
from vcu_gateway.judge import command_rules, wire
from vcu_gateway.judge.arrivals import Arrivals, BusFrame
from vcu_gateway.judge.causes import CUT, STOP, BusState, HeldEffects, Seen, Unconfirmed
from vcu_gateway.judge.command_rules import (
    FramePairs,
    Judged,
    LimitRamps,
    SentBefore,
    SentFrame,
    SentFrames,
    TickFacts,
)
from vcu_gateway.judge.demands import GrantedDemand, GrantedDemands
from vcu_gateway.judge.limits import JudgedDemand, VerdictLimits
from vcu_gateway.judge.mode_rules import ModeRules, TickCauses
from vcu_gateway.judge.pedal_frames import PEDALS, PedalsDemand, PedalsReading
from vcu_gateway.judge.result import Findings, Reactions
from vcu_gateway.judge.tuning_rules import TuningCaps, TuningRules, TuningTick
from vcu_gateway.judge.wire import CONTROLLERS, LENGTH, MOTOR_HIGHEST_RPM, MS

_REGEN_RETURN_RPM = 50
_LATE_PERIODS = 4
_MOST = bytes.fromhex("00FFFF00FFFFFFFF")


class Judge:
    """Judge of one uninterrupted stretch of a recording.

    `complete`: it begins with the start of the gateway. Otherwise what was before is unknown, and
    nothing is held against it.

    Attributes:
        limits: configuration in effect.
        requests: granted requests and modes.
        caps: what tuning allowed in the last tick.
    """

    def __init__(
        self, limits: VerdictLimits, findings: Findings, *, complete: bool, tick: int = 0
    ) -> None:
        self.limits = limits
        self.requests = ModeRules(findings)
        self._findings = findings
        self._arrivals = Arrivals(limits, complete=complete)
        self._bus = BusState()
        self._demands = GrantedDemands(limits.bench_demand, known=complete)
        self._pedals = None if limits.pedals is None else PedalsReading(limits.pedals)
        self._unconfirmed = Unconfirmed()
        self._held = HeldEffects()
        self._ramps = LimitRamps(limits)
        self._reactions = Reactions(findings)
        self._before: dict[str, SentBefore] = {}
        self._tuning = TuningRules(limits, complete=complete)
        self.caps = TuningCaps()
        self._told: dict[str, bytes] = {}
        if not complete:
            self._told = dict.fromkeys(CONTROLLERS, _MOST)  # it may have been anything
        self._last_ns: int | None = None
        self._pairs = FramePairs(complete=complete)
        self._regenerates = not complete
        self._complete = complete
        self._emergency = False
        self._armed_ns: int | None = None
        self._restart_state_kept = True
        self._tick = tick

    # What comes in.

    def frames(self, frames: Iterable[BusFrame]) -> None:
        """Take in frames in the order in which they came."""
        if self._pedals is not None:
            frames = list(frames)
            self._pedals.collect(frames)
        for frame in self._arrivals.receive(frames):
            if frame.error:
                self._bus.error_frame(frame.can_id, bytes(frame.data), frame.arrival_ns)
            else:
                self._reactions.left(frame.arrival_ns)

    def link_lost(self, at_ns: int) -> None:
        self._bus.lost(at_ns)

    def link_opened(self, at_ns: int, *, up: bool) -> None:
        """The interface was opened; not `up`: without a working bus."""
        self._bus.opened()
        if not up:
            self._bus.carrier(False, at_ns)
        self._pairs.listen(self.limits, at_ns)

    def carrier(self, present: bool, at_ns: int) -> None:
        self._bus.carrier(present, at_ns)

    def offered(self, now_ns: int) -> None:
        """A demand is offered, whatever the answer."""
        if self._demands.known and not self._demands.fresh(now_ns):
            self.requests.left_active()
        self._demands.offered(now_ns)

    def demand(self, demand: GrantedDemand, now_ns: int) -> None:
        self._demands.granted(demand, now_ns, driving=self.requests.may_be_active)

    def end_demand(self) -> None:
        self._demands.ended()
        self.requests.left_active()

    def armed(self, now_ns: int) -> None:
        demands, reason = self._demands, ""
        released_ns = demands.released_for_ns(now_ns)
        if self._held.blocking or self._emergency:
            reason = "a violation stands"
        elif not self._restart_state_kept:
            reason = "the restart state was not kept"
        elif demands.known and not demands.fresh(now_ns):
            reason = "there is no fresh demand"
        elif self._complete and (released_ns is None or released_ns < 200 * MS):
            reason = "the throttle was not 0 for 200 ms"
        elif self._turns(demands):
            reason = "a change of direction is pending"
        elif any(
            one.command.speed_limit_rpm > self.caps.speed_rpm + 1 for one in self._before.values()
        ):
            reason = f"SpeedLimit has not come down to {self.caps.speed_rpm:.0f} rpm"
        self.requests.armed(self._tick, now_ns, reason)
        self._armed_ns = now_ns

    def _turns(self, demands: GrantedDemands) -> bool:
        demanded = [(one.command, demands.of(name)) for name, one in self._before.items()]
        return any(one and one.motor_reverse is not sent.reverse for sent, one in demanded)

    def restart_state(self, *, kept: bool) -> None:
        self._restart_state_kept = kept

    def reset(self, now_ns: int, *, service: bool) -> None:
        against = "a cause stands" if self._held.blocking or self._emergency else ""
        if self._demands.asks_throttle(now_ns):
            against = "the demanded throttle is not 0"
        self.requests.reset(self._tick, now_ns, against, service=service)

    def emergency_stop(self) -> None:
        self._emergency = True

    def disarmed(self) -> None:
        self.requests.left_active()

    def drive_mode_asked(self, name: str, now_ns: int, *, service: bool) -> None:
        against = self._tuning.ask(name, self.limits, service=service)
        if against:
            self._broken("drive mode", now_ns, against)

    def begun_in_drive_mode(self, name: str) -> None:
        self._tuning.begin_in(name, self.limits)

    def reload(self, limits: VerdictLimits) -> None:
        self.limits = self._arrivals.limits = limits
        self._tuning.reload(limits)

    def end(self) -> None:
        self._reactions.settle()

    # The tick.

    def tick(self, now_ns: int, mode: str, sent: SentFrames) -> None:
        """Judge a tick: the mode it told and the command of each controller."""
        elapsed_ns = self.limits.period_ns if self._last_ns is None else now_ns - self._last_ns
        late_ns = max(0, elapsed_ns - self.limits.period_ns)
        if self._pedals is not None:
            self._take_pedals(self._pedals, now_ns)
        found = list(self._found(now_ns, late_ns))
        new = self._held.update(found, self.limits.clear_hold_ms, now_ns)
        causes = TickCauses(
            stop=_first(found, STOP),
            cut=_first(found, CUT),
            foreign=self._arrivals.foreign_ns is not None,
            late=self._last_ns is not None and late_ns > _LATE_PERIODS * self.limits.period_ns,
            demand_fresh=not self._demands.known or self._demands.fresh(now_ns),
        )
        was_active = self.requests.mode == "active"
        unknown = self._last_ns is None and not self._complete  # how the first tick began
        began_active = self.requests.may_be_active or unknown
        self.requests.tick(self._tick, now_ns, mode, causes)
        facts = self._facts(now_ns, mode, elapsed_ns, began_active=began_active)
        disturbed = self._bus.is_lost or causes.foreign
        for rule, seen in self._pairs.broken(sent, self.limits, now_ns, disturbed=disturbed):
            self._broken(rule, now_ns, seen)
        for rule, seen in command_rules.asymmetry(sent, self._before, self._demanded, self.limits):
            self._broken(rule, now_ns, seen)
        for controller, frame in sent.items():
            self._judge_frame(controller, frame, facts)
        told = new if was_active else [one for one in new if one.effect == CUT]
        self._reactions.tick(self._tick, now_ns, late_ns, sent, told)
        self._end_tick(now_ns, sent)

    def _take_pedals(self, pedals: PedalsReading, now_ns: int) -> None:
        """Frames of the pedals since the last tick; another owner's fresh demand counts first."""
        demands, limits = self._demands, self.limits
        for one in pedals.demands(now_ns, limits.period_ms):
            owner = demands.current
            at_ns = one.demand.made_ns if owner is None else max(one.demand.made_ns, owner.made_ns)
            if one.resumed and demands.is_owner(PEDALS):
                demands.ended()
            self.offered(at_ns)
            outranks = limits.pedals is not None and owner and limits.pedals.outranks(owner.source)
            if demands.fresh(at_ns) and not demands.is_owner(PEDALS) and not outranks:
                continue
            self._take_one(one, at_ns)
        if pedals.silent(now_ns) and demands.is_owner(PEDALS):
            demands.ended()

    def _take_one(self, one: PedalsDemand, at_ns: int) -> None:
        if one.known:
            self.demand(one.demand, at_ns)
        else:
            self._demands.doubted(one.demand)
        armed_ns = self._armed_ns
        pressed = self._demands.released_for_ns(at_ns) is None
        if armed_ns is not None and pressed and at_ns < armed_ns:
            self.requests.left_active()

    def _found(self, now_ns: int, late_ns: int) -> list[Seen]:
        arrivals = self._arrivals
        # What never came may have come before this recording began.
        found = [
            one
            for one in expected.seen(arrivals, self.limits, now_ns)
            if self._complete
            or not one.cause.endswith(" stale")
            or arrivals.came(one.cause.removesuffix(" stale"))
        ]
        if self._unconfirmed.tick(arrivals.echoed_ns):
            found.append(Seen(STOP, "own frames not confirmed", now_ns))
        if self._bus.down_ns is not None:
            found.append(Seen(STOP, "bus off, or interface down", self._bus.down_ns))
        passive_ns = self._bus.passive_since_ns(now_ns)
        if passive_ns is not None and now_ns - passive_ns > self.limits.period_ns + late_ns:
            found.append(Seen(STOP, "error passive", passive_ns))
        if self._emergency:
            asked_ns = now_ns if self._last_ns is None else self._last_ns  # at the earliest
            span_ns = now_ns - asked_ns
            found.append(Seen(CUT, "emergency stop", asked_ns, span_ns=span_ns))
        return found

    @property
    def _demanded(self) -> dict[str, JudgedDemand | None]:
        demands = self._demands
        return {name: demands.of(name) if demands.known else None for name in CONTROLLERS}

    def _facts(self, now_ns: int, mode: str, elapsed_ns: int, *, began_active: bool) -> TickFacts:
        limits, effects = self.limits, self._held.effects
        counted_ns = min(max(elapsed_ns, 0), limits.period_ns)
        speeds = self._arrivals.speeds_rpm(now_ns)
        self._note_regeneration(speeds)
        sent_raw = {name: one.command.throttle_raw for name, one in self._before.items()}
        self.caps = self._tuning.tick(
            TuningTick(
                limits=limits,
                arrivals=self._arrivals,
                demands=self._demands,
                sent_raw=sent_raw,
                now_ns=now_ns,
                elapsed_s=counted_ns / 1e9,
                began_active=began_active,
            )
        )
        if mode in ("standby", "active"):
            self._ramps.move(effects, self.caps, limits, self._told, counted_ns / 1e9)
        return TickFacts(
            limits=limits,
            mode=mode,
            effects=effects,
            caps=self.caps,
            speeds_rpm=speeds,
            regenerates=self._regenerates,
            released=all(one.command.released for one in self._before.values()),
            cut=self.requests.cut_latched,
            holds=self._holds(now_ns) if self._demands.known else set(),
            ramps=self._ramps,
            elapsed_ns=counted_ns,
            now_ns=now_ns,
        )

    def _holds(self, now_ns: int) -> set[str]:
        holds = self._demands.holds(now_ns)
        for controller, reverse in self._demands.directions:
            before = self._before.get(controller)
            if before is not None and before.command.reverse is not reverse:
                holds.add("a change of direction is pending")
        return holds

    def _note_regeneration(self, speeds: list[int] | None) -> None:
        least_rpm = self.limits.regen_min_rpm
        if not self._complete and not self._arrivals.speeds_came:
            return  # they may have come before this recording
        needed_rpm = least_rpm if self._regenerates else least_rpm + _REGEN_RETURN_RPM
        fast = speeds is not None and all(needed_rpm <= rpm <= MOTOR_HIGHEST_RPM for rpm in speeds)
        self._regenerates = fast or least_rpm == 0

    def _judge_frame(self, controller: str, frame: SentFrame, facts: TickFacts) -> None:
        own_id = wire.command_id(controller, self.limits.transmit_priority)
        if frame.can_id != own_id or len(frame.data) != LENGTH:
            seen = f"{frame.can_id:08X} with {len(frame.data)} bytes, not {own_id:08X} with 8"
            self._broken("gate identifier and length", facts.now_ns, seen)
            return
        command, before = wire.command_bytes(frame.data), self._before.get(controller)
        if before is not None and 2 * (facts.now_ns - before.at_ns) < self.limits.period_ns:
            gap_ms = (facts.now_ns - before.at_ns) / MS
            self._broken("I4 half a period apart", facts.now_ns, f"{gap_ms:.1f} ms after the last")
        judged = Judged(controller, command, before, self._demanded[controller])
        for rule, seen in command_rules.broken(judged, facts):
            self._broken(rule, facts.now_ns, f"{controller}: {seen}")

    def _broken(self, rule: str, now_ns: int, sentence: str) -> None:
        self._findings.broken(rule, self._tick, now_ns, sentence)

    def _end_tick(self, now_ns: int, sent: SentFrames) -> None:
        for controller, frame in sent.items():
            if frame.left and len(frame.data) == LENGTH:
                self._before[controller] = SentBefore(wire.command_bytes(frame.data), now_ns)
                self._told[controller] = frame.data
                self._arrivals.note_sent(controller, frame.data, now_ns)
        self._unconfirmed.note_emitted(bool(sent))
        self._arrivals.end_tick()
        self._bus.end_tick()
        self._demands.end_tick()
        self._emergency = False
        self._last_ns = now_ns
        self._tick += 1


def _first(found: list[Seen], effect: str) -> str:
    return next((one.cause for one in found if one.effect == effect), "")
