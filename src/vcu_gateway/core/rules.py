"""Rules: one function for each reason not to move, or to move less (docs/safety.md, Causes).

A rule sees its inputs and returns its findings; it does not log, remember or command. The
tuple at the bottom is the whole list. What codes mean is in `causes`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from vcu_gateway.core.causes import BATTERY_STATUS, CONTROLLER_STATUS, CodedSignals, Effect, Finding
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.pedal_frames import PedalObservation
from vcu_gateway.core.plausibility import (
    NO_DEVIATION,
    WHEELS_MESSAGE,
    History,
    Observed,
    Plausibility,
)
from vcu_gateway.core.receive import Receiver
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.transmit import SentHistory
from vcu_gateway.units import NS_PER_MS


class RuleInputs(NamedTuple):
    """Inputs of every rule at one tick: its snapshot, and facts that no message carries.

    Attributes:
        late_after_ns: by message name.
        coded: what the codes of battery and controllers find.
        history: the last throttles and directions sent to each controller, oldest first.
        observed: deviations from the frames before and from sent commands.
        passive_ns: error-passive in all during the last 5 s.
        tick_late_ns: how long after its period this tick comes.
        unconfirmed_ticks: ticks in a row whose frames did not come back from the bus.
        foreign_sender: identifier of a command that another node sent since the last tick.
        emergency_stop: requested since the last tick.
        blocked_by_gate: what the gate blocked in the last tick.
        restart_state_failure: why the restart state could not be kept in ACTIVE.
        pedals: what there is to tell of pedals on CAN; None where all is well.
    """

    snapshot: Snapshot
    settings: Settings
    late_after_ns: Mapping[str, int]
    link: LinkStatus
    coded: CodedSignals
    history: History
    observed: Observed
    passive_ns: int
    tick_late_ns: int
    period_ns: int
    unconfirmed_ticks: int
    foreign_sender: int | None
    emergency_stop: bool
    blocked_by_gate: str | None
    restart_state_failure: str | None
    pedals: PedalObservation | None = None


class InputCollector:
    """Collects the inputs of each tick, and remembers what the next ones are held against.

    Attributes:
        blocked_by_gate: rule that the last tick's frames broke; None where they broke none.
    """

    def __init__(
        self, receiver: Receiver, history: SentHistory, late_after_ns: Mapping[str, int]
    ) -> None:
        self.blocked_by_gate: str | None = None
        self._receiver = receiver
        self._history = history
        self._late_after_ns = late_after_ns
        self._coded = CodedSignals()
        self._plausibility = Plausibility()
        self._foreign_before = 0

    def collect(
        self,
        snapshot: Snapshot,
        settings: Settings,
        tick_late_ns: int,
        emergency_stop: bool,
        restart_state_failure: str | None,
    ) -> RuleInputs:
        """The inputs of a tick at the time of this snapshot; once a tick."""
        receiver, monitor, sent = self._receiver, self._receiver.monitor, self._history
        monitor.begin_tick()
        blocked, self.blocked_by_gate = self.blocked_by_gate, None
        foreign, before = receiver.foreign_count, self._foreign_before
        self._foreign_before = foreign
        return RuleInputs(
            snapshot=snapshot,
            settings=settings,
            late_after_ns=self._late_after_ns,
            link=monitor.link,
            coded=self._coded,
            history=sent.frames,
            observed=self._plausibility.observe(snapshot, sent.frames, settings),
            passive_ns=monitor.recent_passive_ns(snapshot.now_ns),
            tick_late_ns=tick_late_ns,
            period_ns=settings.period_ns,
            unconfirmed_ticks=sent.note_confirmed(receiver.confirmed),
            foreign_sender=receiver.foreign_id if foreign > before else None,
            emergency_stop=emergency_stop,
            blocked_by_gate=blocked,
            restart_state_failure=restart_state_failure,
        )


_ALARM, _STOP = (Effect.ALARM,), (Effect.STOP,)
_LIMITS = (Effect.REGEN_LIMIT, Effect.POWER_LIMIT)

_PASSIVE_MAX_NS = 1_000 * NS_PER_MS
_ECHO_FRAMES = 2
_WHEELS_APART_NS = 1_000 * NS_PER_MS
_UNCONFIRMED_MAX_TICKS = 3
_LATE_MAX_PERIODS = 4
_LIFE_LIMIT_REPEATS = 1
_LIFE_STOP_REPEATS = 2
_BAD_PEDAL_FRAMES = 3

EMERGENCY_STOP = Finding("emergency_stop", "emergency stop", Effect.CUT, "requested")

Rule = Callable[[RuleInputs], Sequence[Finding]]


def battery_codes(inputs: RuleInputs) -> Sequence[Finding]:
    """Fault levels of the battery; the last known level counts until another is known."""
    return inputs.coded.findings(inputs.snapshot, BATTERY_STATUS)


def controller_codes(inputs: RuleInputs) -> Sequence[Finding]:
    """Protection levels of either controller, for both: one driven wheel turns the vehicle."""
    found: list[Finding] = []
    for message in CONTROLLER_STATUS:
        found.extend(inputs.coded.findings(inputs.snapshot, message))
    return found


def battery_late(inputs: RuleInputs) -> Sequence[Finding]:
    """Battery status overdue: limits until the next one comes or it is stale."""
    age_ns = inputs.snapshot.age_ns(BATTERY_STATUS)
    if age_ns is None or age_ns <= inputs.late_after_ns[BATTERY_STATUS]:
        return ()
    return [Finding("late", BATTERY_STATUS, effect, _milliseconds(age_ns)) for effect in _LIMITS]


def battery_life(inputs: RuleInputs) -> Sequence[Finding]:
    """Life signal unchanged: frames arrive, but their sender may have stopped."""
    repeats = 0
    for frame in inputs.snapshot.judged(BATTERY_STATUS):
        repeats = max(repeats, frame.life_repeats)
    if repeats < _LIFE_LIMIT_REPEATS:
        return ()
    detail = f"unchanged in {repeats + 1} frames"
    effects = _LIMITS if repeats < _LIFE_STOP_REPEATS else (*_LIMITS, Effect.STOP)
    subject = f"{BATTERY_STATUS}.LifeSignal"
    return [Finding("life_signal", subject, effect, detail) for effect in effects]


def stale(inputs: RuleInputs) -> Sequence[Finding]:
    """Message too old, or never received."""
    found: list[Finding] = []
    for message in inputs.snapshot.stale_messages():
        age_ns = inputs.snapshot.age_ns(message)
        detail = "never received" if age_ns is None else _milliseconds(age_ns)
        effects = _effects_of_silence(inputs, message)
        found += [Finding("stale", message, effect, detail) for effect in effects]
    return found


def _effects_of_silence(inputs: RuleInputs, message: str) -> tuple[Effect, ...]:
    kind = message.partition("_")[2]
    found: tuple[Effect, ...] = _ALARM
    if message == BATTERY_STATUS or kind == "Status2":
        found = _STOP
    elif kind == "Status1":
        found = (Effect.TURBO_OFF, Effect.POWER_LIMIT)
    if message in inputs.settings.required_messages and Effect.STOP not in found:
        found = (*found, Effect.STOP)
    return found


def out_of_range(inputs: RuleInputs) -> Sequence[Finding]:
    """Signal of a required message outside its range."""
    found: list[Finding] = []
    for message in inputs.settings.required_messages:
        for signal, raw in inputs.snapshot.marked(message):
            subject, detail = f"{message}.{signal}", f"raw {raw}"
            found.append(Finding("out_of_range", subject, Effect.ALARM, detail))
    return found


def throttle_echo(inputs: RuleInputs) -> Sequence[Finding]:
    """Controller echoes more throttle than was commanded."""
    found: list[Finding] = []
    for controller, excess in inputs.observed.echo_above.items():
        message = f"{controller}_Status1"
        if not inputs.snapshot.stale(message):
            detail = f"{excess.echoed_pct:.1f} %, commanded {excess.commanded_pct:.1f} %"
            found.append(Finding("throttle_echo", f"{message}.Throttle", Effect.STOP, detail))
    return found


def echo_below(inputs: RuleInputs) -> Sequence[Finding]:
    """Controller echoes less throttle than was commanded; both alike do not turn the vehicle."""
    found: list[Finding] = []
    runs = _runs(inputs, inputs.observed.echo_below)
    for controller, run in runs.items():
        if run >= _ECHO_FRAMES:
            # The other one's last frame counts: what it obeys now it drives with.
            others = set(CONTROLLERS) - {controller}
            both = others <= inputs.observed.echoes_below & runs.keys()
            effect = Effect.ALARM if both else Effect.STOP
            subject, detail = f"{controller}_Status1.Throttle", f"does not obey, in {run} frames"
            found.append(Finding("echo_below", subject, effect, detail))
    return found


def echo_direction(inputs: RuleInputs) -> Sequence[Finding]:
    """Controller echoes another direction than the commanded one."""
    found: list[Finding] = []
    for controller, run in _runs(inputs, inputs.observed.echo_direction).items():
        if run >= _ECHO_FRAMES:
            subject = f"{controller}_Status1.MotorReverse"
            detail = f"not as commanded, in {run} frames"
            found.append(Finding("echo_direction", subject, Effect.STOP, detail))
    return found


def _runs(inputs: RuleInputs, runs: Mapping[str, int]) -> Mapping[str, int]:
    """Frames in a row, of each controller whose status is not stale."""
    stale = inputs.snapshot.stale
    return {name: run for name, run in runs.items() if not stale(f"{name}_Status1")}


def speed_steps(inputs: RuleInputs) -> Sequence[Finding]:
    """Implausible change of a motor's speed, which does not count for a while."""
    found: list[Finding] = []
    for controller, step_rpm in inputs.observed.speed_steps_rpm.items():
        subject, detail = f"{controller}_Status2.MotorSpeed", f"changed by {step_rpm:.0f} rpm"
        found.append(Finding("speed_step", subject, Effect.ALARM, detail))
    return found


