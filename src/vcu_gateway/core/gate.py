"""Gate: the last check of every command frame, independent of the rest of the core.

Written against the bytes of the command frame and the protocol's limits alone; it imports
nothing of the rules, the supervisor or the commands. Where a frame breaks a rule here
the gateway sends safe frames instead; the safe frame always passes.
"""

from dataclasses import dataclass, field
from typing import Protocol

# Byte 1 of the command frame.
_MODE_MASK, _MODE_SAFETY = 0b0000_1100, 0b0000_1100
_REVERSE, _REGEN = 0x10, 0x20
_UNUSED = 0b0100_0011
# Safety allows least, then eco, normal, turbo.
_RISING = (0b1100, 0b0000, 0b0100, 0b1000)
_RELEASED_RAW = 12

_LENGTH = 8
_SPEED_LIMIT_MIN_RPM = 500
# Half a bit now and half a bit before.
_ROUNDING = 1
_PERCENT_PER_BIT = 0.39
_HALF_BIT_PCT, _HALF_BIT_W = 0.195 + 1e-6, 0.5 + 1e-6  # and what a sum of floats is off by
# Ticks of which a controller's frame may not have left, before that stops the drive.
_UNSENT_STEPS = 4
_NS_PER_S = 1_000_000_000


class GateLimits(Protocol):
    """Limits that the gate holds every frame against; the settings have them.

    Attributes:
        throttle_slew_pct_per_s: steepest rise; a fall is always allowed.
        period_ns: more time than this since the last frame earns no more rise.
        direction_change_rpm: the direction changes only below this speed of both motors.
        power_slew_w_per_s, speed_slew_rpm_per_s: how fast a limit comes down to a maximum that
            has become stricter; SpeedLimit never falls faster.
        regen_min_rpm: below it no motor regenerates; 0 switches this off.
        independent_directions: throttle also where the slots have two directions.
        asymmetry_max_pct: most by which the throttles may differ where their demands do not.
    """

    @property
    def speed_limit_max_rpm(self) -> float: ...
    @property
    def power_limit_max_w(self) -> float: ...
    @property
    def throttle_slew_pct_per_s(self) -> float: ...
    @property
    def direction_change_rpm(self) -> float: ...
    @property
    def period_ns(self) -> int: ...
    @property
    def power_slew_w_per_s(self) -> float: ...
    @property
    def speed_slew_rpm_per_s(self) -> float: ...
    @property
    def regen_min_rpm(self) -> float: ...
    @property
    def independent_directions(self) -> bool: ...
    @property
    def asymmetry_max_pct(self) -> float: ...


class Demanded(Protocol):
    """What is demanded of one controller."""

    @property
    def throttle_pct(self) -> float: ...
    @property
    def brake_pct(self) -> float: ...
    @property
    def power_limit_w(self) -> float: ...


@dataclass(slots=True)
class _Sent:
    data: bytes
    at_ns: int


