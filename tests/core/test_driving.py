"""The demand end to end (docs/safety.md, Demand), also between two ticks."""

from dataclasses import replace
from typing import Any

import pytest

from tests.core.simulated_drive import COMMAND_IDS, MS, Drive, active, in_mode, standby
from vcu_gateway.core.demand import ControllerDemand, PowerMode, Refusal
from vcu_gateway.core.pedals import ThrottleHold
from vcu_gateway.core.supervisor import Mode

NOT_ENDING = [mode for mode in Mode if mode is not Mode.STOPPING]


def throttles(drive: Drive) -> list[int]:
    return [command[1] for command in drive.commands]


# Arming, with the throttle released.


def test_arming_needs_a_throttle_that_was_zero_for_200_ms():
    drive = standby()
    drive.demanded = None
    for pct in (50, 0):
        assert drive.offer(ControllerDemand(throttle_pct=pct), ttl_ms=1000).granted
    drive.now_ns += 200 * MS - 1
    answer = drive.arm()
    assert answer.sentence == "the demanded throttle has not been 0 for 200 ms"
    drive.now_ns += 1
    assert drive.arm().granted


def test_a_throttle_for_a_moment_begins_the_200_ms_anew():
    drive = standby()
    drive.offer(ControllerDemand(throttle_pct=0.1))
    drive.offer(ControllerDemand())
    assert not drive.arm().granted
    drive.run(150)
    assert not drive.arm().granted
    drive.run(50)
    assert drive.arm().granted


@pytest.mark.parametrize("how", ["expires", "ends", "is not ticked"])
def test_a_demand_that_was_not_fresh_begins_the_200_ms_anew(how):
    drive = standby()
    drive.demanded = None
    if how == "ends":
        assert drive.gateway.requests.end_demand("driver", drive.now_ns).granted
    elif how == "expires":
        drive.run(300)
    else:
        drive.now_ns += 201 * MS
    drive.offer(ControllerDemand(), ttl_ms=1000)
    assert drive.arm().sentence == "the demanded throttle has not been 0 for 200 ms"
    drive.now_ns += 200 * MS
    assert drive.arm().granted


def test_zero_arm_and_fifty_in_one_breath_do_not_drive():
    drive = standby()
    drive.demanded = None
    drive.run(300)
    drive.offer(ControllerDemand())
    assert not drive.arm().granted
    drive.demanded = ControllerDemand(throttle_pct=50)
    drive.run(500)
    assert drive.mode is Mode.STANDBY
    assert throttles(drive) == [0, 0]


# Between two ticks.

PUSHED = ControllerDemand(throttle_pct=40)


def driving(**settings: Any) -> Drive:
    drive = active(**settings)
    drive.demanded = PUSHED
    drive.run(1000)
    assert throttles(drive) == [103, 103]
    return drive


def test_brake_over_throttle_of_a_demand_that_another_followed_is_not_missed():
    drive = driving()
    drive.offer(ControllerDemand(throttle_pct=40, brake_pct=10))
    drive.tick()
    assert throttles(drive) == [0, 0]
    drive.run(500)
    assert throttles(drive) == [0, 0], "until the pedal is released"
    drive.offer(ControllerDemand(throttle_pct=4.9))
    drive.tick()
    assert throttles(drive) == [13, 13]


def test_a_release_in_the_same_interval_holds_the_throttle_for_one_tick_all_the_same():
    drive = driving()
    drive.offer(ControllerDemand(throttle_pct=40, brake_pct=10))
    drive.offer(ControllerDemand())
    drive.tick()
    assert throttles(drive) == [0, 0]
    drive.tick()
    assert throttles(drive) == [13, 13]


@pytest.mark.parametrize("mode", NOT_ENDING)
def test_brake_over_throttle_latches_in_every_mode(mode):
    drive = in_mode(mode)
    drive.offer(ControllerDemand(throttle_pct=40, brake_pct=10))
    drive.offer(PUSHED)
    drive.demanded = PUSHED
    drive.tick()
    assert drive.gateway._commander.pedals.latched == {ThrottleHold.OVERRIDE}


def test_another_direction_asked_for_a_moment_takes_the_throttle_away_for_a_tick():
    drive = driving()
    drive.offer(ControllerDemand(throttle_pct=40, motor_reverse=True))
    drive.tick()
    assert throttles(drive) == [0, 0]
    assert drive.commands[0][0] & 0x10 == 0
    drive.tick()
    assert throttles(drive) == [13, 13]


def test_the_direction_of_the_last_demand_is_what_is_changed_to():
    drive = active()
    for reverse in (True, False):
        drive.offer(ControllerDemand(motor_reverse=reverse))
    drive.demanded = ControllerDemand(motor_reverse=True)
    drive.tick()
    assert drive.commands[0][0] & 0x10