def wheel_speeds(inputs: RuleInputs) -> Sequence[Finding]:
    """Implausible change of a wheel's speed, or wheels that differ for long."""
    found: list[Finding] = []
    for wheel, step_kmh in inputs.observed.wheel_steps_kmh.items():
        subject, detail = f"{WHEELS_MESSAGE}.{wheel}", f"changed by {step_kmh:.1f} km/h"
        found.append(Finding("wheel_speed_step", subject, Effect.ALARM, detail))
    apart_ns = inputs.observed.wheels_apart_ns
    if apart_ns is None or inputs.snapshot.stale(WHEELS_MESSAGE):
        return found
    if apart_ns >= _WHEELS_APART_NS:
        detail = f"wheels differ for {_milliseconds(apart_ns)}"
        found.append(Finding("wheel_speed_difference", WHEELS_MESSAGE, Effect.ALARM, detail))
    return found


def unconfirmed(inputs: RuleInputs) -> Sequence[Finding]:
    """Own frames not confirmed: no decision reaches the motors."""
    if inputs.unconfirmed_ticks < _UNCONFIRMED_MAX_TICKS:
        return ()
    detail = f"for {inputs.unconfirmed_ticks} ticks"
    return [Finding("unconfirmed", "own frames", Effect.STOP, detail)]


