"""Command rules: what each command frame must be, beside the ones before it and what is asked.

The gate's rules and the invariants of docs/safety.md, on bytes. A rule yields its short name and
what was seen; `broken` runs all of them on one frame, `FramePairs` those on both frames of a tick.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from vcu_gateway.judge.causes import CUT, POWER_LIMIT, REGEN_LIMIT, REGEN_OFF, STOP, TURBO_OFF
from vcu_gateway.judge.limits import JudgedDemand, VerdictLimits
from vcu_gateway.judge.tuning_rules import TuningCaps
from vcu_gateway.judge.wire import (
    CONTROLLERS,
    HIGHEST_RAW,
    LENGTH,
    MOTOR_HIGHEST_RPM,
    MS,
    PERCENT_PER_BIT,
    REVERSE,
    SAFETY_MODE,
    CommandBytes,
)

_FULL_PCT = 100.0


class LimitRamps:
    """Limits of both controllers on their way along the slews.

    Attributes:
        power_w, brake_pct: by controller.
    """

    def __init__(self, limits: VerdictLimits) -> None:
        self.power_w = dict.fromkeys(CONTROLLERS, limits.power_limit_max_w)
        self.brake_pct = dict.fromkeys(CONTROLLERS, _FULL_PCT)

    def move(
        self,
        effects: set[str],
        caps: TuningCaps,
        limits: VerdictLimits,
        told: dict[str, bytes],
        elapsed_s: float,
    ) -> None:
        """One tick; `told` are the commands that left last, a falling limit starts from them."""
        power_w = min(limits.power_limit_max_w, caps.power_w)
        brake_pct = min(_FULL_PCT, caps.brake_pct)
        if POWER_LIMIT in effects:
            power_w = min(limits.derated["power_limit_w"], power_w)
        if REGEN_LIMIT in effects:
            brake_pct = min(limits.derated["brake_pct"], brake_pct)
        power_step_w = limits.power_slew_w_per_s * elapsed_s
        brake_step_pct = limits.regen_slew_pct_per_s * elapsed_s
        for name in CONTROLLERS:
            data = told.get(name, bytes(8))
            told_pct = _FULL_PCT if data[2] == HIGHEST_RAW else data[2] * PERCENT_PER_BIT
            told_w = data[6] | data[7] << 8
            self.power_w[name] = _moved(self.power_w[name], told_w, power_w, power_step_w)
            self.brake_pct[name] = _moved(self.brake_pct[name], told_pct, brake_pct, brake_step_pct)
            if REGEN_OFF in effects:
                self.brake_pct[name] = 0.0


def _moved(limit: float, told: float, target: float, step: float) -> float:
    if target >= limit:
        return min(target, limit + step)
    return max(target, min(limit, told) - step)


class SentFrame(NamedTuple):
    """A command frame of one tick, and whether the bus took it."""

    can_id: int
    data: bytes
    left: bool


SentFrames = Mapping[str, SentFrame]
"""Frames of a tick, by controller."""


class FramePairs:
    """Listening time and pairs, from tick to tick; `complete`: from the gateway's start on."""

    def __init__(self, *, complete: bool) -> None:
        self._complete = complete
        self._talking = False
        self._quiet_until_ns: int | None = None

    def listen(self, limits: VerdictLimits, now_ns: int) -> None:
        self._quiet_until_ns = now_ns + round(limits.listen_before_talk_ms * MS)

    def broken(
        self, sent: SentFrames, limits: VerdictLimits, now_ns: int, *, disturbed: bool
    ) -> Iterator[tuple[str, str]]:
        """Rules that the frames of a tick break together; `disturbed`: it has to listen again."""
        if disturbed and not self._talking:
            self.listen(limits, now_ns)
        until_ns = self._quiet_until_ns if self._complete else None
        has_to = self._talking or (until_ns is not None and now_ns >= until_ns)
        if len(sent) not in (0, len(CONTROLLERS)) or (not sent and has_to):
            yield "I13 both frames in every tick", f"{len(sent)} frames"
        if sent and until_ns is not None and not has_to:
            yield "listening before talking", "a frame while it has to listen"
        self._talking = self._talking or bool(sent)
        if not limits.independent_directions and _two_directions(sent):
            yield "gate directions", "throttle with two directions"


def _two_directions(sent: SentFrames) -> bool:
    whole = [one.data for one in sent.values() if len(one.data) == LENGTH]
    return len({data[0] & REVERSE for data in whole}) > 1 and any(data[1] for data in whole)


