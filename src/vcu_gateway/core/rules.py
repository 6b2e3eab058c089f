"""One rule for each reason not to move, or to move less: SAFETY.md's causes.

A rule sees the world and returns what it found; it does not log, remember or command. The
tuple at the bottom is the whole list.
"""

import functools
from collections.abc import Callable, Iterator, Mapping

from vcu_gateway.core.causes import Effect, Finding
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.plausibility import WHEELS_MESSAGE
from vcu_gateway.core.rule_inputs import RuleInputs

_ALARM, _STOP, _CUT = (Effect.ALARM,), (Effect.STOP,), (Effect.CUT,)
_LIMITS = (Effect.REGEN_LIMIT, Effect.POWER_LIMIT)
_NONE: tuple[Effect, ...] = ()

_STATUS = "BMS_Status"
_MS = 1_000_000
_PASSIVE_MAX_NS = 1_000 * _MS
_ECHO_FRAMES = 2
_WHEELS_APART_NS = 1_000 * _MS
_UNCONFIRMED_MAX_TICKS = 3
_LATE_MAX_PERIODS = 4
_LIFE_LIMIT_REPEATS = 1
_LIFE_STOP_REPEATS = 2

BATTERY_EFFECTS: Mapping[str, tuple[tuple[Effect, ...], ...]] = {
    "CellOvervoltage": (_NONE, (Effect.REGEN_LIMIT,), (Effect.REGEN_OFF,), (Effect.REGEN_OFF,)),
    "CellUndervoltage": (_NONE, (Effect.POWER_LIMIT,), _STOP, _CUT),
    "DischargeOvercurrent": (_NONE, _LIMITS, _CUT, _CUT),
    "TemperatureImbalance": (_NONE, _ALARM, _ALARM, _ALARM),
    "Overtemperature": (_NONE, _ALARM, _CUT, _CUT),
    "Undertemperature": (_NONE, (Effect.REGEN_OFF,), _CUT, _CUT),
    "VoltageImbalance": (_NONE, _ALARM),
    "InternalFault": (_NONE, _CUT),
}
"""Effects of each code of BMS_Status; a reserved code is the worst (PROTOCOL.md E13)."""

UNTIL_RESTART = {("CellOvervoltage", 3)}

CONTROLLER_EFFECTS: Mapping[str, tuple[tuple[Effect, ...], ...]] = {
    "TemperatureProtectLevel": (_NONE, (Effect.TURBO_OFF,), _STOP, _STOP),
    "VoltageLevel": (
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
        (Effect.POWER_LIMIT,),
        _NONE,
        _NONE,
        _NONE,
        (Effect.REGEN_OFF,),
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
        (Effect.POWER_LIMIT, Effect.REGEN_OFF),
    ),
}
"""Effects of each code of a controller's Status1."""

_EFFECTS = {
    _STATUS: BATTERY_EFFECTS,
    **{f"{controller}_Status1": CONTROLLER_EFFECTS for controller in CONTROLLERS},
}
_CODED = {message: tuple(effects) for message, effects in _EFFECTS.items()}

Rule = Callable[[RuleInputs], Iterator[Finding]]


def battery_codes(world: RuleInputs) -> Iterator[Finding]:
    """Fault levels of the battery; the last known level counts until another is known."""
    yield from _coded(world, _STATUS)


def controller_codes(world: RuleInputs) -> Iterator[Finding]:
    """Protection levels of either controller, for both: one driven wheel turns the vehicle."""
    for controller in CONTROLLERS:
        yield from _coded(world, f"{controller}_Status1")


def _coded(world: RuleInputs, message: str) -> Iterator[Finding]:
    for codes in world.snapshot.codes(message, _CODED[message]):
        for signal, raw, effect in _effects_of(message, codes):
            name = world.snapshot.code_name(message, signal, raw)
            yield Finding(
                "code",
                f"{message}.{signal}",
                effect,
                f"{raw} ({name or 'reserved'})",
                until_restart=(signal, raw) in UNTIL_RESTART,
            )


# The same few rows come again and again.
@functools.lru_cache(maxsize=64)
def _effects_of(message: str, codes: tuple[int, ...]) -> tuple[tuple[str, int, Effect], ...]:
    """Signal, code and effect of every code that has one."""
    coded = zip(_EFFECTS[message].items(), codes, strict=True)
    return tuple((name, raw, effect) for (name, by), raw in coded for effect in by[raw])


