"""Demand and limits -> commands: slew, override, direction, ramps and maxima, tick by tick."""

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway.core.causes import Effect
from vcu_gateway.core.commands import Command, Commander, message_name, moved
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, PowerMode
from vcu_gateway.core.pedals import ThrottleHold
from vcu_gateway.core.settings import Settings

MS = 1_000_000
PERIOD_NS = 50 * MS
ZERO_TORQUE = Command()
LSB_PCT = 0.39
ECO, NORMAL, TURBO, SAFETY = PowerMode


class Drive:
    """A commander with its settings and a clock that makes one period a step."""

    def __init__(self, **settings):
        self.settings = Settings(**settings)
        self.commander = Commander(self.settings)
        self.now_ns = 1_000 * MS
        self.step("safe")

    def step(
        self,
        what="active",
        demanded=None,
        *effects,
        slow=True,
        released=True,
        below_cap=True,
        after_ns=PERIOD_NS,
        **both,
    ):
        """One tick; both controllers' commands where they differ, else the one command."""
        self.now_ns += after_ns
        if demanded is None:
            demanded = dict.fromkeys(CONTROLLERS, ControllerDemand(**both))
        args = (frozenset(effects), slow, self.settings, self.now_ns)
        facts = {"below_cap": below_cap}
        if what == "active":
            facts = {"regenerates": True, "released": released}
        if what == "safe":
            commands = self.commander.safe(demanded, self.settings, False, self.now_ns)
        else:
            commands = getattr(self.commander, what)(demanded, *args, **facts)
        first, second = commands["PCU1"], commands["PCU2"]
        return first if first == second else commands

    def active(self, *effects, **facts):
        return self.step("active", None, *effects, **facts)

    def settle(self, *effects, **facts):
        return self.step("settle", None, *effects, **facts)

    def leave(self, *controllers):
        """The bus takes the last commands: of these controllers, or of both."""
        for name in controllers or CONTROLLERS:
            self.commander.note_sent(name)

    def up_to(self, **demanded):
        """Ask for this until the slews have nothing left to do."""
        for _ in range(40):
            command = self.active(**demanded)
        return command


@pytest.fixture
def drive():
    return Drive()


# Zero torque.


def test_forgetting_everything_is_zero_torque():
    assert Command().signals() == {
        "PowerMode": 3,
        "MotorReverse": False,
        "RegenBrake": False,
        "PowerCut": False,
        "Throttle": 0.0,
        "Brake": 0.0,
        "SpeedLimit": 12_000.0,
        "PowerLimit": 0.0,
    }


def test_every_field_reaches_its_signal():
    command = Command(TURBO, True, True, True, 11.0, 22.0, 3300.0, 4400.0)
    assert command.signals() == {
        "PowerMode": 2,
        "MotorReverse": True,
        "RegenBrake": True,
        "PowerCut": True,
        "Throttle": 11.0,
        "Brake": 22.0,
        "SpeedLimit": 3300.0,
        "PowerLimit": 4400.0,
    }


def test_each_controller_has_its_message():
    assert [message_name(name) for name in CONTROLLERS] == ["VCU_PCU1_Command", "VCU_PCU2_Command"]


@pytest.mark.parametrize("cut", [False, True])
def test_the_safe_command_keeps_the_direction_and_the_maximum_speed(cut):
    drive = Drive(speed_limit_max_rpm=3000)
    drive.settle(motor_reverse=True)
    drive.up_to(motor_reverse=True, throttle_pct=50, regen_brake=True, brake_pct=4)
    commands = drive.commander.safe(None, drive.settings, cut, drive.now_ns + PERIOD_NS)
    expected = Command(motor_reverse=True, power_cut=cut, speed_limit_rpm=3000)
    assert commands == {"PCU1": expected, "PCU2": expected}
    assert drive.commander.last == commands


def test_before_the_first_tick_the_last_command_is_zero_torque():
    commander = Commander(Settings(speed_limit_max_rpm=4000))
    expected = Command(speed_limit_rpm=4000)
    assert commander.last == {"PCU1": expected, "PCU2": expected}
    assert commander.pedals.latched == set()