_SPEED_LIMIT_MIN_RPM = 500
# Half a bit now and half a bit before.
_ROUNDING = 1.0
_HALF_BIT = 0.51
_CONFLICT_THROTTLE_PCT, _CONFLICT_BRAKE_PCT = 25.2, 5.2
_ECO, _TURBO = 0, 2
_APART_STEPS = 4
_SAFETY_BITS = 0x0C
_NS_PER_S = 1_000_000_000

Broken = Iterator[tuple[str, str]]
"""Short name of the rule, and what was seen."""


class TickFacts(NamedTuple):
    """What the judge knows at a tick.

    Attributes:
        mode: the recorded one; active: it is ACTIVE.
        effects: every effect that counts.
        caps: what tuning allows.
        speeds_rpm: every known speed of both motors; None where one is not known.
        regenerates: both are known to turn fast enough.
        released: the throttle of the last command to each controller was below 5 %.
        cut: a CUT stands or is latched.
        holds: reasons for a throttle of 0.
        elapsed_ns: since the tick before, at most a period.
    """

    limits: VerdictLimits
    mode: str
    effects: set[str]
    caps: TuningCaps
    speeds_rpm: list[int] | None
    regenerates: bool
    released: bool
    cut: bool
    holds: set[str]
    ramps: LimitRamps
    elapsed_ns: int
    now_ns: int

    @property
    def active(self) -> bool:
        return self.mode == "active"

    @property
    def slow(self) -> bool:
        """Both motors are known to turn below the change speed."""
        speeds_rpm, limit_rpm = self.speeds_rpm, self.limits.direction_change_rpm
        return speeds_rpm is not None and all(rpm < limit_rpm for rpm in speeds_rpm)


class SentBefore(NamedTuple):
    """The command of a controller that left last."""

    command: CommandBytes
    at_ns: int


class Judged(NamedTuple):
    """A command, the one before it and the demand for its controller; None where unknown."""

    controller: str
    command: CommandBytes
    before: SentBefore | None
    demanded: JudgedDemand | None


def broken(one: Judged, facts: TickFacts) -> Broken:
    """Every rule that a command breaks."""
    yield from _shape(one, facts)
    yield from _speed_limit(one, facts)
    if one.before is not None:
        yield from _direction(one, one.before, facts)
    if not facts.active:
        if not one.command.safe:
            yield "I2 zero torque outside ACTIVE", _seen(one.command)
        return
    yield from _effects(one, facts)
    yield from _power_mode(one, facts)
    yield from _throttle(one, facts)
    yield from _ramps(one, facts)
    yield from _tuning(one, facts)
    if one.demanded is not None:
        yield from _as_demanded(one, one.demanded)


def _seen(command: CommandBytes) -> str:
    throttle_pct = command.throttle_raw * PERCENT_PER_BIT
    brake_pct = command.brake_raw * PERCENT_PER_BIT
    return f"throttle {throttle_pct:.1f} %, brake {brake_pct:.1f} %, {command.power_limit_w} W"


def _shape(one: Judged, facts: TickFacts) -> Broken:
    command = one.command
    if command.unused:
        yield "gate unused bits", f"{command.unused:#06x} instead of 0"
    if facts.cut and not command.cut:
        yield "I6 POWER_CUT while a CUT stands", "PowerCut is 0"
    if command.cut and not command.safe:
        yield "gate POWER_CUT without torque", _seen(command)
    throttle_pct = command.throttle_raw * PERCENT_PER_BIT
    brake_pct = command.brake_raw * PERCENT_PER_BIT
    if throttle_pct > _CONFLICT_THROTTLE_PCT and brake_pct > _CONFLICT_BRAKE_PCT:
        yield "I11 throttle and brake", _seen(command)


def _speed_limit(one: Judged, facts: TickFacts) -> Broken:
    """What is demanded, else the maximum, or less where it is capped; it falls along the slew."""
    rpm, limits = one.command.speed_limit_rpm, facts.limits
    highest_rpm = lowest_rpm = limits.speed_limit_max_rpm
    if facts.active and one.demanded is None:
        lowest_rpm = _SPEED_LIMIT_MIN_RPM
    elif facts.active and one.demanded is not None:
        asked_rpm = max(one.demanded.speed_limit_rpm, _SPEED_LIMIT_MIN_RPM)
        highest_rpm = lowest_rpm = min(asked_rpm, highest_rpm)
    if one.before is not None:
        step_rpm = limits.speed_slew_rpm_per_s * facts.elapsed_ns / _NS_PER_S
        falls_to_rpm = one.before.command.speed_limit_rpm - step_rpm
        highest_rpm, lowest_rpm = max(highest_rpm, falls_to_rpm), max(lowest_rpm, falls_to_rpm)
    if facts.mode in ("standby", "active") and limits.holds_speed:
        capped_rpm, least_rpm = _capped_speed(one, facts)
        lowest_rpm = min(lowest_rpm, least_rpm)
        if rpm > capped_rpm + _ROUNDING:
            yield "I1 SpeedLimit", f"{rpm} rpm, at most {capped_rpm:.0f}"
    rounding_rpm = _ROUNDING if highest_rpm != limits.speed_limit_max_rpm else 0
    if rpm > highest_rpm + rounding_rpm or rpm < _SPEED_LIMIT_MIN_RPM:
        yield "gate SpeedLimit", f"{rpm} rpm, not {lowest_rpm:.0f} to {highest_rpm:.0f}"
    elif rpm < lowest_rpm - _ROUNDING:
        yield "gate SpeedLimit slew", f"{rpm} rpm, at least {lowest_rpm:.0f}"