def test_two_tracks_that_differed_between_two_ticks_hold_both_controllers():
    drive = driving()
    drive.demanded = None
    apart = {"PCU1": PUSHED, "PCU2": replace(PUSHED, throttle_track2_pct=29.9)}
    drive.offer(PUSHED, controllers=apart)
    drive.tick(60 * MS)
    assert throttles(drive) == [103, 103], "no more than 100 ms yet"
    drive.now_ns += 40 * MS + 1
    drive.offer(replace(PUSHED, throttle_track2_pct=40))
    drive.tick(MS)
    assert throttles(drive) == [0, 0]
    assert "the pedal's tracks differ" in drive.sentence


# Authority.


def taken_over(**demanded: Any) -> Drive:
    """A drive in which the chief has just taken over from the driver."""
    drive = driving(priorities={"chief": 1})
    drive.demanded = None
    drive.offer(ControllerDemand(**demanded), source="chief")
    return drive


def test_who_takes_over_while_active_has_no_throttle_until_less_than_5_pct_was_asked():
    drive = taken_over(throttle_pct=40)
    for sequence in (1000, 1001):
        drive.tick()
        assert (drive.mode, throttles(drive)) == (Mode.ACTIVE, [0, 0])
        assert "throttle 0 until released below 5 %: another source took over" in drive.sentence
        drive.offer(ControllerDemand(throttle_pct=5), source="chief", sequence=sequence)
    drive.offer(ControllerDemand(throttle_pct=4.9), source="chief", sequence=1002)
    drive.tick()
    assert throttles(drive) == [13, 13]


def test_who_takes_over_with_a_released_pedal_drives_on_from_the_next_tick():
    drive = taken_over(throttle_pct=4.9)
    drive.tick()
    drive.offer(ControllerDemand(throttle_pct=40), source="chief", sequence=1000)
    drive.tick()
    assert throttles(drive) == [13, 13]


def test_who_takes_over_in_standby_is_held_by_nothing():
    drive = standby(priorities={"chief": 1})
    drive.offer(ControllerDemand(throttle_pct=40), source="chief")
    assert drive.gateway._commander.pedals.latched == set()


def test_an_old_number_is_refused_after_another_source_had_the_demand():
    drive = standby(priorities={"chief": 1})
    drive.offer(ControllerDemand(), source="driver", sequence=500)
    drive.offer(ControllerDemand(), source="chief", sequence=1)
    drive.now_ns += 201 * MS
    answer = drive.offer(ControllerDemand(), source="driver", sequence=500)
    assert answer.refusal is Refusal.OLD_SEQUENCE
    assert drive.offer(ControllerDemand(), source="driver", sequence=501).granted


# What the throttle waits for.


def test_why_tells_that_the_throttle_waits_for_the_pedal():
    drive = driving()
    drive.demanded = ControllerDemand(throttle_pct=40, brake_pct=10)
    drive.tick()
    sentence = "throttle 0 until released below 5 %: brake over throttle"
    assert drive.gateway.why(drive.now_ns).waits == (sentence,)


def test_why_tells_what_a_change_of_direction_waits_for():
    drive = driving()
    drive.turn(50, 49)
    drive.demanded = replace(PUSHED, motor_reverse=True)
    drive.tick()
    waits = "throttle 0 until the direction changes; not below 50 rpm: PCU1"
    assert drive.gateway.why(drive.now_ns).waits == (waits,)
    drive.turn(49, 6001)
    drive.tick()
    waits = "throttle 0 until the direction changes; speed unknown of PCU2"
    assert drive.gateway.why(drive.now_ns).waits == (waits,)
    drive.turn(49)
    drive.run(200)
    assert drive.gateway.why(drive.now_ns).waits == ()


def test_why_tells_that_there_is_no_throttle_in_power_mode_safety():
    drive = driving()
    drive.demanded = None
    safety = replace(PUSHED, power_mode=PowerMode.SAFETY)
    drive.offer(PUSHED, controllers={"PCU1": PUSHED, "PCU2": safety})
    drive.tick()
    assert throttles(drive) == [103, 0]
    waits = "throttle 0 in power mode safety (PCU2)"
    assert drive.gateway.why(drive.now_ns).waits == (waits,)


# PowerMode.


def modes(drive: Drive) -> list[int]:
    return [command[0] >> 2 & 3 for command in drive.commands]


def test_power_mode_does_not_rise_with_throttle_whatever_is_demanded():
    drive = driving()
    drive.demanded = replace(PUSHED, power_mode=PowerMode.TURBO)
    drive.run(500)
    assert modes(drive) == [PowerMode.ECO] * 2
    assert "power mode eco until the throttle is below 5 % (PCU1 and PCU2)" in drive.sentence
    drive.demanded = replace(drive.demanded, throttle_pct=4.8)
    drive.tick()
    assert throttles(drive) == [12, 12]
    assert modes(drive) == [PowerMode.ECO] * 2
    drive.tick()
    assert modes(drive) == [PowerMode.TURBO] * 2
    assert "power mode" not in drive.sentence