def battery_late(world: RuleInputs) -> Iterator[Finding]:
    """The battery's word is overdue: less of everything until it speaks or is stale."""
    age_ns = world.snapshot.age_ns(_STATUS)
    if age_ns is None or age_ns <= world.late_after_ns[_STATUS]:
        return
    for effect in _LIMITS:
        yield Finding("late", _STATUS, effect, _milliseconds(age_ns))


def battery_life(world: RuleInputs) -> Iterator[Finding]:
    """The life signal stands still: frames arrive, but nobody may be alive behind them."""
    repeats = max([frame.life_repeats for frame in world.snapshot.judged(_STATUS)], default=0)
    if repeats < _LIFE_LIMIT_REPEATS:
        return
    detail = f"unchanged in {repeats + 1} frames"
    for effect in _LIMITS:
        yield Finding("life_signal", f"{_STATUS}.LifeSignal", effect, detail)
    if repeats >= _LIFE_STOP_REPEATS:
        yield Finding("life_signal", f"{_STATUS}.LifeSignal", Effect.STOP, detail)


def stale(world: RuleInputs) -> Iterator[Finding]:
    """A message that is too old, or never came."""
    for message in world.snapshot.stale_messages():
        age_ns = world.snapshot.age_ns(message)
        detail = "never received" if age_ns is None else _milliseconds(age_ns)
        for effect in _effects_of_silence(world, message):
            yield Finding("stale", message, effect, detail)


def _effects_of_silence(world: RuleInputs, message: str) -> tuple[Effect, ...]:
    kind = message.partition("_")[2]
    found: tuple[Effect, ...] = _ALARM
    if message == _STATUS or kind == "Status2":
        found = _STOP
    elif kind == "Status1":
        found = (Effect.TURBO_OFF, Effect.POWER_LIMIT)
    if message in world.settings.required and Effect.STOP not in found:
        found = (*found, Effect.STOP)
    return found


def out_of_range(world: RuleInputs) -> Iterator[Finding]:
    """A signal of a required message cannot be what it says."""
    for message in world.settings.required:
        for signal, raw in world.snapshot.marked(message):
            yield Finding("out_of_range", f"{message}.{signal}", Effect.ALARM, f"raw {raw}")


def throttle_echo(world: RuleInputs) -> Iterator[Finding]:
    """A controller obeys a throttle that it was not told."""
    for controller, excess in world.observed.echo_above.items():
        message = f"{controller}_Status1"
        if not world.snapshot.stale(message):
            detail = f"{excess.echoed_pct:.1f} %, commanded {excess.commanded_pct:.1f} %"
            yield Finding("throttle_echo", f"{message}.Throttle", Effect.STOP, detail)


def echo_below(world: RuleInputs) -> Iterator[Finding]:
    """A controller does less than it was told; where both do, nothing turns the vehicle."""
    runs = _runs(world, world.observed.echo_below)
    for controller, run in runs.items():
        if run >= _ECHO_FRAMES:
            # The other one's last frame counts: what it obeys now it drives with.
            others = set(CONTROLLERS) - {controller}
            both = others <= world.observed.echoes_below & runs.keys()
            effect = Effect.ALARM if both else Effect.STOP
            detail = f"does not obey, in {run} frames"
            yield Finding("echo_below", f"{controller}_Status1.Throttle", effect, detail)


def echo_direction(world: RuleInputs) -> Iterator[Finding]:
    """A controller turns the other way round."""
    for controller, run in _runs(world, world.observed.echo_direction).items():
        if run >= _ECHO_FRAMES:
            subject = f"{controller}_Status1.MotorReverse"
            detail = f"not as commanded, in {run} frames"
            yield Finding("echo_direction", subject, Effect.STOP, detail)


def _runs(world: RuleInputs, runs: Mapping[str, int]) -> Mapping[str, int]:
    """Frames in a row, of each controller whose word is not stale."""
    stale = world.snapshot.stale
    return {name: run for name, run in runs.items() if not stale(f"{name}_Status1")}