def link_down(inputs: RuleInputs) -> Sequence[Finding]:
    """Bus that carries no frames, or hardly any."""
    state = inputs.link.state
    if state in (LinkState.BUS_OFF, LinkState.LOST):
        return [Finding("link", "link", Effect.STOP, state.value)]
    if inputs.passive_ns <= _PASSIVE_MAX_NS:
        return ()
    detail = f"{LinkState.PASSIVE.value} for {_milliseconds(inputs.passive_ns)} of 5 s"
    return [Finding("link", "link", Effect.STOP, detail)]


def foreign_sender(inputs: RuleInputs) -> Sequence[Finding]:
    """Commands from another sender."""
    if inputs.foreign_sender is None:
        return ()
    # The identifier is no part of the cause's key: there are thousands of them.
    detail = f"{inputs.foreign_sender:08X}"
    return [Finding("foreign_sender", "command", Effect.STOP, detail, latches=True)]


def tick_late(inputs: RuleInputs) -> Sequence[Finding]:
    """Tick too late: the gateway itself was held up."""
    return late(inputs.tick_late_ns, inputs.period_ns)


def late(late_ns: int, period_ns: int) -> Sequence[Finding]:
    """Tick later than 4 periods: its finding; none up to that."""
    if late_ns <= _LATE_MAX_PERIODS * period_ns:
        return ()
    return [Finding("tick_late", "tick", Effect.STOP, _milliseconds(late_ns))]