def test_power_mode_rises_for_both_controllers_in_the_same_tick():
    drive = driving()
    turbo, drive.demanded = replace(PUSHED, power_mode=PowerMode.TURBO), None
    released = replace(turbo, throttle_pct=0)
    drive.offer(PUSHED, controllers={"PCU1": turbo, "PCU2": released}, ttl_ms=1000)
    drive.run(100)
    assert throttles(drive) == [103, 0]
    assert modes(drive) == [PowerMode.ECO] * 2
    drive.offer(PUSHED, controllers={"PCU1": released, "PCU2": released})
    drive.tick()
    assert modes(drive) == [PowerMode.ECO] * 2
    drive.tick()
    assert modes(drive) == [PowerMode.TURBO] * 2


def test_power_mode_safety_of_one_controller_ends_with_released_throttle_of_both():
    drive = driving()
    safety, drive.demanded = replace(PUSHED, power_mode=PowerMode.SAFETY), None
    drive.offer(PUSHED, controllers={"PCU1": PUSHED, "PCU2": safety})
    drive.tick()
    drive.offer(PUSHED)
    drive.tick()
    assert throttles(drive) == [103, 0]
    assert modes(drive) == [PowerMode.ECO, PowerMode.SAFETY]
    assert "power mode safety until the throttle is below 5 % (PCU2)" in drive.sentence
    drive.offer(replace(PUSHED, throttle_pct=0))
    drive.run(100)
    assert modes(drive) == [PowerMode.ECO] * 2


def test_a_controller_whose_power_mode_waits_in_safety_stays_behind_and_no_frame_is_blocked():
    drive = active()
    drive.demanded = None
    parked = replace(PUSHED, power_mode=PowerMode.SAFETY)
    for _ in range(6):
        drive.offer(PUSHED, controllers={"PCU1": PUSHED, "PCU2": parked})
        drive.tick()
    drive.demanded = replace(PUSHED, throttle_pct=100)
    drive.run(1000)
    assert throttles(drive)[0] > 200
    assert throttles(drive)[1] == 0
    assert modes(drive)[1] == PowerMode.SAFETY
    assert drive.gateway.transmitter.gate.blocked == {}
    drive.demanded = replace(PUSHED, throttle_pct=0)
    drive.run(200)
    drive.demanded = PUSHED
    drive.run(2000)
    assert len(set(throttles(drive))) == 1


def test_power_mode_does_not_rise_with_throttle_where_a_limit_ends():
    drive = active()
    drive.demanded = replace(PUSHED, power_mode=PowerMode.TURBO)
    drive.run(1000)
    assert modes(drive) == [PowerMode.TURBO] * 2
    drive.codes["PCU1_Status1.TemperatureProtectLevel"] = 1
    drive.run(1000)
    assert modes(drive) == [PowerMode.NORMAL] * 2
    drive.codes.clear()
    drive.run(3000)
    assert "limited" not in drive.sentence
    assert modes(drive) == [PowerMode.NORMAL] * 2
    assert "power mode normal until the throttle is below 5 % (PCU1 and PCU2)" in drive.sentence


def test_a_power_mode_that_only_one_controller_was_sent_is_taken_back():
    drive = active()
    drive.demanded = ControllerDemand(throttle_pct=100, power_mode=PowerMode.TURBO)
    drive.taken = ["PCU1"]
    drive.tick()
    assert modes(drive) == [PowerMode.TURBO] * 2
    drive.taken = list(COMMAND_IDS)
    drive.tick()
    assert modes(drive) == [PowerMode.ECO] * 2


# Regeneration.


def test_regeneration_needs_both_motors_speeds_and_returns_50_rpm_above():
    drive = active()
    drive.demanded = ControllerDemand(brake_pct=50, regen_brake=True)

    def regenerates(*speeds: int) -> bool:
        drive.turn(*speeds)
        drive.run(600)
        told = {(frame[0] & 0x20, frame[2]) for frame in drive.commands}
        assert told in ({(0, 128)}, {(0x20, 128)}), "the pedal stays"
        return told == {(0x20, 128)}

    assert not regenerates(0)
    assert not regenerates(149)
    assert regenerates(150)
    assert regenerates(100)
    assert not regenerates(100, 99)
    assert not regenerates(149, 2000)
    assert regenerates(150, 150)
    assert not regenerates(2000, 6001), "not known"


def test_regeneration_at_any_speed_where_the_least_speed_is_zero():
    drive = active(regen_min_rpm=0.0)
    drive.demanded = ControllerDemand(brake_pct=50, regen_brake=True)
    drive.turn(0, 6001)
    drive.tick()
    assert [(frame[0] & 0x20, frame[2]) for frame in drive.commands] == [(0x20, 128)] * 2