def test_before_the_first_tick_nothing_can_be_lost():
    commander = Commander(Settings())
    commander.not_sent("PCU1")
    assert commander.last == {"PCU1": ZERO_TORQUE, "PCU2": ZERO_TORQUE}
    assert commander.replaced(Settings()) == commander.last


def test_the_first_tick_earns_no_throttle():
    commander = Commander(Settings())
    demanded = dict.fromkeys(CONTROLLERS, ControllerDemand(throttle_pct=100))
    commands = commander.active(
        demanded, frozenset(), True, Settings(), 10**12, regenerates=True, released=True
    )
    assert commands["PCU1"].throttle_pct == 0


def test_standby_carries_zero_torque_whatever_is_asked(drive):
    demanded = {"throttle_pct": 50, "brake_pct": 4, "regen_brake": True, "power_mode": TURBO}
    assert drive.settle(**demanded) == ZERO_TORQUE
    assert drive.settle(Effect.CUT, **demanded) == ZERO_TORQUE


def test_standby_without_a_demand_is_zero_torque_in_the_direction_it_had(drive):
    drive.settle(motor_reverse=True)
    commands = drive.commander.settle(
        None, frozenset(), True, drive.settings, drive.now_ns, below_cap=True
    )
    assert commands["PCU1"] == Command(motor_reverse=True)


# Throttle.


def test_the_throttle_rises_along_its_slew(drive):
    risen = [drive.active(throttle_pct=12).throttle_pct for _ in range(4)]
    assert risen == pytest.approx([5, 10, 12, 12])


def test_the_throttle_falls_at_once(drive):
    drive.up_to(throttle_pct=100)
    assert drive.active(throttle_pct=3).throttle_pct == 3
    assert drive.active(throttle_pct=0).throttle_pct == 0


@pytest.mark.parametrize(
    ("after_ns", "risen_pct"),
    [
        (0, 0),
        (1, 1e-7),
        (25 * MS, 2.5),
        (PERIOD_NS, 5),
        (PERIOD_NS + 1, 5),
        (10_000 * MS, 5),
        (-PERIOD_NS, 0),
    ],
)
def test_a_late_tick_earns_no_more_than_a_period(drive, after_ns, risen_pct):
    drive.up_to(throttle_pct=20)
    command = drive.active(throttle_pct=100, after_ns=after_ns)
    assert command.throttle_pct == pytest.approx(20 + risen_pct, abs=1e-9)


def test_each_controller_rises_from_its_own_throttle(drive):
    demanded = {"PCU1": ControllerDemand(throttle_pct=40), "PCU2": ControllerDemand(throttle_pct=2)}
    for _ in range(3):
        commands = drive.step("active", demanded)
    assert commands["PCU1"].throttle_pct == pytest.approx(15)
    assert commands["PCU2"].throttle_pct == 2


def test_after_zero_torque_the_throttle_begins_at_zero(drive):
    drive.up_to(throttle_pct=60)
    drive.step("safe")
    assert drive.active(throttle_pct=60).throttle_pct == pytest.approx(5)


def test_the_slew_is_configuration():
    assert Drive(throttle_slew_pct_per_s=20).active(throttle_pct=60).throttle_pct == 1


# Brake over throttle.


@pytest.mark.parametrize(
    ("throttle_pct", "brake_pct", "overridden"),
    [
        (25, 5, False),
        (25, 100, False),
        (100, 5, False),
        (25 + LSB_PCT, 5, False),
        (25, 5 + LSB_PCT, False),
        (25 + LSB_PCT, 5 + LSB_PCT, True),
        (25.0001, 5.0001, True),
        (100, 100, True),
    ],
)
@pytest.mark.parametrize("who", [("PCU1",), ("PCU2",), CONTROLLERS])
def test_throttle_and_brake_together_give_no_throttle_to_either(
    drive, throttle_pct, brake_pct, overridden, who
):
    drive.up_to(throttle_pct=20)
    quiet = ControllerDemand(throttle_pct=20)
    both = ControllerDemand(throttle_pct=throttle_pct, brake_pct=brake_pct)
    demanded = dict.fromkeys(CONTROLLERS, quiet) | dict.fromkeys(who, both)
    drive.step("active", demanded)
    throttles = {command.throttle_pct for command in drive.commander.last.values()}
    assert (throttles == {0.0}) is overridden
    assert (ThrottleHold.OVERRIDE in drive.commander.pedals.latched) is overridden


