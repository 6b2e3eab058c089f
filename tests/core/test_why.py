"""`why` answers in one line what a person needs at three in the morning."""

import pytest

from tests.core.safety_world import (
    MS,
    Drive,
    active,
    in_mode,
    standby,
)
from vcu_gateway.core.causes import Effect, Finding, Held
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.supervisor import FaultClass, Latch, Mode
from vcu_gateway.core.why import Why, next_step


def test_while_listening():
    drive = Drive()
    drive.silent |= {"BMS_Status", "PCU1_Status1", "PCU2_Status1", "BMS_Temperatures"}
    drive.asked = None
    drive.tick()
    sentence = drive.sentence
    assert sentence.startswith("starting; blocked by BMS_Status never received: stop (for 0.0 s), ")
    assert sentence.endswith("; listening for another sender of our frames; no demand; wait")


def test_while_waiting_for_messages():
    drive = Drive()
    drive.silent.add("BMS_Status")
    drive.run(4050)
    assert drive.sentence == (
        "starting; blocked by BMS_Status never received: stop (for 4.0 s); "
        "waiting for BMS_Status; demand of driver 0 ms old; wait"
    )


def test_in_a_healthy_standby():
    assert standby().sentence == "standby; demand of driver 0 ms old; arm"


def test_in_standby_it_says_what_speaks_against_arming():
    drive = standby()
    drive.asked = ControllerDemand(throttle_pct=5)
    drive.tick()
    assert drive.sentence == (
        "standby; demand of driver 0 ms old; before arming: the demanded throttle is not 0"
    )


def test_an_expired_demand_is_told_with_its_age():
    drive = standby()
    drive.asked = None
    drive.run(300)
    assert drive.sentence == (
        "standby; demand of driver 300 ms old, expired; before arming: there is no fresh demand"
    )


def test_a_bench_demand_has_no_age():
    drive = Drive(bench_demand=ControllerDemand())
    drive.asked = None
    drive.until(Mode.STANDBY).run(1500)
    assert drive.sentence == "standby; demand of bench; arm"


def test_in_active_it_says_what_limits_since_when_and_whether_it_still_stands():
    drive = active()
    assert drive.sentence == "active; demand of driver 0 ms old; drive; disarm to end"
    drive.codes |= {"BMS_Status.CellUndervoltage": 1, "BMS_Status.VoltageImbalance": 1}
    drive.receive("BMS_Status")
    drive.tick()
    drive.run(1000)
    assert drive.sentence == (
        "active; limited by BMS_Status.CellUndervoltage 1 (level1): power limit (for 1.0 s); "
        "alarm BMS_Status.VoltageImbalance 1 (level1): alarm (for 1.0 s); "
        "demand of driver 0 ms old; drive; disarm to end"
    )
    drive.codes.clear()
    drive.receive("BMS_Status")
    drive.run(500)
    assert "power limit (for 1.5 s, gone and held)" in drive.sentence


def test_in_fault_it_says_what_latched_what_blocks_and_what_comes_first():
    drive = active()
    drive.gateway.requests.emergency_stop()
    drive.tick()
    assert drive.sentence == (
        "fault; latched (service): emergency stop requested: cut; "
        "blocked by emergency stop requested: cut (for 0.0 s); demand of driver 0 ms old; "
        "first: emergency stop requested: cut stands or stood a moment ago; then service reset"
    )
    drive.run(2000)
    assert drive.sentence == (
        "fault; latched (service): emergency stop requested: cut; demand of driver 0 ms old; "
        "service reset"
    )


def test_a_fault_that_the_driver_may_reset_asks_for_no_service():
    drive = in_mode(Mode.FAULT)
    assert drive.sentence == (
        "fault; latched (driver): command 0008A7D0: stop; demand of driver 0 ms old; reset"
    )


def test_while_ending():
    drive = in_mode(Mode.STOPPING)
    assert drive.sentence == "stopping; demand of driver 0 ms old; the gateway is ending"


@pytest.mark.parametrize(
    ("mode", "refusal", "step"),
    [
        (Mode.STARTING, "", "wait"),
        (Mode.STANDBY, "", "arm"),
        (Mode.STANDBY, "no", "before arming: no"),
        (Mode.ACTIVE, "", "drive; disarm to end"),
        (Mode.FAULT, "", "reset"),
        (Mode.FAULT, "no", "first: no; then reset"),
        (Mode.STOPPING, "", "the gateway is ending"),
    ],
)
def test_every_mode_has_a_next_step(mode, refusal, step):
    assert next_step(mode, None, refusal) == step


@pytest.mark.parametrize(
    ("refusal", "step"), [("", "service reset"), ("no", "first: no; then service reset")]
)
def test_a_cut_names_the_level_of_its_reset(refusal, step):
    latch = Latch(FaultClass.SERVICE, "cut", 0)
    assert next_step(Mode.FAULT, latch, refusal) == step


def why(now_ns: int, detail: str = "1101 ms", effect: Effect = Effect.POWER_LIMIT) -> Why:
    limits = (Held(Finding("late", "BMS_Status", effect, detail), 0, now_ns),)
    return Why(
        now_ns, now_ns, Mode.ACTIVE, None, (), limits, (), (), "driver", 50 * MS, 200, True, "drive"
    )


def test_the_same_answer_at_another_time_has_the_same_signature():
    assert why(0).signature() == why(500 * MS, "1601 ms").signature()
    assert why(0).signature() != why(0, effect=Effect.REGEN_LIMIT).signature()


def test_the_answer_is_data_too():
    drive = active()
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.run(500)
    found = drive.gateway.why(drive.now_ns)
    assert (found.now_ns, found.mode, found.latch) == (drive.now_ns, Mode.ACTIVE, None)
    assert [(one.finding.subject, one.finding.effect) for one in found.limits] == [
        ("BMS_Status.CellUndervoltage", Effect.POWER_LIMIT)
    ]
    assert (found.blocks, found.alarms, found.waits) == ((), (), ())
    assert (found.demand_source, found.demand_age_ns, found.demand_fresh) == ("driver", 0, True)
    assert found.demand_ttl_ms == 200


def test_between_two_ticks_a_cause_stands_as_the_last_tick_judged_it():
    drive = standby()
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.run(1000)
    sentence = drive.gateway.why(drive.now_ns + 20 * MS).sentence()
    assert "power limit (for " in sentence
    assert "gone and held" not in sentence


def test_the_headline_names_the_first_of_many_causes_and_how_many_more():
    drive = Drive()
    drive.silent |= {"BMS_Status", "PCU1_Status2"}
    drive.tick()
    assert drive.gateway.why(drive.now_ns).headline() == (
        "starting; blocked by BMS_Status never received: stop and 2 more; "
        "listening for another sender of our frames; wait"
    )


def test_the_headline_of_a_healthy_standby_is_short():
    drive = standby()
    assert drive.gateway.why(drive.now_ns).headline() == "standby; arm"


def test_the_headline_of_a_limited_drive_names_the_limit():
    drive = active()
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.run(600)
    assert drive.gateway.why(drive.now_ns).headline() == (
        "active; limited by BMS_Status.CellUndervoltage 1 (level1): power limit; "
        "drive; disarm to end"
    )


def test_the_headline_of_a_fault_names_what_latched():
    drive = in_mode(Mode.FAULT)
    assert drive.gateway.why(drive.now_ns).headline().startswith("fault; latched: ")
