"""One rule for each reason not to move, or to move less: SAFETY.md's causes.

A rule sees the world and returns what it found; it does not log, remember or command. The
tuple at the bottom is the whole list.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

from vcu_gateway.core.causes import Effect, Finding
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.world import Sent, World

_ALARM, _STOP, _CUT = (Effect.ALARM,), (Effect.STOP,), (Effect.CUT,)
_LIMITS = (Effect.REGEN_LIMIT, Effect.POWER_LIMIT)
_NONE: tuple[Effect, ...] = ()

_STATUS = "BMS_Status"
_MS = 1_000_000
_PASSIVE_MAX_NS = 1_000 * _MS
_ECHO_WINDOW_NS = 1_000 * _MS
_ECHO_TOLERANCE_PCT = 5.0
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

Rule = Callable[[World], Iterator[Finding]]


def battery_codes(world: World) -> Iterator[Finding]:
    """Fault levels of the battery; the last known level counts until another is known."""
    yield from _coded(world, _STATUS, BATTERY_EFFECTS)


def controller_codes(world: World) -> Iterator[Finding]:
    """Protection levels of either controller, for both: one driven wheel turns the vehicle."""
    for controller in CONTROLLERS:
        yield from _coded(world, f"{controller}_Status1", CONTROLLER_EFFECTS)


def _coded(
    world: World, message: str, effects: Mapping[str, tuple[tuple[Effect, ...], ...]]
) -> Iterator[Finding]:
    codes = world.snapshot.codes(message, effects) or ()
    for (signal, by_code), raw in zip(effects.items(), codes, strict=False):
        for effect in by_code[raw]:
            name = world.snapshot.reading(message, signal).code_name
            yield Finding(
                "code",
                f"{message}.{signal}",
                effect,
                f"{raw} ({name or 'reserved'})",
                until_restart=(signal, raw) in UNTIL_RESTART,
            )


def battery_late(world: World) -> Iterator[Finding]:
    """The battery's word is overdue: less of everything until it speaks or is stale."""
    age_ns = world.snapshot.age_ns(_STATUS)
    if age_ns is None or age_ns <= world.late_after_ns[_STATUS]:
        return
    for effect in _LIMITS:
        yield Finding("late", _STATUS, effect, _milliseconds(age_ns))


def battery_life(world: World) -> Iterator[Finding]:
    """The life signal stands still: frames arrive, but nobody may be alive behind them."""
    latest = world.snapshot.latest(_STATUS)
    if latest is None:
        return
    detail = f"unchanged in {latest.life_repeats + 1} frames"
    if latest.life_repeats >= _LIFE_LIMIT_REPEATS:
        for effect in _LIMITS:
            yield Finding("life_signal", f"{_STATUS}.LifeSignal", effect, detail)
    if latest.life_repeats >= _LIFE_STOP_REPEATS:
        yield Finding("life_signal", f"{_STATUS}.LifeSignal", Effect.STOP, detail)


def stale(world: World) -> Iterator[Finding]:
    """A message that is too old, or never came."""
    for message in world.snapshot.messages:
        if not world.snapshot.stale(message.name):
            continue
        age_ns = world.snapshot.age_ns(message.name)
        detail = "never received" if age_ns is None else _milliseconds(age_ns)
        for effect in _effects_of_silence(world, message.name):
            yield Finding("stale", message.name, effect, detail)


def _effects_of_silence(world: World, message: str) -> tuple[Effect, ...]:
    kind = message.partition("_")[2]
    found: tuple[Effect, ...] = _ALARM
    if message == _STATUS or kind == "Status2":
        found = _STOP
    elif kind == "Status1":
        found = (Effect.TURBO_OFF, Effect.POWER_LIMIT)
    if message in world.settings.required and Effect.STOP not in found:
        found = (*found, Effect.STOP)
    return found


def out_of_range(world: World) -> Iterator[Finding]:
    """A signal of a required message cannot be what it says."""
    for message in world.settings.required:
        for signal, raw in world.snapshot.marked(message):
            yield Finding("out_of_range", f"{message}.{signal}", Effect.ALARM, f"raw {raw}")


def throttle_echo(world: World) -> Iterator[Finding]:
    """A controller obeys a throttle that it was not told."""
    for controller in CONTROLLERS:
        message = f"{controller}_Status1"
        latest = world.snapshot.latest(message)
        if latest is None or world.snapshot.stale(message):
            continue
        echoed_pct = world.snapshot.reading(message, "Throttle").value or 0.0
        if echoed_pct <= _ECHO_TOLERANCE_PCT:
            continue  # nothing can have been commanded below 0
        commanded_pct = _highest(world.history.get(controller, ()), latest.arrival_ns)
        if echoed_pct > commanded_pct + _ECHO_TOLERANCE_PCT:
            detail = f"{echoed_pct:.1f} %, commanded {commanded_pct:.1f} %"
            yield Finding("throttle_echo", f"{message}.Throttle", Effect.STOP, detail)


def _highest(history: Sequence[Sent], until_ns: int) -> float:
    """The highest throttle in force during the second before `until_ns`."""
    from_ns = until_ns - _ECHO_WINDOW_NS
    recent = [sent.throttle_pct for sent in history if from_ns <= sent.at_ns <= until_ns]
    return max(recent, default=0.0)


def unconfirmed(world: World) -> Iterator[Finding]:
    """Our frames do not leave: what we decide does not reach the motors."""
    if world.settings.expect_echo and world.unconfirmed_ticks >= _UNCONFIRMED_MAX_TICKS:
        detail = f"for {world.unconfirmed_ticks} ticks"
        yield Finding("unconfirmed", "own frames", Effect.STOP, detail)


def link_down(world: World) -> Iterator[Finding]:
    """The bus does not carry frames, or hardly."""
    link = world.link
    since_ns = world.snapshot.now_ns - link.since_ns
    passive = link.state is LinkState.PASSIVE and since_ns > _PASSIVE_MAX_NS
    if passive or link.state in (LinkState.BUS_OFF, LinkState.LOST):
        yield Finding("link", "link", Effect.STOP, link.state.value)


def foreign_sender(world: World) -> Iterator[Finding]:
    """Somebody else commands the motors."""
    if world.foreign_sender is not None:
        subject = f"command {world.foreign_sender:08X}"
        yield Finding("foreign_sender", subject, Effect.STOP, latches=True)


def tick_late(world: World) -> Iterator[Finding]:
    """The gateway itself was away."""
    if world.tick_late_ns > _LATE_MAX_PERIODS * world.period_ns:
        yield Finding("tick_late", "tick", Effect.STOP, _milliseconds(world.tick_late_ns))


def emergency_stop(world: World) -> Iterator[Finding]:
    """Somebody pressed it."""
    if world.emergency_stop:
        yield Finding("emergency_stop", "emergency stop", Effect.CUT, "requested")


def gate_blocked(world: World) -> Iterator[Finding]:
    """The gate stopped a frame that the rest of the core wanted to send: a bug."""
    if world.blocked_by_gate is not None:
        yield Finding("gate", "gate", Effect.STOP, world.blocked_by_gate, latches=True)


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
    unconfirmed,
    link_down,
    foreign_sender,
    tick_late,
    emergency_stop,
    gate_blocked,
)


def findings(world: World) -> tuple[Finding, ...]:
    """Everything that every rule finds."""
    return tuple(finding for rule in RULES for finding in rule(world))
