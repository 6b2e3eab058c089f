"""Gateway core: frames, requests and time in; command frames and events out.

Theory of operation
-------------------
The shell owns sockets, clocks and threads; `Gateway` owns every decision. Time is an argument, in
monotonic nanoseconds: the same calls in the same order give the same bytes again.

    gateway = Gateway(codec, settings, now_ns)
    gateway.apply(OpenLink(LinkStatus(LinkState.UP, now_ns), carrier, now_ns))
    gateway.receive(frame)                 # as often as frames come
    gateway.apply(Offer(demand, now_ns))   # demands, arming, resetting
    result = gateway.tick(now_ns)          # every 50 ms
    for frame in result.frames:            # PCU1 0008A7D0  0c000000e02e0000
        gateway.apply(NoteSent(frame, bus.send(frame), now_ns))

Every call that changes the core is a value of core/calls.py, and `apply` makes it.

A tick decides in these steps, all of them on one snapshot:

1. A tick that comes too late in ACTIVE latches a fault before anything else of it counts.
2. `InputCollector`: snapshot, link, own echoes, memory of plausibility; pedals on CAN are demands.
3. Rules give findings, and so do `Laws`, with caps, where curves, drive modes or a slip limiter are
   configured; `Causes` holds each until it was absent for `clear_hold_ms`.
4. Every cause that blocks is a stimulus of the supervisor; so are an expired demand, a missing
   message, and the end of qualification.
5. `Commander`: in ACTIVE the demand within limits and slews, otherwise zero torque.
6. Frames are encoded and checked by the gate; one that it blocks replaces both by safe ones.

`frames` is empty while the gateway listens before it talks. `NoteSent` reports what the bus did
with each frame before the next tick: slews start from what was really sent.

All of it belongs to one thread, the ticking one; any thread may read `snapshot`, `counters` and
`link`.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol, TypeVar

from vcu_gateway.core import plausibility, rules, state, why
from vcu_gateway.core.causes import Event, Finding, Severity
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import NOT_CAPPED, Command, Commander
from vcu_gateway.core.demand import (
    GRANTED,
    ControllerDemands,
    PowerMode,
    Refusal,
    RequestResult,
    refused,
)
from vcu_gateway.core.deratings import CurveState
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.law_inputs import LawInputs
from vcu_gateway.core.laws import DriveModes, Laws
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.mode_manager import (
    ListenBeforeTalk,
    ModeManager,
    Qualification,
    Shutdown,
    echoed_directions,
)
from vcu_gateway.core.operator_requests import LISTENING, OperatorRequests, reload_refusal
from vcu_gateway.core.pedal_frames import PedalFrames
from vcu_gateway.core.plausibility import RegenerationInterlock
from vcu_gateway.core.receive import OWN_NODE, FrameCounters, Receiver
from vcu_gateway.core.rules import InputCollector
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.stop import Stop, StopWatch
from vcu_gateway.core.supervisor import FaultClass, LatchedFault, Mode, Stimulus
from vcu_gateway.core.transmit import OutFrame, Transmitter
from vcu_gateway.core.why import Explanation, Reasons
from vcu_gateway.units import NS_PER_MS


class TickResult(NamedTuple):
    """Decisions of one tick, from one snapshot; no `frames` while listening before talking."""

    snapshot: Snapshot
    mode: Mode
    commands: Mapping[str, Command]
    frames: tuple[OutFrame, ...]
    events: tuple[Event, ...]


_Answer_co = TypeVar("_Answer_co", covariant=True)


class CoreCall(Protocol[_Answer_co]):
    """A call of the core as a value; core/calls.py has them."""

    def apply(self, gateway: "Gateway") -> _Answer_co: ...


class Gateway:
    """Gateway core of two motor controllers; all that the shell calls.

    Attributes:
        settings: those in effect.
        requests: demands, arming, resetting, emergency stop, the end.
        receiver, transmitter, supervisor, causes: the parts, for tests and explanations.
    """

    def __init__(self, codec: Codec, settings: Settings, now_ns: int) -> None:
        self.settings = settings
        deadlines = {
            message.name: state.deadlines(message, settings.late_after_ms, settings.stale_after_ms)
            for message in codec.protocol.received_by(OWN_NODE)
        }
        late_after_ns = {name: d.late_after_ns for name, d in deadlines.items()}
        stale_after_ns = {name: d.stale_after_ns for name, d in deadlines.items()}
        self.receiver = Receiver(codec, stale_after_ns, now_ns, settings.pedals)
        self.transmitter = Transmitter(codec, settings)
        self._collector = InputCollector(self.receiver, self.transmitter.history, late_after_ns)
        modes = self._modes = ModeManager(settings, now_ns)
        self.supervisor, self.causes = modes.supervisor, modes.causes
        self._commander = Commander(settings)
        self._listening = ListenBeforeTalk(now_ns, settings.listen_before_talk_ms)
        pedals = PedalFrames(settings.pedals, codec)
        self.requests = OperatorRequests(settings, modes, self._commander, self._listening, pedals)
        self._regeneration = RegenerationInterlock()
        self._speeds = plausibility.UNKNOWN
        self._laws = Laws(settings.tuning)
        self._qualification = Qualification()
        self._shutdown = Shutdown()
        self._stop_watch = StopWatch(self.transmitter.power_cut_bits())
        self._snapshot = self.snapshot(now_ns)

    def apply(self, call: CoreCall[_Answer_co]) -> _Answer_co:
        """Make a call; its answer."""
        return call.apply(self)

    def receive(self, frame: Frame) -> None:
        """Take in one frame; one that is not decoded is counted and changes no message."""
        self.receiver.receive(frame)

    def link_opened(self, link: LinkStatus, carrier: Carrier | None, now_ns: int) -> None:
        """The interface was opened in this state; `carrier` is None where it is not known."""
        self.receiver.monitor.open(link, carrier)
        self._listening.again(now_ns)
        self._qualification.begin(self.snapshot(now_ns), self.settings.required_messages)
        if self.supervisor.mode is Mode.STANDBY:
            self._modes.apply(Stimulus.REQUIRED_LOST, now_ns, "the link was opened anew")

    def begin_from(self, cut_reason: str | None, reverse: Mapping[str, bool]) -> None:
        """State that the process before this one left; before the first tick.

        A CUT that it had latched is latched again, with this reason. The directions that it
        applied hold unless the controllers echo others before the first frame.
        """
        self._commander.take_over(reverse)
        if cut_reason is not None:
            self._modes.apply(Stimulus.CUT, self._snapshot.now_ns, cut_reason)

    def sent(self, frame: OutFrame, ok: bool, now_ns: int) -> None:
        """Whether the bus took a frame of the last tick."""
        if ok:
            self.transmitter.note_sent(frame, now_ns)
            self._commander.note_sent(frame.controller)
            self._stop_watch.note_sent(frame.controller, frame.data, now_ns)
        else:
            self._commander.not_sent(frame.controller)
            self._shutdown.note_unsent()

    def reload(self, settings: Settings) -> RequestResult:
        """Take new settings whole or not at all; while ACTIVE only stricter limits."""
        reason = reload_refusal(self.settings, settings, self.supervisor.mode)
        gone = [name for name in self.drive_modes if name and name not in settings.tuning.modes]
        if gone and not reason:
            reason = f"drive mode {gone[0]} is in use"
        if reason:
            return self.requests.refuse("reload", reason)
        self.settings = settings
        self.fit_laws()
        self.requests.terms = settings
        self.transmitter.gate.limits = settings
        return GRANTED

    def fit_laws(self) -> None:
        """Begin anew what does not fit the settings, after a reload or in another one's state."""
        tuning = self.settings.tuning
        if not tuning.acts:
            self._laws, self._commander.caps = Laws(tuning), NOT_CAPPED
        elif not {*self.drive_modes} <= {*tuning.modes, tuning.start}:
            self._laws.modes = DriveModes(tuning.start, tuning.start)

    @property
    def drive_modes(self) -> tuple[str | None, str | None]:
        """The drive mode, and the one that was asked for last; None where there are none."""
        return self._laws.modes.current, self._laws.modes.requested

    @property
    def curves(self) -> tuple[CurveState, ...]:
        """Every configured curve as it was in the last tick; from any thread."""
        worst, held = self._laws.deratings.worst, self._laws.deratings.held.copy()
        return tuple(
            CurveState(name, worst.get(name), held.get(name))
            for name in self.settings.tuning.curves
        )

    @property
    def slip_caps_pct(self) -> Mapping[str, float]:
        """Throttle that the slip limiter leaves each controller; from any thread."""
        return self._laws.slip.caps_pct

    def set_drive_mode(self, name: str, level: FaultClass, now_ns: int) -> RequestResult:
        """Ask for a drive mode; it is taken whole where that makes no step."""
        self._modes.judge_lateness(now_ns)
        modes = self.settings.tuning.modes
        if name not in modes:
            known = f"the modes are {', '.join(sorted(modes))}" if modes else "none is configured"
            return refused(Refusal.NO_SUCH_MODE, f"there is no drive mode {name}; {known}")
        for left in {*self.drive_modes} - {None, name}:
            if modes[left or name].left_by_service and level is not FaultClass.SERVICE:
                reason = f"drive mode {left} is left at service level"
                return self.requests.refuse("set_drive_mode", reason)
        self._laws.modes.requested = name
        self._commander.cap_speed(self.settings.tuning.mode_limits[name]["speed_limit_rpm"])
        return GRANTED

    def begin_in_mode(self, name: str) -> None:
        """Drive mode that the process before this one was in; one that is gone changes nothing."""
        if name in self.settings.tuning.modes:
            self._laws.modes.current = self._laws.modes.requested = name

    @property
    def mode(self) -> Mode:
        """Operating mode now."""
        return self.supervisor.mode

    @property
    def _latched_cut(self) -> LatchedFault | None:
        return self.supervisor.latch if self.supervisor.power_is_cut else None

    def stop(self, now_ns: int) -> Stop | None:
        """What is known of the latched CUT; None where none is latched."""
        if self._latched_cut is None:
            return None
        return self._stop_watch.judged(self._snapshot, now_ns)

    @property
    def link(self) -> LinkStatus:
        """State of the bus as far as it is known."""
        return self.receiver.monitor.link

    @property
    def counters(self) -> FrameCounters:
        """Counts so far, copied."""
        return self.receiver.counters(self.transmitter.gate.blocked, self.requests.pedal_frames)

    @property
    def finished(self) -> bool:
        """STOPPING has sent what it must, or cannot send; valid after each tick's sending."""
        return self._shutdown.over(self._listening.over)

    @property
    def gave_up(self) -> bool:
        """STOPPING ended though its safe frames have not left; the last ones may carry torque."""
        return self._shutdown.gave_up

    def snapshot(self, now_ns: int) -> Snapshot:
        """Every message as it is known now; frames that a tick has to judge stay for it."""
        return self.receiver.store.snapshot(now_ns)

    def safe_frames(self) -> tuple[OutFrame, ...]:
        """Frames to send in place of this process, should it not be there to send."""
        safe = self._commander.zero_torque(self.settings, self._modes.power_is_cut)
        return self.transmitter.encoded(safe)

    def tick(self, now_ns: int) -> TickResult:
        """Decide both controllers' frames; they come from one snapshot."""
        modes, requests, settings = self._modes, self.requests, self.settings
        sent, late_ns = self.transmitter.history, modes.judge_lateness(now_ns)
        snapshot = self._snapshot = self.receiver.store.take(now_ns)
        emergency_stop, requests.emergency_stop_requested = requests.emergency_stop_requested, False
        failure = requests.restart_state_failure if self.mode is Mode.ACTIVE else None
        inputs = self._collector.collect(snapshot, settings, late_ns, emergency_stop, failure)
        if settings.pedals is not None:
            pedals = requests.take_pedal_frames(self.receiver.take_pedal_frames(), now_ns)
            inputs = inputs._replace(pedals=pedals)
        if inputs.foreign_sender is not None or inputs.link.state is LinkState.LOST:
            self._listening.again(now_ns)  # without a bus no other sender is heard
        talking = self._listening.over or self._listening.update(now_ns)
        if not sent.begun:
            self._commander.take_over(echoed_directions(snapshot, sent.unsent))
        self._speeds = plausibility.of(snapshot, inputs.observed)
        findings = rules.findings(inputs)
        if settings.tuning.acts:
            findings = (*findings, *self._capped(snapshot))
        modes.update(findings, settings.clear_hold_ms * NS_PER_MS, now_ns)
        self._supervise(snapshot, settings)
        self._stop_watch.follow(self._latched_cut, self.receiver.echoes)
        demanded = requests.demanded(now_ns)
        commands = self._decide(demanded, settings, now_ns)
        frames = self._frames(commands, demanded, now_ns) if talking else ()
        sent.emitted = bool(frames)
        mode, events = self.supervisor.mode, modes.end_tick(now_ns)
        self._shutdown.note_tick(mode is Mode.STOPPING)
        return TickResult(snapshot, mode, self._commander.last, frames, events)

    def _capped(self, snapshot: Snapshot) -> Iterable[Finding]:
        """Give the commander the caps of this tick; what there is to tell of them."""
        mode, now_ns = self.supervisor.mode, snapshot.now_ns
        inputs = LawInputs(
            snapshot=snapshot,
            settings=self.settings,
            demanded=self.requests.demanded(now_ns),
            active=mode is Mode.ACTIVE,
            told=mode in (Mode.STANDBY, Mode.ACTIVE),
            last=self._commander.last,
            motor_rpm=self._speeds.highest_rpm,
            elapsed_s=self._commander.elapsed_s(self.settings, now_ns),
        )
        result = self._laws.tick(inputs)
        self._commander.caps = result.caps
        if result.mode_changed is not None:
            fields = {"mode": result.mode_changed}
            self._modes.emit(Event("drive_mode_changed", Severity.INFO, fields))
        return result.findings

    def _supervise(self, snapshot: Snapshot, settings: Settings) -> None:
        """Give the supervisor every stimulus of this tick, the most urgent first."""
        modes, requests, now_ns = self._modes, self.requests, snapshot.now_ns
        if requests.terminating:
            modes.apply(Stimulus.TERMINATE, now_ns, "asked to end")
        modes.apply_causes(now_ns)
        if not requests.arbiter.fresh(now_ns):
            modes.apply(Stimulus.DEMAND_EXPIRED, now_ns, "the demand expired")
        if not self._qualification.observe(snapshot, settings.required_messages):
            modes.apply(Stimulus.REQUIRED_LOST, now_ns, "a required message is missing")
        elif self.supervisor.mode is Mode.STARTING and self._qualified(snapshot):
            modes.apply(Stimulus.QUALIFIED, now_ns, "every required message is there")
        if modes.auto_arm_pending and requests.arbiter.taken:
            modes.auto_arm_pending = False  # a driver arms on purpose
        if modes.auto_arm_pending and not requests.against_arming(now_ns):
            modes.auto_arm_pending = False
            modes.apply(Stimulus.ARM, now_ns, "armed by auto_arm on a test bench")

    def _qualified(self, snapshot: Snapshot) -> bool:
        missing = self._qualification.missing(snapshot, self.settings)
        return self.transmitter.history.begun and not any(missing)

    def _decide(
        self, demanded: ControllerDemands | None, settings: Settings, now_ns: int
    ) -> Mapping[str, Command]:
        mode, effects = self.supervisor.mode, self.causes.effects()
        fast = self._regeneration.possible(self._speeds.lowest_rpm, settings.regen_min_rpm)
        slow = plausibility.all_below(self._speeds.highest_rpm, settings.direction_change_rpm)
        if mode is Mode.ACTIVE and demanded is not None:
            released = self.transmitter.history.released
            return self._commander.active(
                demanded, effects, slow, settings, now_ns, regenerates=fast, released=released
            )
        if mode is Mode.STANDBY:
            below_cap = plausibility.all_below(
                self._speeds.highest_rpm, self._commander.speed_cap_rpm
            )
            return self._commander.settle(
                demanded, effects, slow, settings, now_ns, below_cap=below_cap
            )
        return self._commander.safe(demanded, settings, self._modes.power_is_cut, now_ns)

    def _frames(
        self,
        commands: Mapping[str, Command],
        demanded: ControllerDemands | None,
        now_ns: int,
    ) -> tuple[OutFrame, ...]:
        """Encode, and show every frame to the gate; one blocked frame stops both."""
        armed = self.supervisor.mode is Mode.ACTIVE
        frames = self.transmitter.encoded(commands)
        rpm = self._speeds.highest_rpm
        rule = self.transmitter.fault_of(frames, armed, demanded, rpm, now_ns)
        if rule is None:
            return frames
        self._collector.blocked_by_gate = rule
        self._modes.latch(rules.blocked(rule), now_ns, f"the gate blocked a frame: {rule}")
        safe = self._commander.replaced(self.settings, self._modes.power_is_cut)
        return self.transmitter.encoded(safe)

    def why(self, now_ns: int) -> Explanation:
        """Mode, blocking and limiting causes, the demand and the next step."""
        age_ns = self.requests.arbiter.age_ns(now_ns)
        return why.explained(self.reasons(now_ns), now_ns, self._snapshot.now_ns, age_ns)

    def reasons(self, now_ns: int) -> Reasons:
        """What `why` says, without ages and before it is put into words."""
        mode, requests, refusal = self.supervisor.mode, self.requests, ""
        if mode is Mode.STANDBY:
            refusal = requests.against_arming(now_ns)
        elif mode is Mode.FAULT:
            refusal = requests.against_resetting(FaultClass.SERVICE, now_ns)
        demand, demanded = requests.arbiter.current, requests.demanded(now_ns)
        source = None if demand is None else demand.source
        ttl_ms = None if demand is None else demand.ttl_ms
        waits, held, fresh = tuple(self._waits(demanded)), self.causes.held, demanded is not None
        return Reasons(mode, self.supervisor.latch, held, waits, source, ttl_ms, fresh, refusal)

    def _throttle_waits(self, demanded: ControllerDemands | None) -> list[str]:
        """Reasons for a throttle of 0 against the demand."""
        found = []
        if latched := self._commander.pedals.latched:
            found.append(why.release_wait(latched))
        if demanded is None:
            return found
        if self._commander.reverse_pending(demanded):
            rpm, limit_rpm = self._speeds.highest_rpm, self.settings.direction_change_rpm
            found.append(why.direction_wait(demanded, rpm, limit_rpm))
        safety = []
        for name, one in demanded.items():  # in every tick: a comprehension is a call more
            if one.power_mode is PowerMode.SAFETY:
                safety.append(name)
        if safety:
            found.append(why.safety_mode_wait(safety))
        return found

    def _power_mode_waits(self, demanded: ControllerDemands | None) -> Iterable[str]:
        """What a PowerMode in ACTIVE waits for; without throttle it rises in the next tick."""
        if demanded is None or self.supervisor.mode is not Mode.ACTIVE:
            return ()
        if self.transmitter.history.released:
            return ()
        waiting = self._commander.waiting_modes(demanded, self.causes.effects(), self.settings)
        return why.power_mode_waits(waiting)

    def _waits(self, demanded: ControllerDemands | None) -> list[str]:
        if not self._listening.over:
            return [LISTENING]
        if self.supervisor.mode in (Mode.STANDBY, Mode.ACTIVE):
            waits = self._throttle_waits(demanded)
            waits += self._power_mode_waits(demanded)
            current, requested = self.drive_modes
            if current != requested:
                waits.append(f"drive mode {requested} waits for the pedal's release")
            return waits
        if self.supervisor.mode is not Mode.STARTING:
            return []
        waits = list(self._qualification.missing(self._snapshot, self.settings))
        return waits if self.transmitter.history.begun else ["sending our first frames", *waits]