def _capped_speed(one: Judged, facts: TickFacts) -> tuple[float, float]:
    """Most that tuning allows on the way down to its cap, and least that it may come down to."""
    limits, cap_rpm = facts.limits, facts.caps.speed_rpm
    if one.before is None:
        return math.inf, _SPEED_LIMIT_MIN_RPM
    slew = limits.speed_slew_rpm_per_s
    surely = maybe = min(slew, limits.speed_fall_rpm_per_s)
    if not facts.active:
        # The judge doubts the speed of a motor that the core may believe.
        if facts.speeds_rpm is None:
            maybe = slew
        elif max(facts.speeds_rpm) < min(cap_rpm, MOTOR_HIGHEST_RPM + 1):
            surely = maybe = slew
    elapsed_s, before_rpm = facts.elapsed_ns / _NS_PER_S, one.before.command.speed_limit_rpm
    return max(cap_rpm, before_rpm - surely * elapsed_s), before_rpm - maybe * elapsed_s


def _direction(one: Judged, before: SentBefore, facts: TickFacts) -> Broken:
    command, then = one.command, before.command
    if command.reverse is then.reverse:
        return
    if command.throttle_raw or then.throttle_raw:
        yield "I12 direction", "changes with throttle"
    if not facts.slow:
        limit_rpm = facts.limits.direction_change_rpm
        yield "I12 direction", f"changes while a motor is unknown or not below {limit_rpm:g} rpm"


def _effects(one: Judged, facts: TickFacts) -> Broken:
    command, effects = one.command, facts.effects
    if effects & {STOP, CUT} and not command.safe:
        yield "a STOP or CUT leaves no torque", _seen(command)
    if command.cut:
        yield "POWER_CUT in ACTIVE", "without a cause that cuts"
    if TURBO_OFF in effects and command.power_mode == _TURBO:
        yield "TURBO_OFF", "PowerMode is turbo"
    if POWER_LIMIT in effects and command.power_mode not in (_ECO, SAFETY_MODE):
        yield "POWER_LIMIT", f"PowerMode is {command.power_mode}, not eco"
    if REGEN_OFF in effects and (command.regenerates or command.brake_raw):
        yield "I10 regeneration", f"though it is off: {_seen(command)}"
    if command.regenerates and not facts.regenerates:
        least_rpm = facts.limits.regen_min_rpm
        yield "I10 regeneration", f"with a motor unknown or below {least_rpm:g} rpm"


def _rank(power_mode: int) -> int:
    """Place among safety, eco, normal, turbo."""
    return (power_mode + 1) % 4


def _power_mode(one: Judged, facts: TickFacts) -> Broken:
    if one.before is None or facts.released:
        return
    mode, then = one.command.power_mode, one.before.command.power_mode
    if _rank(mode) > _rank(then):
        yield "gate PowerMode rise", f"from {then} to {mode} while a throttle is not below 5 %"


def _throttle(one: Judged, facts: TickFacts) -> Broken:
    raw = one.command.throttle_raw
    if not raw:
        return
    if one.command.power_mode == SAFETY_MODE:
        yield "gate throttle in PowerMode safety", _seen(one.command)
    if facts.holds:
        yield "throttle held at 0", f"{', '.join(sorted(facts.holds))}: {_seen(one.command)}"
    if one.before is None:
        return
    elapsed_ns = min(max(facts.now_ns - one.before.at_ns, 0), facts.limits.period_ns)
    rise_pct_per_s = min(facts.limits.throttle_slew_pct_per_s, facts.caps.rise_pct_per_s)
    earned_pct = rise_pct_per_s * elapsed_ns / _NS_PER_S
    then = one.before.command.throttle_raw
    if raw > then + earned_pct / PERCENT_PER_BIT + _ROUNDING + 1e-6:
        rise = f"from {then * PERCENT_PER_BIT:.1f} to {raw * PERCENT_PER_BIT:.1f} %"
        yield "I3 throttle slew", f"{rise} in {elapsed_ns / 1e6:.1f} ms"