def speed_steps(world: RuleInputs) -> Iterator[Finding]:
    """A motor's speed changed as no motor does: it is not believed for a while."""
    for controller, step_rpm in world.observed.speed_steps_rpm.items():
        subject = f"{controller}_Status2.MotorSpeed"
        yield Finding("speed_step", subject, Effect.ALARM, f"changed by {step_rpm:.0f} rpm")


def wheel_speeds(world: RuleInputs) -> Iterator[Finding]:
    """A wheel's speed changed as no wheel's does, or both wheels disagree for long."""
    for wheel, step_kmh in world.observed.wheel_steps_kmh.items():
        subject, detail = f"{WHEELS_MESSAGE}.{wheel}", f"changed by {step_kmh:.1f} km/h"
        yield Finding("wheel_speed_step", subject, Effect.ALARM, detail)
    apart_ns = world.observed.wheels_apart_ns
    if apart_ns is None or world.snapshot.stale(WHEELS_MESSAGE):
        return
    if apart_ns >= _WHEELS_APART_NS:
        detail = f"wheels differ for {_milliseconds(apart_ns)}"
        yield Finding("wheel_speed_difference", WHEELS_MESSAGE, Effect.ALARM, detail)


def unconfirmed(world: RuleInputs) -> Iterator[Finding]:
    """Our frames do not leave: what we decide does not reach the motors."""
    if world.unconfirmed_ticks >= _UNCONFIRMED_MAX_TICKS:
        detail = f"for {world.unconfirmed_ticks} ticks"
        yield Finding("unconfirmed", "own frames", Effect.STOP, detail)


def link_down(world: RuleInputs) -> Iterator[Finding]:
    """The bus does not carry frames, or hardly."""
    state = world.link.state
    if state in (LinkState.BUS_OFF, LinkState.LOST):
        yield Finding("link", "link", Effect.STOP, state.value)
    elif world.passive_ns > _PASSIVE_MAX_NS:
        detail = f"{LinkState.PASSIVE.value} for {_milliseconds(world.passive_ns)} of 5 s"
        yield Finding("link", "link", Effect.STOP, detail)


def foreign_sender(world: RuleInputs) -> Iterator[Finding]:
    """Somebody else commands the motors."""
    if world.foreign_sender is not None:
        # The identifier is no part of the cause's key: there are thousands of them.
        detail = f"{world.foreign_sender:08X}"
        yield Finding("foreign_sender", "command", Effect.STOP, detail, latches=True)


def tick_late(world: RuleInputs) -> Iterator[Finding]:
    """The gateway itself was away."""
    yield from late(world.tick_late_ns, world.period_ns)


def late(late_ns: int, period_ns: int) -> Iterator[Finding]:
    """The finding of a tick that comes so long after its period, where that is too long."""
    if late_ns > _LATE_MAX_PERIODS * period_ns:
        yield Finding("tick_late", "tick", Effect.STOP, _milliseconds(late_ns))


def emergency_stop(world: RuleInputs) -> Iterator[Finding]:
    """Somebody pressed it."""
    if world.emergency_stop:
        yield Finding("emergency_stop", "emergency stop", Effect.CUT, "requested")


def gate_blocked(world: RuleInputs) -> Iterator[Finding]:
    """The gate stopped a frame that the rest of the core wanted to send: a bug."""
    if world.blocked_by_gate is not None:
        yield blocked(world.blocked_by_gate)


def blocked(rule: str) -> Finding:
    """The finding of a frame that breaks this rule of the gate."""
    return Finding("gate", "gate", Effect.STOP, rule, latches=True)


def _milliseconds(duration_ns: int) -> str:
    return f"{duration_ns // _MS} ms"


RULES: tuple[Rule, ...] = (
    battery_codes,
    controller_codes,
    battery_late,
    battery_life,
    stale,
    out_of_range,
    throttle_echo,
    echo_below,
    echo_direction,
    speed_steps,
    wheel_speeds,
    unconfirmed,
    link_down,
    foreign_sender,
    tick_late,
    emergency_stop,
    gate_blocked,
)


def findings(world: RuleInputs) -> tuple[Finding, ...]:
    """Everything that every rule finds."""
    found: list[Finding] = []
    for rule in RULES:
        found.extend(rule(world))
    return tuple(found)