def emergency_stop(inputs: RuleInputs) -> Sequence[Finding]:
    """Emergency stop requested."""
    return [EMERGENCY_STOP] if inputs.emergency_stop else ()


def gate_blocked(inputs: RuleInputs) -> Sequence[Finding]:
    """Frame blocked by the gate: a bug in the rest of the core."""
    return () if inputs.blocked_by_gate is None else [blocked(inputs.blocked_by_gate)]


def blocked(rule: str) -> Finding:
    """The finding of a frame that breaks this rule of the gate."""
    return Finding("gate", "gate", Effect.STOP, rule, latches=True)


def restart_state(inputs: RuleInputs) -> Sequence[Finding]:
    """Restart state not kept: a restart in this drive begins without it."""
    failure = inputs.restart_state_failure
    if failure is None:
        return ()
    return [Finding("restart_state", "restart state", Effect.ALARM, f"not kept ({failure})")]


def pedals(inputs: RuleInputs) -> Sequence[Finding]:
    """Pedals on CAN that are not believed, or frames of them in a row that are no demand."""
    one = inputs.pedals
    if one is None:
        return ()
    found = [
        Finding("pedal_signal", f"{one.message}.{signal}", Effect.ALARM, detail)
        for signal, detail in one.doubts.items()
    ]
    if one.bad_frames >= _BAD_PEDAL_FRAMES:
        detail = f"{one.bad}, {one.bad_frames} frames in a row"
        found.append(Finding("pedal_frame", one.message, Effect.ALARM, detail))
    return found


def _milliseconds(duration_ns: int) -> str:
    return f"{duration_ns // NS_PER_MS} ms"


_OF_MESSAGES: tuple[Rule, ...] = (
    battery_codes,
    controller_codes,
    battery_late,
    battery_life,
    stale,
    out_of_range,
)
"""Asked in every tick: the place of a rule that fits neither tuple below."""

_OF_DEVIATIONS: tuple[Rule, ...] = (
    throttle_echo,
    echo_below,
    echo_direction,
    speed_steps,
    wheel_speeds,
)
"""Asked where something deviates (`RuleInputs.observed`)."""

_OF_THE_GATEWAY: tuple[Rule, ...] = (
    unconfirmed,
    link_down,
    foreign_sender,
    tick_late,
    emergency_stop,
    gate_blocked,
    restart_state,
    pedals,
)
"""Asked where `_is_odd` says so, which has to know what each of them is about."""

RULES: tuple[Rule, ...] = (*_OF_MESSAGES, *_OF_DEVIATIONS, *_OF_THE_GATEWAY)


def findings(inputs: RuleInputs) -> tuple[Finding, ...]:
    """Findings of every rule; rules that cannot have one are passed by, which takes less time."""
    found: list[Finding] = []
    for rule in _OF_MESSAGES:
        found += rule(inputs)
    if inputs.observed is not NO_DEVIATION:
        for rule in _OF_DEVIATIONS:
            found += rule(inputs)
    if _is_odd(inputs):
        for rule in _OF_THE_GATEWAY:
            found += rule(inputs)
    return tuple(found)


def _is_odd(inputs: RuleInputs) -> bool:
    """Whether a fact about gateway or link is not as in an ordinary tick, whatever the limits."""
    return (
        inputs.link.state is not LinkState.UP
        or inputs.passive_ns > 0
        or inputs.unconfirmed_ticks > 0
        or inputs.foreign_sender is not None
        or inputs.tick_late_ns > inputs.period_ns
        or inputs.emergency_stop
        or inputs.blocked_by_gate is not None
        or inputs.restart_state_failure is not None
        or inputs.pedals is not None
    )