def test_the_override_leaves_the_brake(drive):
    command = drive.active(throttle_pct=30, brake_pct=60, regen_brake=True)
    assert (command.throttle_pct, command.brake_pct, command.regen_brake) == (0, 60, True)


@pytest.mark.parametrize(("throttle_pct", "released"), [(5.0, False), (4.9999, True), (0, True)])
@pytest.mark.parametrize("brake_pct", [0, 100])
def test_the_override_ends_below_five_percent_brake_released_or_not(
    drive, throttle_pct, released, brake_pct
):
    drive.active(throttle_pct=30, brake_pct=6)
    assert drive.active(throttle_pct=30, brake_pct=0).throttle_pct == 0, "the brake ends nothing"
    drive.active(throttle_pct=throttle_pct, brake_pct=brake_pct)
    assert (ThrottleHold.OVERRIDE in drive.commander.pedals.latched) is not released
    assert drive.active(throttle_pct=20).throttle_pct == pytest.approx(
        min(throttle_pct, 5) + 5 if released else 0
    )


def test_the_override_ends_only_when_both_throttles_are_released(drive):
    drive.active(throttle_pct=30, brake_pct=6)
    demanded = {"PCU1": ControllerDemand(throttle_pct=0), "PCU2": ControllerDemand(throttle_pct=5)}
    drive.step("active", demanded)
    assert drive.commander.pedals.latched == {ThrottleHold.OVERRIDE}


def test_standby_notes_the_override_too(drive):
    drive.settle(throttle_pct=30, brake_pct=6)
    assert drive.active(throttle_pct=20).throttle_pct == 0
    drive.settle(throttle_pct=4)
    assert drive.active(throttle_pct=20).throttle_pct == pytest.approx(5)


# Direction.


@pytest.mark.parametrize("mode", ["active", "settle"])
@pytest.mark.parametrize("slow", [True, False])
def test_the_direction_changes_only_while_slow(drive, mode, slow):
    assert drive.step(mode, None, motor_reverse=True, slow=slow).motor_reverse is slow
    assert drive.step(mode, None, motor_reverse=False, slow=False).motor_reverse is slow
    assert drive.step(mode, None, motor_reverse=False, slow=True).motor_reverse is False


def test_while_a_change_waits_the_throttle_stays_zero(drive):
    drive.up_to(throttle_pct=50)
    for _ in range(3):
        command = drive.active(throttle_pct=50, motor_reverse=True, slow=False)
        assert (command.throttle_pct, command.motor_reverse) == (0, False)
    command = drive.active(throttle_pct=50, motor_reverse=True, slow=True)
    assert (command.throttle_pct, command.motor_reverse) == (0, True)
    assert drive.active(throttle_pct=50, motor_reverse=True).throttle_pct == pytest.approx(5)


def test_the_direction_waits_one_frame_of_zero_throttle_even_when_slow(drive):
    drive.up_to(throttle_pct=50)
    command = drive.active(throttle_pct=50, motor_reverse=True)
    assert (command.throttle_pct, command.motor_reverse) == (0, False)
    assert drive.active(throttle_pct=50, motor_reverse=True).motor_reverse is True


def test_a_change_of_one_controller_holds_the_other_one_too():
    drive = Drive(independent_directions=True)
    demanded = {
        "PCU1": ControllerDemand(throttle_pct=50, motor_reverse=True),
        "PCU2": ControllerDemand(throttle_pct=50),
    }
    drive.step("active", demanded, slow=False)
    last = drive.commander.last
    assert {command.throttle_pct for command in last.values()} == {0.0}
    commands = drive.step("active", demanded)
    assert (commands["PCU1"].motor_reverse, commands["PCU2"].motor_reverse) == (True, False)
    assert {command.throttle_pct for command in commands.values()} == {0.0}


