"""Commands: demand and limits to the physical values of each command frame.

Torque is earned: every command starts from ZERO_TORQUE, and `Commander.active` alone turns a
permission into a number.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core import caps
from vcu_gateway.core.caps import FULL_PCT, NO_CAPS, Caps, lower_mode
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.demand import (
    CONTROLLERS,
    ControllerDemand,
    ControllerDemands,
    PowerMode,
    directions_differ,
)
from vcu_gateway.core.pedals import Pedals
from vcu_gateway.core.settings import Settings
from vcu_gateway.demand_ranges import SPEED_LIMIT_HIGHEST_RPM
from vcu_gateway.units import NS_PER_S

_SPEED_LIMIT_MIN_RPM = 500.0
NOT_CAPPED: Mapping[str, Caps] = dict.fromkeys(CONTROLLERS, NO_CAPS)
"""Caps where nothing is configured."""
_ZERO_W, _ZERO_PCT = 0.5, 0.195
"""Below it a limit is 0 in its frame."""


class Command(NamedTuple):
    """One command frame in physical values, by default ZERO_TORQUE (docs/safety.md, Safe frames).

    The speed limit's default is the protocol's maximum: a limit of 0 could brake hard.
    """

    power_mode: PowerMode = PowerMode.SAFETY
    motor_reverse: bool = False
    regen_brake: bool = False
    power_cut: bool = False
    throttle_pct: float = 0.0
    brake_pct: float = 0.0
    speed_limit_rpm: float = float(SPEED_LIMIT_HIGHEST_RPM)
    power_limit_w: float = 0.0

    def signals(self) -> Mapping[str, float]:
        """The values by the protocol's signal names."""
        return {
            "PowerMode": self.power_mode,
            "MotorReverse": self.motor_reverse,
            "RegenBrake": self.regen_brake,
            "PowerCut": self.power_cut,
            "Throttle": self.throttle_pct,
            "Brake": self.brake_pct,
            "SpeedLimit": self.speed_limit_rpm,
            "PowerLimit": self.power_limit_w,
        }


def message_name(controller: str) -> str:
    return f"VCU_{controller}_Command"


class Ramps(NamedTuple):
    """Ramped limits of one controller: power in W, brake in %."""

    power_w: float
    brake_pct: float


