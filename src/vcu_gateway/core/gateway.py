"""The machine without a bus: frames, requests and time in, command frames and events out.

`Gateway.intake` belongs to whoever hands on frames, the reader or the ticking thread right before a
tick, one at a time; everything else belongs to the ticking thread.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from vcu_gateway.core import freshness, motor_speeds, rules, throttle, why
from vcu_gateway.core.causes import BLOCKING, Causes, Effect, Finding
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import Command, Commander
from vcu_gateway.core.events import Event
from vcu_gateway.core.lifecycle import ListenBeforeTalk, Qualification, Shutdown
from vcu_gateway.core.link import LinkState, LinkStatus, PassiveTime
from vcu_gateway.core.motor_speeds import RegenerationInterlock
from vcu_gateway.core.operator_requests import LISTENING, OperatorRequests, Parts
from vcu_gateway.core.plausibility import Plausibility
from vcu_gateway.core.receive import OWN_NODE, Receiver
from vcu_gateway.core.rule_inputs import RuleInputs
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.supervisor import FaultClass, Mode, Stimulus, Supervisor
from vcu_gateway.core.transmit import OutFrame, Transmitter
from vcu_gateway.core.why import Explanation
from vcu_gateway.units import NS_PER_MS


class TickResult(NamedTuple):
    """What one tick decided, all of it from one snapshot.

    Attributes:
        frames: one for each controller; none while listening before talking.
    """

    snapshot: Snapshot
    mode: Mode
    commands: Mapping[str, Command]
    frames: tuple[OutFrame, ...]
    events: tuple[Event, ...]


class Gateway:
    """Receives through `intake`; ticks and answers `requests` on the ticking thread."""

    def __init__(self, codec: Codec, settings: Settings, now_ns: int) -> None:
        self.codec = codec
        deadlines = {
            message.name: freshness.deadlines(
                message, settings.late_after_ms, settings.stale_after_ms
            )
            for message in codec.protocol.received_by(OWN_NODE)
        }
        self._late_after_ns = {name: d.late_after_ns for name, d in deadlines.items()}
        stale_after_ns = {name: d.stale_after_ns for name, d in deadlines.items()}
        self.intake = Receiver(codec, stale_after_ns, now_ns)
        self.output = Transmitter(codec, settings)
        self.causes = Causes()
        self.supervisor = Supervisor(now_ns)
        self._commander = Commander(settings)
        self._regeneration = RegenerationInterlock()
        self._speeds = motor_speeds.UNKNOWN
        self._listening = ListenBeforeTalk(now_ns, settings.listen_before_talk_ms)
        self._qualification = Qualification()
        self._plausibility = Plausibility()
        self._passive = PassiveTime()
        self._lost: LinkStatus | None = None
        self._foreign_before = 0
        self._blocked_by_gate: str | None = None
        self._auto_arm_left = settings.auto_arm and settings.bench_demand is not None
        self._last_tick_ns: int | None = None
        self._was_active = False
        self._ending = Shutdown()
        self._events: list[Event] = []
        self._snapshot = self.intake.store.snapshot(now_ns)
        parts = Parts(
            supervisor=self.supervisor,
            causes=self.causes,
            commander=self._commander,
            listening=self._listening,
            output=self.output,
            apply=self._apply,
            judge_lateness=self.judge_lateness,
            tell=self._events.append,
        )
        self.requests = OperatorRequests(settings, parts)

    @property
    def settings(self) -> Settings:
        """What is in effect."""
        return self.requests.settings

    # What the shell tells.

    def link_lost(self, now_ns: int) -> None:
        """The interface is down or gone."""
        if self._lost is None:
            self._lost = LinkStatus(LinkState.LOST, now_ns)

    def link_opened(self, now_ns: int) -> None:
        """The interface was opened, again or for the first time; nothing is received yet."""
        self._lost = None
        self.intake.link = LinkStatus(LinkState.UP, now_ns)
        self._passive = PassiveTime()
        self._listening.again(now_ns)
        snapshot = self.intake.store.snapshot(now_ns)
        self._qualification.begin(snapshot, self.settings.required)
        if self.supervisor.mode is Mode.STANDBY:
            self._apply(Stimulus.REQUIRED_LOST, now_ns, "the link was opened anew")

    def restarted(self, unexpectedly: int) -> None:
        """How often the gateway was started in this drive without having ended in order."""
        self.requests.restarts = unexpectedly

    def begin_from(self, cut_reason: str | None, reverse: Mapping[str, bool]) -> None:
        """What the process before this one left; before the first tick.

        A CUT that it had latched is latched again, with this reason. The directions that it
        applied hold unless the controllers echo others before the first frame.
        """
        self._commander.take_over(reverse)
        if cut_reason is not None:
            self._apply(Stimulus.CUT, self._snapshot.now_ns, cut_reason)

    @property
    def link(self) -> LinkStatus:
        """What is known of the bus."""
        return self._lost or self.intake.link

    def sent(self, frame: OutFrame, ok: bool, now_ns: int) -> None:
        """Whether the bus took a frame of the last tick."""
        if ok:
            self.output.note_sent(frame, now_ns)
            self._commander.note_sent(frame.controller)
        else:
            self._commander.not_sent(frame.controller)
            self._ending.note_unsent()

    @property
    def finished(self) -> bool:
        """STOPPING has sent what it must, or cannot send; asked after each tick's sending."""
        return self._ending.over(self._listening.over)

    def safe_frames(self) -> tuple[OutFrame, ...]:
        """What is to be sent instead of this process, should it not be there to send."""
        return self.output.encoded(self._commander.zero_torque(self.settings, self._power_is_cut))

    # The tick.

    def judge_lateness(self, now_ns: int) -> None:
        """Latch a tick that is too late in ACTIVE, before anything else of it is applied.

        It was ACTIVE that had to be ticked where only a request since the tick before ended it.
        """
        if self._was_active or self.supervisor.mode is Mode.ACTIVE:
            for finding in rules.late(self._late_ns(now_ns), self.settings.period_ns):
                self._events += self.causes.note(finding, now_ns)
                self._apply(Stimulus.LATCHING_STOP, now_ns, str(finding))

    def _late_ns(self, now_ns: int) -> int:
        """How long after its period a tick now would come."""
        last_ns = self._last_tick_ns
        return 0 if last_ns is None else now_ns - last_ns - self.settings.period_ns

    def tick(self, now_ns: int) -> TickResult:
        """Decide what each controller is told now; both frames come from one snapshot."""
        self.judge_lateness(now_ns)
        snapshot = self._snapshot = self.intake.store.take(now_ns)
        world = self._world(snapshot)
        if world.foreign_sender is not None or self._lost is not None:
            self._listening.again(now_ns)  # without a bus nobody can be heard
        talking = self._listening.update(now_ns)
        if not self.output.sending.begun:
            unsent = self.output.sending.unsent
            self._commander.take_over(_echoed_directions(snapshot, unsent))
        hold_ns = self.settings.clear_hold_ms * NS_PER_MS
        self._events += self.causes.update(rules.findings(world), hold_ns, now_ns)
        self._supervise(snapshot)
        self._speeds = motor_speeds.of(snapshot, world.observed)
        decided = self._decide(snapshot)
        frames = self._frames(decided, now_ns) if talking else ()
        self.output.sending.note_emitted(bool(frames))
        self._last_tick_ns = now_ns
        self._was_active = self.supervisor.mode is Mode.ACTIVE
        return self._result(snapshot, frames)

    def _world(self, snapshot: Snapshot) -> RuleInputs:
        settings, now_ns = self.settings, snapshot.now_ns
        requests = self.requests
        emergency_stop, requests.emergency_stop_asked = requests.emergency_stop_asked, False
        blocked, self._blocked_by_gate = self._blocked_by_gate, None
        foreign, before = self.intake.foreign_count, self._foreign_before
        self._foreign_before = foreign
        return RuleInputs(
            snapshot=snapshot,
            settings=settings,
            late_after_ns=self._late_after_ns,
            link=self.link,
            history=self.output.sending.history,
            observed=self._plausibility.observe(snapshot, self.output.sending.history, settings),
            passive_ns=self._passive.within(self.intake.book.passive_ns(now_ns), now_ns),
            tick_late_ns=self._late_ns(now_ns),
            period_ns=settings.period_ns,
            unconfirmed_ticks=self.output.sending.note_confirmed(self.intake.confirmed),
            foreign_sender=self.intake.foreign_id if foreign > before else None,
            emergency_stop=emergency_stop,
            blocked_by_gate=blocked,
        )

    def _supervise(self, snapshot: Snapshot) -> None:
        """Give the supervisor every stimulus of this tick, the most urgent first."""
        now_ns, required = snapshot.now_ns, self.settings.required
        if self.requests.terminating:
            self._apply(Stimulus.TERMINATE, now_ns, "asked to end")
        for held in self.causes.having(BLOCKING):
            self._apply(_stimulus_of(held.finding), now_ns, str(held.finding))
        if not self.requests.desk.fresh(now_ns):
            self._apply(Stimulus.DEMAND_EXPIRED, now_ns, "the demand expired")
        if not self._qualification.observe(snapshot, required):
            self._apply(Stimulus.REQUIRED_LOST, now_ns, "a required message is missing")
        elif self.supervisor.mode is Mode.STARTING and self._qualified(snapshot):
            self._apply(Stimulus.QUALIFIED, now_ns, "every required message is there")
        if self._auto_arm_left and self.requests.desk.taken:
            self._auto_arm_left = False  # a driver arms on purpose
        if self._auto_arm_left and not self.requests.against_arming(now_ns):
            self._auto_arm_left = False
            self._apply(Stimulus.ARM, now_ns, "armed by auto_arm on a test bench")

    def _qualified(self, snapshot: Snapshot) -> bool:
        missing = self._qualification.missing(snapshot, self.settings)
        return self.output.sending.begun and not any(missing)

    def _apply(self, stimulus: Stimulus, now_ns: int, reason: str) -> None:
        self._events += self.supervisor.apply(stimulus, now_ns, reason)
        if stimulus is Stimulus.DISARM or self.supervisor.mode is Mode.FAULT:
            self._auto_arm_left = False  # a reset never leads to ACTIVE by itself

    def _decide(self, snapshot: Snapshot) -> Mapping[str, Command]:
        settings, now_ns, mode = self.settings, snapshot.now_ns, self.supervisor.mode
        effects, asked = self.causes.effects(), self.requests.asked(now_ns)
        regenerates = self._regeneration.possible(self._speeds.lowest_rpm, settings.regen_min_rpm)
        slow = motor_speeds.all_below(self._speeds.highest_rpm, settings.direction_change_rpm)
        if mode is Mode.ACTIVE and asked is not None:
            return self._commander.active(
                asked, effects, slow, settings, now_ns, regenerates=regenerates
            )
        if mode is Mode.STANDBY:
            return self._commander.settle(asked, effects, slow, settings, now_ns)
        return self._commander.safe(asked, settings, self._power_is_cut, now_ns)

    @property
    def _power_is_cut(self) -> bool:
        return self.supervisor.power_is_cut or Effect.CUT in self.causes.effects()

    def _frames(self, decided: Mapping[str, Command], now_ns: int) -> tuple[OutFrame, ...]:
        """Encode, and let the gate look at every frame; one blocked frame stops both."""
        armed = self.supervisor.mode is Mode.ACTIVE
        frames = self.output.encoded(decided)
        rule = self.output.fault_of(frames, armed, self._speeds.highest_rpm, now_ns)
        if rule is None:
            return frames
        self._blocked_by_gate = rule
        self._events += self.causes.note(rules.blocked(rule), now_ns)
        self._apply(Stimulus.LATCHING_STOP, now_ns, f"the gate blocked a frame: {rule}")
        return self.output.encoded(self._commander.replaced(self.settings, self._power_is_cut))

    def _result(self, snapshot: Snapshot, frames: tuple[OutFrame, ...]) -> TickResult:
        events = tuple(self._events)
        self._events.clear()
        self._ending.note_tick(self.supervisor.mode is Mode.STOPPING)
        return TickResult(
            snapshot=snapshot,
            mode=self.supervisor.mode,
            commands=dict(self._commander.last),
            frames=frames,
            events=events,
        )

    def why(self, now_ns: int) -> Explanation:
        """Mode, what blocks, what limits, the demand and what to do next."""
        mode, refusal = self.supervisor.mode, ""
        if mode is Mode.STANDBY:
            refusal = self.requests.against_arming(now_ns)
        elif mode is Mode.FAULT:
            refusal = self.requests.against_resetting(FaultClass.SERVICE, now_ns)
        judged_ns = self._snapshot.now_ns
        facts = why.ExplanationInputs(judged_ns, self.supervisor, self.causes, self.requests.desk)
        return why.explained(facts, tuple(self._waits(now_ns)), refusal, now_ns)

    def _waits(self, now_ns: int) -> list[str]:
        if not self._listening.over:
            return [LISTENING]
        if self.supervisor.mode in (Mode.STANDBY, Mode.ACTIVE):
            asked = self.requests.asked(now_ns)
            return throttle.waits(self._commander, asked, self._speeds.highest_rpm, self.settings)
        if self.supervisor.mode is not Mode.STARTING:
            return []
        waits = list(self._qualification.missing(self._snapshot, self.settings))
        return waits if self.output.sending.begun else ["sending our first frames", *waits]


def _stimulus_of(finding: Finding) -> Stimulus:
    if finding.effect is Effect.CUT:
        return Stimulus.CUT
    return Stimulus.LATCHING_STOP if finding.latches else Stimulus.STOP


def _echoed_directions(snapshot: Snapshot, controllers: Iterable[str]) -> Mapping[str, bool]:
    """Reverse or not, of each of these controllers that says what it was told last."""
    readings = {name: snapshot.reading(f"{name}_Status1", "MotorReverse") for name in controllers}
    return {
        name: bool(one.good_value) for name, one in readings.items() if one.good_value is not None
    }