def test_one_throttle_that_is_not_zero_keeps_both_directions(drive):
    demanded = {"PCU1": ControllerDemand(), "PCU2": ControllerDemand(throttle_pct=50)}
    drive.step("active", demanded)
    for mode in ("settle", "active"):
        twin = Drive()
        twin.step("active", demanded)
        twin.step(mode, None, motor_reverse=True)
        assert not any(command.motor_reverse for command in twin.commander.last.values())


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_change_is_pending_while_one_direction_differs(name):
    drive = Drive(independent_directions=True)
    demanded = dict.fromkeys(CONTROLLERS, ControllerDemand())
    assert not drive.commander.reverse_pending(demanded)
    demanded[name] = ControllerDemand(motor_reverse=True)
    assert drive.commander.reverse_pending(demanded)
    drive.step("settle", demanded)
    assert not drive.commander.reverse_pending(demanded)


@pytest.mark.parametrize("mode", ["settle", "active"])
def test_two_directions_that_a_reload_forbids_are_not_turned_to(drive, mode):
    demanded = dict.fromkeys(CONTROLLERS, ControllerDemand())
    demanded["PCU2"] = ControllerDemand(motor_reverse=True)
    assert not drive.step(mode, demanded).motor_reverse
    assert drive.commander.reverse_pending(demanded)


# Ramps of the limits.


def powers(drive, ticks, *effects, **demanded):
    return [drive.active(*effects, **demanded).power_limit_w for _ in range(ticks)]


def brakes(drive, ticks, *effects, **demanded):
    demanded = {"brake_pct": 80, "regen_brake": True} | demanded
    return [drive.active(*effects, **demanded).brake_pct for _ in range(ticks)]


def test_a_power_limit_begins_in_its_tick_and_moves_along_its_slew(drive):
    assert powers(drive, 2) == [60_000, 60_000]
    expected = [57_000 - 3000 * tick for tick in range(16)]
    assert powers(drive, 16, Effect.POWER_LIMIT) == pytest.approx(expected)
    assert powers(drive, 3, Effect.POWER_LIMIT) == pytest.approx([10_000] * 3)


def test_a_power_limit_returns_along_its_slew(drive):
    powers(drive, 30, Effect.POWER_LIMIT)
    expected = [*(13_000 + 3000 * tick for tick in range(16)), 60_000, 60_000]
    assert powers(drive, 18) == pytest.approx(expected)


def test_a_power_limit_begins_at_what_is_commanded_not_at_the_maximum(drive):
    powers(drive, 2, power_limit_w=20_000)
    assert powers(drive, 2, Effect.POWER_LIMIT, power_limit_w=20_000) == [17_000, 14_000]
    assert powers(drive, 1, Effect.POWER_LIMIT) == [11_000], "asking for more gives no more"


def test_a_demand_below_the_derated_power_is_left_alone(drive):
    powers(drive, 2, power_limit_w=4_000)
    assert powers(drive, 2, Effect.POWER_LIMIT, power_limit_w=4_000) == [4_000, 4_000]
    assert powers(drive, 2, Effect.POWER_LIMIT) == [10_000, 10_000]


def test_each_controllers_limit_begins_at_its_own_command(drive):
    demanded = {name: ControllerDemand(power_limit_w=w) for name, w in
             zip(CONTROLLERS, (50_000, 20_000), strict=True)}  # fmt: skip
    drive.step("active", demanded)
    commands = drive.step("active", demanded, Effect.POWER_LIMIT)
    assert [commands[name].power_limit_w for name in CONTROLLERS] == [47_000, 17_000]


def test_each_controllers_limit_returns_on_its_own_where_both_had_the_same_command(drive):
    apart = {"PCU1": ControllerDemand(power_limit_w=6000), "PCU2": ControllerDemand()}
    drive.step("active", apart)
    drive.step("active", apart, Effect.POWER_LIMIT)
    assert drive.active(power_limit_w=1000).power_limit_w == 1000
    commands = drive.active()
    assert commands["PCU1"].power_limit_w < commands["PCU2"].power_limit_w


def test_a_limit_is_at_its_value_when_driving_begins_under_it(drive):
    drive.settle(Effect.POWER_LIMIT, Effect.REGEN_LIMIT)
    command = drive.active(Effect.POWER_LIMIT, Effect.REGEN_LIMIT, brake_pct=80)
    assert (command.power_limit_w, command.brake_pct) == (10_000, 20)