class Commander:
    """Both controllers' commands, from one tick to the next.

    Attributes:
        last: the commands of the tick before.
        pedals: throttle holds, from the demands since the tick before.
        caps: what curves, drive mode and slip limiter allow each controller in this tick.
    """

    def __init__(self, settings: Settings) -> None:
        self._last_ns: int | None = None
        self.last: dict[str, Command] = {
            name: Command(speed_limit_rpm=settings.speed_limit_max_rpm) for name in CONTROLLERS
        }
        self._before = dict(self.last)
        self._elapsed_s = 0.0
        self._sent_speed_limit_rpm: dict[str, float] = {}
        self.pedals = Pedals()
        self._ramps = dict.fromkeys(CONTROLLERS, Ramps(settings.power_limit_max_w, FULL_PCT))
        self.caps = NOT_CAPPED

    def take_over(self, reverse: Mapping[str, bool]) -> None:
        """Begin in these directions, by controller: those applied by a gateway before this one."""
        self.last = {
            name: last._replace(motor_reverse=reverse.get(name, last.motor_reverse))
            for name, last in self.last.items()
        }

    def reverse_pending(self, demanded: ControllerDemands) -> bool:
        """True where a controller's demanded direction is not the applied one."""
        for name, last in self.last.items():
            if demanded[name].motor_reverse is not last.motor_reverse:
                return True
        return False

    def safe(
        self, demanded: ControllerDemands | None, settings: Settings, power_cut: bool, now_ns: int
    ) -> Mapping[str, Command]:
        """Command ZERO_TORQUE or POWER_CUT to both; the pedals are watched all the same."""
        self._step(settings, demanded, now_ns)
        return self._decided(self.zero_torque(settings, power_cut))

    def zero_torque(self, settings: Settings, power_cut: bool) -> dict[str, Command]:
        """ZERO_TORQUE or POWER_CUT for both, in the directions as they were applied.

        The speed limit is the configured maximum, or on its way down to a stricter one.
        """
        return {
            name: Command(
                motor_reverse=last.motor_reverse,
                power_cut=power_cut,
                speed_limit_rpm=self._speed_limit_rpm(name, math.inf, settings),
            )
            for name, last in self.last.items()
        }

    def settle(
        self,
        demanded: ControllerDemands | None,
        effects: frozenset[Effect],
        slow: bool,
        settings: Settings,
        now_ns: int,
        *,
        below_cap: bool,
    ) -> Mapping[str, Command]:
        """ZERO_TORQUE in STANDBY: a direction may change, and limits move on meanwhile.

        `demanded` is None without a fresh demand. `slow` is True where both motors' speeds are
        known, fresh and below the change speed, `below_cap` where they are below the speed's cap.
        """
        self._step(settings, demanded, now_ns)
        self._move_ramps(self._allowed(effects, settings), effects, settings)
        commands = self.zero_torque(settings, power_cut=False)
        fall_rpm_per_s = settings.speed_slew_rpm_per_s if below_cap else _speed_fall(settings)
        for name, command in commands.items():
            if self.caps[name].speed_rpm < command.speed_limit_rpm:
                speed_rpm = self._capped_rpm(name, command.speed_limit_rpm, fall_rpm_per_s)
                commands[name] = command._replace(speed_limit_rpm=speed_rpm)
        if demanded is not None and slow and self._standing() and not _differ(demanded, settings):
            commands = {
                name: command._replace(motor_reverse=demanded[name].motor_reverse)
                for name, command in commands.items()
            }
        return self._decided(commands)

    def _standing(self) -> bool:
        """True where neither motor's last command had throttle."""
        for last in self.last.values():  # noqa: SIM110 - in every tick; a generator takes twice the time
            if last.throttle_pct != 0:
                return False
        return True

    def active(
        self,
        demanded: ControllerDemands,
        effects: frozenset[Effect],
        slow: bool,
        settings: Settings,
        now_ns: int,
        *,
        regenerates: bool,
        released: bool,
    ) -> Mapping[str, Command]:
        """The demand in ACTIVE, through pedals, direction interlock, limits and slew.

        `regenerates` is True where both motors turn fast enough for regeneration, `released` where
        the throttle last sent to each was below 5 %.
        """
        held = self._step(settings, demanded, now_ns)
        allowed = self._allowed(effects, settings)
        self._move_ramps(allowed, effects, settings)
        change = slow and self._standing() and not _differ(demanded, settings)
        rise_pct = settings.throttle_slew_pct_per_s * self._elapsed_s
        commands: dict[str, Command] = {}
        before: object = None
        for name, last in self.last.items():
            sent_rpm = self._sent_speed_limit_rpm.get(name)
            own = last, demanded[name], self.caps[name], self._ramps[name], sent_rpm
            if own != before:  # in most ticks both controllers have the same
                granted = self._granted(
                    name,
                    demanded[name],
                    allowed[name].power_mode,
                    settings,
                    reverse=demanded[name].motor_reverse if change else last.motor_reverse,
                    throttle_max_pct=0.0 if held else last.throttle_pct + rise_pct,
                    regenerates=regenerates and Effect.REGEN_OFF not in effects,
                    released=released,
                )
            commands[name], before = granted, own
        return self._decided(commands)

    def _within(
        self, name: str, throttle_max_pct: float, speed_rpm: float, settings: Settings
    ) -> tuple[float, float, bool]:
        """Throttle and SpeedLimit within the caps, and whether Brake is capped to 0.

        PowerMode and the ramps of power and Brake have taken theirs already.
        """
        own, ramps = self.caps[name], self._ramps[name]
        if own.throttle_rise_pct_per_s < settings.throttle_slew_pct_per_s:
            rise_pct = own.throttle_rise_pct_per_s * self._elapsed_s
            throttle_max_pct = min(throttle_max_pct, self.last[name].throttle_pct + rise_pct)
        if own.power_w <= _ZERO_W and ramps.power_w <= _ZERO_W:
            throttle_max_pct = 0.0  # a controller may read a power limit of 0 as none
        brake_is_off = own.brake_pct <= _ZERO_PCT and ramps.brake_pct <= _ZERO_PCT
        if own.speed_rpm < speed_rpm:
            speed_rpm = self._capped_rpm(name, speed_rpm, _speed_fall(settings))
        return min(throttle_max_pct, own.throttle_pct), speed_rpm, brake_is_off

    def _granted(
        self,
        name: str,
        demanded: ControllerDemand,
        allowed_mode: PowerMode,
        settings: Settings,
        *,
        reverse: bool,
        throttle_max_pct: float,
        regenerates: bool,
        released: bool,
    ) -> Command:
        ramps = self._ramps[name]
        power_mode = lower_mode(demanded.power_mode, allowed_mode)
        if not released:
            power_mode = lower_mode(power_mode, self.last[name].power_mode)
        if power_mode is PowerMode.SAFETY:
            throttle_max_pct = 0.0
        speed_rpm = self._speed_limit_rpm(name, demanded.speed_limit_rpm, settings)
        if self.caps is not NOT_CAPPED:
            throttle_max_pct, speed_rpm, brake_is_off = self._within(
                name, throttle_max_pct, speed_rpm, settings
            )
            regenerates = regenerates and not brake_is_off
        return Command(
            power_mode=power_mode,
            motor_reverse=reverse,
            regen_brake=demanded.regen_brake and regenerates,
            throttle_pct=min(demanded.throttle_pct, throttle_max_pct),
            brake_pct=min(demanded.brake_pct, ramps.brake_pct),
            speed_limit_rpm=speed_rpm,
            power_limit_w=min(demanded.power_limit_w, ramps.power_w),
        )

    def _speed_limit_rpm(self, name: str, demanded_rpm: float, settings: Settings) -> float:
        """SpeedLimit: it rises at once, and falls along its slew from the one sent last."""
        target_rpm = max(_SPEED_LIMIT_MIN_RPM, min(demanded_rpm, settings.speed_limit_max_rpm))
        sent_rpm = self._sent_speed_limit_rpm.get(name, target_rpm)
        return max(target_rpm, sent_rpm - settings.speed_slew_rpm_per_s * self._elapsed_s)

    def _capped_rpm(self, name: str, limit_rpm: float, fall_rpm_per_s: float) -> float:
        """SpeedLimit within a lower cap, to which it falls from the one sent last."""
        cap_rpm = max(_SPEED_LIMIT_MIN_RPM, self.caps[name].speed_rpm)
        sent_rpm = self._sent_speed_limit_rpm.get(name, limit_rpm)
        return min(limit_rpm, max(cap_rpm, sent_rpm - fall_rpm_per_s * self._elapsed_s))

    @property
    def speed_cap_rpm(self) -> float:
        """The lower speed cap of both controllers."""
        return min([one.speed_rpm for one in self.caps.values()])

    def cap_speed(self, cap_rpm: float) -> None:
        """Arming waits for this cap too, before the next tick finds it."""
        self.caps = {
            name: one._replace(speed_rpm=min(one.speed_rpm, cap_rpm))
            for name, one in self.caps.items()
        }

    def speed_pending(self) -> bool:
        """True where the SpeedLimit has not come down to its cap."""
        for name, last in self.last.items():
            if last.speed_limit_rpm > max(_SPEED_LIMIT_MIN_RPM, self.caps[name].speed_rpm):
                return True
        return False

    def elapsed_s(self, settings: Settings, now_ns: int) -> float:
        """Time since the last command, up to one period."""
        if self._last_ns is None:
            return 0.0
        return min(max(now_ns - self._last_ns, 0), settings.period_ns) / NS_PER_S

    def _step(self, settings: Settings, demanded: ControllerDemands | None, now_ns: int) -> bool:
        """Begin a tick; True where the pedals hold the throttle at 0.

        Time since the last command counts up to one period: a late tick earns no more.
        """
        self._elapsed_s = self.elapsed_s(settings, now_ns)
        self._last_ns = now_ns
        applied: dict[str, bool] = {}
        for name, last in self.last.items():
            applied[name] = last.motor_reverse
        return self.pedals.tick(demanded, applied, now_ns)

    def _decided(self, commands: dict[str, Command]) -> Mapping[str, Command]:
        self._before, self.last = self.last, commands
        return commands

    def replaced(self, settings: Settings, power_cut: bool = False) -> Mapping[str, Command]:
        """A safe command instead of this tick's, in the directions of the tick before."""
        self.last = self._before
        self.last = self.zero_torque(settings, power_cut)
        return self.last

    def note_sent(self, controller: str) -> None:
        self._sent_speed_limit_rpm[controller] = self.last[controller].speed_limit_rpm

    def not_sent(self, controller: str) -> None:
        """The bus did not take this command: the one before it still counts.

        A PowerMode that the other controller was sent did not rise for both, so it falls again.
        """
        last = {name: self._without_rise(name) for name in self.last}
        self.last = {**last, controller: self._before[controller]}

    def _without_rise(self, name: str) -> Command:
        last, before = self.last[name], self._before[name]
        return last._replace(power_mode=lower_mode(last.power_mode, before.power_mode))

    def waiting_modes(
        self, demanded: ControllerDemands, effects: frozenset[Effect], settings: Settings
    ) -> Mapping[str, PowerMode]:
        """PowerMode of each controller in which a higher one waits for released throttle."""
        waiting: dict[str, PowerMode] = {}
        allowed = self._allowed(effects, settings)
        for name, last in self.last.items():
            if demanded[name].power_mode is last.power_mode:
                continue
            wanted = lower_mode(demanded[name].power_mode, allowed[name].power_mode)
            if lower_mode(wanted, last.power_mode) is not wanted:
                waiting[name] = last.power_mode
        return waiting

    def _allowed(self, effects: frozenset[Effect], settings: Settings) -> Mapping[str, Caps]:
        """The lowest caps of all, those of effects among them."""
        of_effects = caps.of_effects(effects, settings)
        if of_effects is NO_CAPS:
            return self.caps
        return {name: own.lowest(of_effects) for name, own in self.caps.items()}

    def _move_ramps(
        self, allowed: Mapping[str, Caps], effects: frozenset[Effect], settings: Settings
    ) -> None:
        """Limits go to their targets along their slews, REGEN_OFF at once.

        A falling limit starts from what is really commanded, so that it bites in this tick.
        """
        power_max_w = settings.power_limit_max_w
        for name, last in self.last.items():
            ramps, brake_pct = self._ramps[name], allowed[name].brake_pct
            power_w = min(allowed[name].power_w, power_max_w)
            if ramps.power_w == power_w and ramps.brake_pct == brake_pct:
                continue
            self._ramps[name] = Ramps(
                moved(ramps.power_w, last.power_limit_w, power_w,
                      settings.power_slew_w_per_s * self._elapsed_s),
                0.0 if Effect.REGEN_OFF in effects else
                moved(ramps.brake_pct, last.brake_pct, brake_pct,
                      settings.regen_slew_pct_per_s * self._elapsed_s),
            )  # fmt: skip


def _differ(demanded: ControllerDemands, settings: Settings) -> bool:
    """True where different directions are demanded and not allowed, since a reload perhaps."""
    return not settings.independent_directions and directions_differ(demanded)


def moved(limit: float, commanded: float, target: float, step: float) -> float:
    """Limit one step nearer to its target; it falls from the commanded value at the most."""
    if target >= limit:
        return min(target, limit + step)
    return max(target, min(limit, commanded) - step)


def _speed_fall(settings: Settings) -> float:
    """Steepest fall of a capped SpeedLimit; never steeper than of any other."""
    return min(settings.speed_fall_rpm_per_s, settings.speed_slew_rpm_per_s)