@dataclass(slots=True)
class Gate:
    """Checks each slot's frame against the last one of it that was really sent.

    Attributes:
        allowed: identifier of the one frame of each slot; anything else is blocked.
        blocked: frames not to be sent, by the name of the rule they broke.
    """

    allowed: tuple[int, ...]
    limits: GateLimits
    blocked: dict[str, int] = field(default_factory=dict)
    _sent: dict[int, _Sent] = field(default_factory=dict)

    def check(
        self,
        slot: int,
        can_id: int,
        data: bytes,
        *,
        armed: bool,
        demanded: Demanded | None,
        speeds_rpm: tuple[float | None, ...],
        now_ns: int,
    ) -> str | None:
        """Name of the rule that the frame of a slot breaks; None where it may be sent.

        `demanded` is None without a fresh demand of the controller, `speeds_rpm` the last known
        speed of each motor, None where it is not known.
        """
        own_id, sent = self.allowed[slot], self._sent.get(slot)
        why = self._fault(can_id == own_id, data, armed, demanded, speeds_rpm, sent, now_ns)
        return None if why is None else self._counted(why)

    def check_both(self, first: bytes, second: bytes, demanded_alike: bool) -> str | None:
        """As `check`, of the throttles of one tick's frames together.

        Where the demands are alike the difference is within its limit, or does not grow: after
        different demands one of them may have to come up first. A PowerMode that waits for the
        pedal's release holds the throttle of its controller at 0 in SAFETY.
        """
        apart_raw = abs(first[1] - second[1]) - _ROUNDING
        if apart_raw <= 0 or not demanded_alike:
            return None
        if _MODE_SAFETY in (first[0] & _MODE_MASK, second[0] & _MODE_MASK):
            return None
        limits, sent = self.limits, [one.data[1] for one in self._sent.values()]
        step_pct = limits.throttle_slew_pct_per_s * limits.period_ns / _NS_PER_S
        most_pct = limits.asymmetry_max_pct + _UNSENT_STEPS * step_pct
        before_raw = max(sent, default=0) - min(sent, default=0)
        if apart_raw <= before_raw or apart_raw * _PERCENT_PER_BIT <= most_pct:
            return None
        return self._counted("asymmetry")

    def _counted(self, why: str) -> str:
        self.blocked[why] = self.blocked.get(why, 0) + 1
        return why

    def sent(self, slot: int, data: bytes, at_ns: int) -> None:
        """Remember the frame of a slot that has really been handed to the bus."""
        self._sent[slot] = _Sent(bytes(data), at_ns)

    def _fault(
        self,
        own_id: bool,
        data: bytes,
        armed: bool,
        demanded: Demanded | None,
        speeds_rpm: tuple[float | None, ...],
        sent: _Sent | None,
        now_ns: int,
    ) -> str | None:
        if not own_id:
            return "identifier"
        if len(data) != _LENGTH:
            return "length"
        if data[0] & _UNUSED or data[3]:
            return "unused_bits"
        if why := self._speed_limit_fault(_word(data, 4), sent):
            return why
        if self._turned(data, sent, speeds_rpm):
            return "direction"
        if _is_safe(data):
            return None
        return self._torque_fault(data, armed, demanded, speeds_rpm, sent, now_ns)

    def _speed_limit_fault(self, speed: int, sent: _Sent | None) -> str | None:
        limits = self.limits
        step = limits.speed_slew_rpm_per_s * limits.period_ns / _NS_PER_S
        before = None if sent is None else _word(sent.data, 4)
        if speed < _SPEED_LIMIT_MIN_RPM:
            return "speed_limit"
        if speed > limits.speed_limit_max_rpm and not _falls(speed, before, step):
            return "speed_limit"
        too_fast = before is not None and before - speed > step + _ROUNDING
        return "speed_slew" if too_fast else None

    def _torque_fault(
        self,
        data: bytes,
        armed: bool,
        demanded: Demanded | None,
        speeds_rpm: tuple[float | None, ...],
        sent: _Sent | None,
        now_ns: int,
    ) -> str | None:
        if not armed:
            return "unarmed"
        power, limits = _word(data, 6), self.limits
        if demanded is None or (
            data[1] * _PERCENT_PER_BIT > demanded.throttle_pct + _HALF_BIT_PCT
            or data[2] * _PERCENT_PER_BIT > demanded.brake_pct + _HALF_BIT_PCT
            or power > demanded.power_limit_w + _HALF_BIT_W
        ):
            return "not_demanded"
        if power > limits.power_limit_max_w:
            before = None if sent is None else _word(sent.data, 6)
            step = limits.power_slew_w_per_s * limits.period_ns / _NS_PER_S
            if not _falls(power, before, step):
                return "power_limit"
        if self._power_mode_rises(data, sent):
            return "power_mode_rise"
        if data[0] & _REGEN and self._too_slow_to_regenerate(speeds_rpm):
            return "regeneration"
        return self._throttle_fault(data, sent, now_ns) if data[1] else None

    def _power_mode_rises(self, data: bytes, sent: _Sent | None) -> bool:
        before = 0 if sent is None else _mode_rank(sent.data)
        if _mode_rank(data) <= before:
            return False
        return any(one.data[1] > _RELEASED_RAW for one in self._sent.values())

    def _throttle_fault(self, data: bytes, sent: _Sent | None, now_ns: int) -> str | None:
        if data[0] & _MODE_MASK == _MODE_SAFETY:
            return "power_mode"
        if not self.limits.independent_directions:
            for one in self._sent.values():
                if (one.data[0] ^ data[0]) & _REVERSE:
                    return "directions"
        if sent is None or data[1] > self._throttle_max_raw(sent, now_ns):
            return "throttle_slew"
        return None

    def _too_slow_to_regenerate(self, speeds_rpm: tuple[float | None, ...]) -> bool:
        """True where a motor turns too slowly for regeneration, or at an unknown speed."""
        least_rpm = self.limits.regen_min_rpm
        return least_rpm > 0 and any(speed is None or speed < least_rpm for speed in speeds_rpm)

    def _turned(
        self, data: bytes, sent: _Sent | None, speeds_rpm: tuple[float | None, ...]
    ) -> bool:
        if sent is None or (data[0] ^ sent.data[0]) & _REVERSE == 0:
            return False
        limit_rpm = self.limits.direction_change_rpm
        slow = all(speed is not None and speed < limit_rpm for speed in speeds_rpm)
        return not slow or data[1] != 0 or sent.data[1] != 0

    def _throttle_max_raw(self, sent: _Sent, now_ns: int) -> float:
        """Highest throttle code now: the last one sent plus what the slew earned since."""
        elapsed_ns = min(max(now_ns - sent.at_ns, 0), self.limits.period_ns)
        earned_pct = self.limits.throttle_slew_pct_per_s * elapsed_ns / _NS_PER_S
        # Codes are rounded to the nearest: half a bit up now, half a bit down before.
        return sent.data[1] + earned_pct / _PERCENT_PER_BIT + 1


def _mode_rank(data: bytes) -> int:
    return _RISING.index(data[0] & _MODE_MASK)


def _is_safe(data: bytes) -> bool:
    """ZERO_TORQUE or POWER_CUT, in either direction."""
    zero = not (data[1] or data[2] or data[6] or data[7] or data[0] & _REGEN)
    return zero and data[0] & _MODE_MASK == _MODE_SAFETY


def _falls(limit: int, before: int | None, step: float) -> bool:
    """True where a limit above the maximum is coming down to it from the one before.

    Two frames of a slot are at least half a period apart, so at least half a step.
    """
    return before is not None and limit <= before - step / 2 + _ROUNDING


def _word(data: bytes, index: int) -> int:
    return data[index] | data[index + 1] << 8