def test_limits_return_in_standby_as_in_active(drive):
    powers(drive, 30, Effect.POWER_LIMIT, Effect.REGEN_LIMIT)
    drive.settle()
    assert drive.active(brake_pct=80).power_limit_w == pytest.approx(16_000)
    assert drive.commander.last["PCU1"].brake_pct == pytest.approx(30)


def test_limits_stay_while_a_fault_is_latched(drive):
    powers(drive, 30, Effect.POWER_LIMIT)
    for _ in range(10):
        drive.step("safe")
    assert drive.active().power_limit_w == pytest.approx(13_000)


def test_a_late_tick_moves_a_limit_back_by_no_more_than_a_period(drive):
    powers(drive, 30, Effect.POWER_LIMIT)
    assert drive.active(after_ns=10_000 * MS).power_limit_w == pytest.approx(13_000)


def test_the_derated_power_never_exceeds_the_maximum():
    drive = Drive(power_limit_max_w=6_000, derated_power_w=10_000)
    assert powers(drive, 3, Effect.POWER_LIMIT) == [6_000] * 3


def test_a_regeneration_limit_begins_in_its_tick_and_moves_along_its_slew(drive):
    assert brakes(drive, 2) == [80, 80]
    expected = [75 - 5 * tick for tick in range(12)]
    assert brakes(drive, 12, Effect.REGEN_LIMIT) == pytest.approx(expected)
    assert brakes(drive, 2, Effect.REGEN_LIMIT) == pytest.approx([20, 20])
    assert brakes(drive, 3) == pytest.approx([25, 30, 35])


def test_a_regeneration_limit_leaves_the_switch_alone(drive):
    assert drive.active(Effect.REGEN_LIMIT, regen_brake=True).regen_brake is True


def test_regeneration_off_acts_in_full_at_once_and_returns_along_the_slew(drive):
    brakes(drive, 2)
    command = drive.active(Effect.REGEN_OFF, brake_pct=80, regen_brake=True)
    assert (command.brake_pct, command.regen_brake) == (0, False)
    assert brakes(drive, 3) == pytest.approx([5, 10, 15])
    assert drive.commander.last["PCU1"].regen_brake is True


def test_regeneration_off_wins_over_the_regeneration_limit(drive):
    brakes(drive, 2)
    assert brakes(drive, 2, Effect.REGEN_LIMIT, Effect.REGEN_OFF) == [0, 0]
    assert brakes(drive, 6, Effect.REGEN_LIMIT) == pytest.approx([5, 10, 15, 20, 20, 20])


def test_without_a_limit_the_whole_brake_is_passed_on(drive):
    assert brakes(drive, 2, brake_pct=100) == [100, 100]
    brakes(drive, 1, Effect.REGEN_OFF)
    assert brakes(drive, 30, brake_pct=100)[-1] == 100


def test_regeneration_needs_to_be_demanded(drive):
    assert drive.active(brake_pct=80).regen_brake is False


def test_slews_and_targets_of_the_limits_are_configuration():
    drive = Drive(
        derated_power_w=20_000,
        power_slew_w_per_s=20_000,
        regen_limit_pct=30,
        regen_slew_pct_per_s=20,
    )
    drive.active(brake_pct=80)
    command = drive.active(Effect.POWER_LIMIT, Effect.REGEN_LIMIT, brake_pct=80)
    assert (command.power_limit_w, command.brake_pct) == (59_000, 79)
    for _ in range(100):
        command = drive.active(Effect.POWER_LIMIT, Effect.REGEN_LIMIT, brake_pct=80)
    assert (command.power_limit_w, command.brake_pct) == (20_000, 30)


def test_the_maximum_power_says_nothing_of_the_brake():
    drive = Drive(power_limit_max_w=10)
    assert brakes(drive, 3) == [80, 80, 80]


@pytest.mark.parametrize(
    ("limit", "commanded", "target", "step", "expected"),
    [
        (60, 60, 10, 3, 57),
        (60, 20, 10, 3, 17),
        (60, 0, 10, 3, 10),
        (12, 60, 10, 3, 10),
        (60, 60, 10, 0, 60),
        (10, 5, 60, 3, 13),
        (58, 0, 60, 3, 60),
        (10, 0, 10, 3, 10),
    ],
)
def test_a_limit_moves_one_step(limit, commanded, target, step, expected):
    assert moved(limit, commanded, target, step) == expected