def _ramps(one: Judged, facts: TickFacts) -> Broken:
    power_w = facts.ramps.power_w[one.controller]
    rounding_w = _ROUNDING if power_w != facts.limits.power_limit_max_w else 0
    if one.command.power_limit_w > power_w + rounding_w:
        yield "I1 PowerLimit", f"{one.command.power_limit_w} W, at most {power_w:.0f}"
    brake_pct = facts.ramps.brake_pct[one.controller]
    if one.command.brake_raw * PERCENT_PER_BIT > brake_pct + PERCENT_PER_BIT:
        yield "I1 Brake", f"{_seen(one.command)}, at most {brake_pct:.1f} %"


def _tuning(one: Judged, facts: TickFacts) -> Broken:
    command, caps, ramps = one.command, facts.caps, facts.ramps
    if _rank(command.power_mode) > _rank(caps.power_mode):
        yield "PowerMode of the drive mode", f"{command.power_mode}, at most {caps.power_mode}"
    throttle_pct = caps.throttle_pct[one.controller]
    if command.throttle_raw > throttle_pct / PERCENT_PER_BIT + _HALF_BIT:
        yield "I1 Throttle", f"{_seen(command)}, at most {throttle_pct:.1f} %"
    if one.before is None:
        return
    # From the frame after the first code of 0 on: a limit of less than half a bit may be behind it.
    before, name = one.before.command, one.controller
    if not (caps.power_w or ramps.power_w[name] or before.power_limit_w) and command.throttle_raw:
        yield "no throttle where a cap of power is 0", _seen(command)
    if not (caps.brake_pct or ramps.brake_pct[name] or before.brake_raw) and command.regenerates:
        yield "I10 regeneration", "where a cap of Brake is 0"


def asymmetry(
    sent: SentFrames,
    before: Mapping[str, SentBefore],
    demands: Mapping[str, JudgedDemand | None],
    limits: VerdictLimits,
) -> Broken:
    """Throttles of equal demands that drift apart."""
    first, second = (demands.get(name) for name in CONTROLLERS)
    whole = all(name in sent and len(sent[name].data) == LENGTH for name in CONTROLLERS)
    if first is None or first != second or not whole or len(before) != len(CONTROLLERS):
        return
    if any(sent[name].data[0] & _SAFETY_BITS == _SAFETY_BITS for name in CONTROLLERS):
        return  # it is held at 0 until its PowerMode may rise
    apart = abs(sent["PCU1"].data[1] - sent["PCU2"].data[1])
    then = abs(before["PCU1"].command.throttle_raw - before["PCU2"].command.throttle_raw)
    most_pct = 0.0 if limits.slip is None else limits.slip["asymmetry_max_pct"]
    most_pct += _APART_STEPS * limits.throttle_slew_pct_per_s * limits.period_ns / _NS_PER_S
    if apart > max(then, most_pct / PERCENT_PER_BIT) + _ROUNDING:
        seen = f"throttles {apart * PERCENT_PER_BIT:.1f} % apart, at most {most_pct:.1f} %"
        yield "gate asymmetry", seen


def _as_demanded(one: Judged, demanded: JudgedDemand) -> Broken:
    command = one.command
    if command.throttle_raw > demanded.throttle_pct / PERCENT_PER_BIT + _HALF_BIT:
        yield "I1 throttle as demanded", f"{_seen(command)}, demanded {demanded.throttle_pct:g} %"
    if command.brake_raw > demanded.brake_pct / PERCENT_PER_BIT + _HALF_BIT:
        yield "I1 brake as demanded", f"{_seen(command)}, demanded {demanded.brake_pct:g} %"
    if command.power_limit_w > demanded.power_limit_w + _ROUNDING:
        yield "I1 power as demanded", f"{_seen(command)}, demanded {demanded.power_limit_w:g} W"
    if _rank(command.power_mode) > _rank(demanded.power_mode):
        yield "PowerMode as demanded", f"{command.power_mode}, demanded {demanded.power_mode}"
    if command.regenerates and not demanded.regen_brake:
        yield "I10 regeneration", "nobody demanded it"
    if command.throttle_raw and command.reverse is not demanded.motor_reverse:
        yield "I12 direction", "throttle while a change of direction waits"
