"""Caps: whatever curves, drive modes and the slip limiter say, no field is higher than without."""

import copy
import os
import random
from collections.abc import Mapping

import pytest

from vcu_gateway.core import commands
from vcu_gateway.core.caps import NO_CAPS, Caps, lower_mode, of_effects
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.commands import Commander, Ramps
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, PowerMode
from vcu_gateway.core.settings import Settings

WORLDS = int(os.environ.get("VCU_WORLDS", "3000"))
MANY_WORLDS = 1_000_000
PERIOD_NS = 50_000_000
MODES = (PowerMode.SAFETY, PowerMode.ECO, PowerMode.NORMAL, PowerMode.TURBO)
FIELDS = ("throttle_pct", "brake_pct", "power_limit_w", "speed_limit_rpm", "regen_brake")


def test_the_lower_cap_of_each_field_counts():
    one = Caps(throttle_pct=10, throttle_rise_pct_per_s=40, power_w=500, power_mode=PowerMode.TURBO)
    other = Caps(throttle_pct=20, brake_pct=3, speed_rpm=600, power_mode=PowerMode.ECO)
    assert one.lowest(other) == Caps(
        throttle_pct=10,
        throttle_rise_pct_per_s=40,
        brake_pct=3,
        power_w=500,
        speed_rpm=600,
        power_mode=PowerMode.ECO,
    )
    assert one.lowest(NO_CAPS) == NO_CAPS.lowest(one) == one
    assert (NO_CAPS.throttle_pct, NO_CAPS.brake_pct) == (100, 100)


def test_of_power_modes_safety_allows_least():
    assert [max(MODES, key=MODES.index), lower_mode(*MODES[:2])] == [MODES[3], MODES[0]]


@pytest.mark.parametrize(
    ("effects", "caps"),
    [
        ([], NO_CAPS),
        ([Effect.ALARM], NO_CAPS),
        ([Effect.CAP], NO_CAPS),
        ([Effect.TURBO_OFF], Caps(power_mode=PowerMode.NORMAL)),
        (list(Effect), Caps(brake_pct=0.0, power_w=10_000, power_mode=PowerMode.ECO)),
        ([Effect.POWER_LIMIT], Caps(power_w=10_000, power_mode=PowerMode.ECO)),
        ([Effect.POWER_LIMIT, Effect.TURBO_OFF], Caps(power_w=10_000, power_mode=PowerMode.ECO)),
        ([Effect.REGEN_LIMIT], Caps(brake_pct=20.0)),
        ([Effect.REGEN_OFF, Effect.REGEN_LIMIT], Caps(brake_pct=0.0)),
    ],
)
def test_the_effects_of_causes_are_caps(effects, caps):
    assert of_effects(frozenset(effects), Settings()) == caps


class World:
    """A random state of a commander, a demand, effects and caps."""

    def __init__(self, choice: random.Random) -> None:
        self.settings = Settings(
            speed_limit_max_rpm=choice.randint(500, 12_000),
            power_limit_max_w=choice.randint(0, 60_000),
            derated_power_w=choice.randint(0, 30_000),
            regen_limit_pct=choice.uniform(0, 50),
            throttle_slew_pct_per_s=choice.uniform(10, 200),
            speed_fall_rpm_per_s=choice.uniform(100, 4000),
            speed_slew_rpm_per_s=choice.uniform(500, 20_000),
        )
        self.choice = choice
        self.commander = Commander(self.settings)
        self.commander.safe(None, self.settings, False, 0)
        self.commander.last = {name: self.command() for name in CONTROLLERS}
        self.commander._ramps = {name: self.ramps() for name in CONTROLLERS}
        for name in choice.sample(CONTROLLERS, choice.randint(0, 2)):
            self.commander.note_sent(name)
        one, other = self.demand(), self.demand()
        self.demanded = dict(zip(CONTROLLERS, (one, choice.choice((one, other))), strict=True))
        self.effects = frozenset(choice.sample(tuple(Effect), choice.randint(0, 3)))
        self.caps = {name: self.cap() for name in CONTROLLERS}

    def share(self, highest: float) -> float:
        return self.choice.choice((0.0, highest, self.choice.uniform(0, highest)))

    def command(self) -> commands.Command:
        return commands.Command(
            power_mode=self.choice.choice(MODES),
            throttle_pct=self.share(100),
            brake_pct=self.share(100),
            speed_limit_rpm=self.choice.uniform(500, self.settings.speed_limit_max_rpm),
            power_limit_w=self.share(60_000),
        )

    def ramps(self) -> Ramps:
        return Ramps(self.share(self.settings.power_limit_max_w), self.share(100))

    def demand(self) -> ControllerDemand:
        return ControllerDemand(
            throttle_pct=self.share(100),
            brake_pct=self.share(100),
            power_mode=self.choice.choice(MODES),
            motor_reverse=self.choice.random() < 0.1,
            regen_brake=self.choice.random() < 0.5,
            speed_limit_rpm=self.choice.uniform(0, 12_000),
            power_limit_w=self.share(60_000),
        )

    def cap(self) -> Caps:
        return Caps(
            self.share(100),
            self.choice.uniform(5, 300),
            self.share(100),
            self.share(60_000),
            self.choice.uniform(400, 13_000),
            self.choice.choice(MODES[1:]),
        )

    def decided(self, caps: Mapping[str, Caps]) -> Mapping[str, commands.Command]:
        commander = copy.deepcopy(self.commander)
        commander.caps = caps
        slow, regenerates, released = self.facts
        return commander.active(
            self.demanded, self.effects, slow, self.settings, PERIOD_NS,
            regenerates=regenerates, released=released,
        )  # fmt: skip

    @property
    def facts(self) -> tuple[bool, bool, bool]:
        bits = self.choice.getstate()[1][0]
        return bool(bits & 1), bool(bits & 2), bool(bits & 4)


def judge(worlds: int, seed: int) -> None:
    choice = random.Random(seed)
    for _ in range(worlds):
        world = World(choice)
        capped, free = world.decided(world.caps), world.decided(commands.NOT_CAPPED)
        for name in CONTROLLERS:
            one, other, demanded = capped[name], free[name], world.demanded[name]
            for field in FIELDS:
                assert getattr(one, field) <= getattr(other, field), (field, one, other)
            assert MODES.index(one.power_mode) <= MODES.index(other.power_mode)
            assert one.motor_reverse is other.motor_reverse
            assert one.power_cut is other.power_cut is False
            assert one.throttle_pct <= min(demanded.throttle_pct, world.caps[name].throttle_pct)
            assert one.brake_pct <= demanded.brake_pct
            assert one.power_limit_w <= demanded.power_limit_w


def test_from_the_same_state_no_field_is_higher_with_caps_than_without():
    judge(WORLDS, seed=1)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_in_a_million_worlds_no_field_is_higher_with_caps_than_without():
    judge(MANY_WORLDS, seed=2)