NUMBERS = st.floats(0, 60_000)


@given(limit=NUMBERS, commanded=NUMBERS, target=NUMBERS, step=NUMBERS)
def test_a_limit_never_passes_its_target_and_never_rises_above_its_step(
    limit, commanded, target, step
):
    after = moved(limit, commanded, target, step)
    assert min(limit, target) <= after <= max(limit, target)
    assert after <= limit + step
    if target < limit:
        assert after <= max(target, commanded), "it bites at once"


# Power mode.


@pytest.mark.parametrize(
    ("demanded", "effects", "expected"),
    [
        (ECO, [], ECO),
        (NORMAL, [], NORMAL),
        (TURBO, [], TURBO),
        (SAFETY, [], SAFETY),
        (ECO, [Effect.TURBO_OFF], ECO),
        (NORMAL, [Effect.TURBO_OFF], NORMAL),
        (TURBO, [Effect.TURBO_OFF], NORMAL),
        (SAFETY, [Effect.TURBO_OFF], SAFETY),
        (ECO, [Effect.POWER_LIMIT], ECO),
        (NORMAL, [Effect.POWER_LIMIT], ECO),
        (TURBO, [Effect.POWER_LIMIT], ECO),
        (SAFETY, [Effect.POWER_LIMIT], SAFETY),
        (TURBO, [Effect.POWER_LIMIT, Effect.TURBO_OFF], ECO),
        (TURBO, [Effect.REGEN_LIMIT, Effect.REGEN_OFF, Effect.ALARM], TURBO),
    ],
)
def test_the_strictest_mode_wins_at_once(drive, demanded, effects, expected):
    drive.active(power_mode=demanded)
    assert drive.active(*effects, power_mode=demanded).power_mode is expected


RISING = [SAFETY, ECO, NORMAL, TURBO]


@pytest.mark.parametrize("after", RISING)
@pytest.mark.parametrize("before", RISING)
def test_power_mode_falls_at_once_and_rises_with_released_throttle_alone(drive, before, after):
    drive.active(power_mode=before)
    lower = min(before, after, key=RISING.index)
    asked = drive.active(power_mode=after, throttle_pct=1, released=False)
    assert (asked.power_mode, asked.throttle_pct) == (lower, 0 if lower is SAFETY else 1)
    assert drive.active(power_mode=after, released=True).power_mode is after


def test_power_mode_rises_again_from_what_a_limit_left_of_it(drive):
    drive.active(power_mode=TURBO)
    drive.active(Effect.POWER_LIMIT, power_mode=TURBO, released=False)
    assert drive.active(power_mode=TURBO, released=False).power_mode is ECO
    assert drive.active(Effect.TURBO_OFF, power_mode=TURBO, released=False).power_mode is ECO
    assert drive.active(Effect.TURBO_OFF, power_mode=TURBO).power_mode is NORMAL


@pytest.mark.parametrize("unsent", CONTROLLERS)
def test_a_power_mode_that_one_controller_was_not_sent_falls_again_for_both(drive, unsent):
    drive.active(power_mode=ECO)
    drive.active(power_mode=TURBO, throttle_pct=20)
    drive.commander.not_sent(unsent)
    (other,) = set(CONTROLLERS) - {unsent}
    assert drive.commander.last[other].throttle_pct == 5
    assert drive.active(power_mode=TURBO, released=False).power_mode is ECO


def test_a_power_mode_that_falls_for_one_controller_stays_fallen_where_it_was_not_sent(drive):
    drive.active(power_mode=TURBO)
    drive.active(power_mode=ECO)
    drive.commander.not_sent("PCU1")
    assert {name: one.power_mode for name, one in drive.commander.last.items()} == {
        "PCU1": TURBO,
        "PCU2": ECO,
    }


def test_each_controllers_power_mode_waits_where_its_demand_is_higher(drive):
    drive.active(power_mode=ECO)
    turbo = ControllerDemand(power_mode=TURBO)
    demanded = {"PCU1": turbo, "PCU2": ControllerDemand()}
    assert drive.commander.waiting_modes(demanded, frozenset(), drive.settings) == {"PCU1": ECO}
    assert (
        drive.commander.waiting_modes(demanded, frozenset({Effect.POWER_LIMIT}), drive.settings)
        == {}
    )
    safety = dict.fromkeys(CONTROLLERS, ControllerDemand(power_mode=SAFETY))
    assert drive.commander.waiting_modes(safety, frozenset(), drive.settings) == {}


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_there_is_no_throttle_for_a_controller_in_power_mode_safety(drive, controller):
    pushed = ControllerDemand(throttle_pct=60)
    drive.up_to(throttle_pct=60)
    demanded = dict.fromkeys(CONTROLLERS, pushed)
    demanded[controller] = dataclasses.replace(pushed, power_mode=SAFETY)
    told = drive.step("active", demanded)
    (other,) = set(CONTROLLERS) - {controller}
    assert (told[controller].throttle_pct, told[other].throttle_pct) == (0, 60)
    assert drive.active(throttle_pct=60)[controller].throttle_pct == pytest.approx(5)


# Maxima.


@pytest.mark.parametrize(
    ("demanded", "sent"),
    [(0, 500), (499.9, 500), (500.1, 500.1), (2999, 2999), (3000, 3000), (3001, 3000)],
)
def test_the_speed_limit_is_between_500_rpm_and_its_maximum(demanded, sent):
    assert Drive(speed_limit_max_rpm=3000).active(speed_limit_rpm=demanded).speed_limit_rpm == sent


@pytest.mark.parametrize(("demanded", "sent"), [(0, 0), (2999, 2999), (3000, 3000), (3001, 3000)])
def test_the_power_limit_never_exceeds_its_maximum(demanded, sent):
    assert Drive(power_limit_max_w=3000).active(power_limit_w=demanded).power_limit_w == sent


def test_a_stricter_power_maximum_is_reached_along_its_slew(drive):
    drive.up_to(throttle_pct=20)
    drive.settings = Settings(power_limit_max_w=55_000)
    assert [drive.active().power_limit_w for _ in range(3)] == [57_000, 55_000, 55_000]


def test_a_stricter_power_maximum_is_approached_from_what_is_commanded(drive):
    drive.up_to(power_limit_w=40_000)
    drive.settings = Settings(power_limit_max_w=30_000)
    assert drive.active().power_limit_w == 37_000


@pytest.mark.parametrize("what", ["active", "settle", "safe"])
def test_the_speed_limit_falls_along_its_slew_from_what_was_sent(drive, what):
    drive.leave()
    drive.settings = Settings(speed_limit_max_rpm=11_700)
    assert drive.step(what).speed_limit_rpm == 11_800
    drive.leave()
    assert drive.step(what, after_ns=25 * MS).speed_limit_rpm == 11_700
    drive.leave()
    assert drive.step(what).speed_limit_rpm == 11_700


def test_a_demanded_speed_limit_falls_along_its_slew_and_rises_at_once(drive):
    drive.leave()
    for expected in (11_800, 11_600):
        assert drive.active(speed_limit_rpm=500).speed_limit_rpm == expected
        drive.leave()
    assert drive.active(speed_limit_rpm=12_000).speed_limit_rpm == 12_000


def test_a_late_tick_earns_the_speed_limit_one_period_at_most(drive):
    drive.leave()
    assert drive.active(speed_limit_rpm=500, after_ns=400 * MS).speed_limit_rpm == 11_800


def test_a_speed_limit_that_was_not_sent_is_not_fallen_from(drive):
    drive.leave()
    for _ in range(5):
        assert drive.active(speed_limit_rpm=500).speed_limit_rpm == 11_800
        for name in CONTROLLERS:
            drive.commander.not_sent(name)
    drive.active(speed_limit_rpm=500)
    drive.leave("PCU1")
    drive.commander.not_sent("PCU2")
    commands = drive.active(speed_limit_rpm=500)
    assert [commands[name].speed_limit_rpm for name in CONTROLLERS] == [11_600, 11_800]


def test_a_speed_limit_falls_where_one_was_sent_and_begins_at_its_value_elsewhere(drive):
    drive.leave("PCU1")
    commands = drive.active(speed_limit_rpm=3000)
    assert commands["PCU1"].speed_limit_rpm > commands["PCU2"].speed_limit_rpm == 3000


def test_a_replaced_command_follows_the_speed_limits_slew(drive):
    drive.leave()
    drive.settings = Settings(speed_limit_max_rpm=3000)
    drive.active()
    assert drive.commander.replaced(drive.settings)["PCU2"].speed_limit_rpm == 11_800
    drive.leave()
    assert drive.commander.zero_torque(drive.settings, False)["PCU1"].speed_limit_rpm == 11_600


def test_looser_maxima_are_reached_along_the_slew():
    drive = Drive(power_limit_max_w=30_000)
    drive.active()
    drive.settings = dataclasses.replace(drive.settings, power_limit_max_w=60_000)
    assert drive.active().power_limit_w == pytest.approx(33_000)


# What the bus did not take, and what the gate replaced.


def test_a_command_that_was_not_sent_earns_no_rise(drive):
    drive.up_to(throttle_pct=20)
    assert drive.active(throttle_pct=60).throttle_pct == pytest.approx(25)
    drive.commander.not_sent("PCU1")
    commands = drive.active(throttle_pct=60)
    commands = drive.commander.last
    assert commands["PCU1"].throttle_pct == pytest.approx(25)
    assert commands["PCU2"].throttle_pct == pytest.approx(30)


def test_one_command_after_another_that_is_not_sent_leaves_the_last_one_sent(drive):
    drive.up_to(throttle_pct=20)
    for _ in range(3):
        drive.active(throttle_pct=60)
        for name in CONTROLLERS:
            drive.commander.not_sent(name)
    assert drive.commander.last["PCU1"].throttle_pct == 20


@pytest.mark.parametrize("mode", ["settle", "active"])
def test_a_change_of_direction_that_was_not_sent_did_not_happen(drive, mode):
    assert drive.step(mode, None, motor_reverse=True).motor_reverse is True
    for name in CONTROLLERS:
        drive.commander.not_sent(name)
    assert drive.step("safe").motor_reverse is False
    assert drive.step(mode, None, motor_reverse=True, slow=False).motor_reverse is False


def test_a_replaced_command_keeps_the_power_cut_where_it_is_told_to(drive):
    commands = drive.commander.replaced(drive.settings, True)
    assert commands == dict.fromkeys(CONTROLLERS, Command(power_cut=True))


@pytest.mark.parametrize("mode", ["settle", "active"])
def test_a_replaced_command_is_zero_torque_in_the_direction_of_the_tick_before(drive, mode):
    drive.settings = Settings(speed_limit_max_rpm=7000)
    drive.step(mode, None, motor_reverse=True)
    commands = drive.commander.replaced(drive.settings)
    expected = Command(speed_limit_rpm=7000)
    assert commands == {"PCU1": expected, "PCU2": expected}
    assert drive.commander.last == commands
    drive.step(mode, None, motor_reverse=True)
    drive.up_to(throttle_pct=50, motor_reverse=True)
    assert drive.commander.replaced(drive.settings)["PCU2"].motor_reverse is True
    assert drive.active(throttle_pct=50, motor_reverse=True).throttle_pct == pytest.approx(5)


def test_a_replaced_command_that_was_not_sent_leaves_the_one_before_it(drive):
    drive.up_to(throttle_pct=20)
    drive.active(throttle_pct=60)
    drive.commander.replaced(drive.settings)
    drive.commander.not_sent("PCU1")
    assert drive.commander.last["PCU1"].throttle_pct == 20
    assert drive.commander.last["PCU2"].throttle_pct == 0


def test_the_directions_of_a_gateway_before_are_taken_over_where_they_are_known():
    commander = Commander(Settings())
    commander.take_over({"PCU2": True})
    commander.take_over({})
    assert {name: one.motor_reverse for name, one in commander.last.items()} == {
        "PCU1": False,
        "PCU2": True,
    }
    told = commander.safe(None, Settings(), power_cut=False, now_ns=0)
    assert told["PCU2"].motor_reverse
