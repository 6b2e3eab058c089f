"""Requests: when they are refused and why, their events, and what a reload reaches."""

from dataclasses import replace
from typing import Any

import pytest

from tests.core.simulated_drive import MS, PERIOD_NS, active, standby
from vcu_gateway.core.causes import Causes, Effect, Finding
from vcu_gateway.core.demand import ControllerDemand, Demand
from vcu_gateway.core.operator_requests import (
    LISTENING,
    RequestInputs,
    arming_refusal,
    reset_refusal,
)
from vcu_gateway.core.supervisor import FaultClass, Mode, Stimulus, Supervisor

NOTHING_DEMANDED = {"PCU1": ControllerDemand(), "PCU2": ControllerDemand()}
DRIVER, SERVICE = FaultClass.DRIVER, FaultClass.SERVICE


def throttle(first: float, second: float) -> dict[str, ControllerDemand]:
    return {"PCU1": ControllerDemand(first), "PCU2": ControllerDemand(second)}


def supervisor(*stimuli: Stimulus) -> Supervisor:
    made = Supervisor(0)
    for stimulus in stimuli:
        made.apply(stimulus, 0, "BMS_Status.InternalFault 1 (level2): cut")
    return made


def causes(*effects: Effect, absent_ms: int = 0) -> Causes:
    made = Causes()
    made.update([Finding("code", "BMS_Status.X", effect, "2") for effect in effects], 10**9, 0)
    if absent_ms:
        made.update([], 10**9, MS)
        made.update([], 10**9, (1 + absent_ms) * MS)
    return made


STANDBY = (Stimulus.QUALIFIED,)
STOPPED = (Stimulus.LATCHING_STOP,)
CUT = (Stimulus.CUT,)


def inputs(*stimuli: Stimulus, found: Causes | None = None, **changes: Any) -> RequestInputs:
    """A released throttle without a cause, after these stimuli, but for the changes."""
    healthy = RequestInputs(
        supervisor=supervisor(*stimuli),
        causes=found or causes(),
        emergency_stop=False,
        demanded=NOTHING_DEMANDED,
        zero_for_ns=200 * MS,
        reverse_pending=False,
        independent_directions=False,
        listening=False,
        restarts=0,
        restart_state_failure=None,
        speed_pending=False,
    )
    return healthy._replace(**changes)


def test_a_healthy_standby_with_a_fresh_demand_of_nothing_may_be_armed():
    assert arming_refusal(inputs(*STANDBY)) == ""


def test_a_restart_state_that_cannot_be_kept_is_against_arming():
    sentence = arming_refusal(inputs(*STANDBY, restart_state_failure="No space"))
    assert sentence == "the restart state cannot be kept: No space"
    starting = inputs(restart_state_failure="No space")
    assert arming_refusal(starting) == "arming needs standby, the mode is starting"


@pytest.mark.parametrize(
    ("stimuli", "mode"),
    [
        ((), "starting"),
        ((Stimulus.QUALIFIED, Stimulus.ARM), "active"),
        (STOPPED, "fault"),
        ((Stimulus.TERMINATE,), "stopping"),
    ],
)
def test_arming_needs_standby(stimuli, mode):
    sentence = arming_refusal(inputs(*stimuli))
    assert sentence == f"arming needs standby, the mode is {mode}"


@pytest.mark.parametrize("zero_for_ns", [None, 0, 200 * MS - 1])
def test_a_throttle_that_was_not_zero_for_200_ms_refuses_arming(zero_for_ns):
    sentence = arming_refusal(inputs(*STANDBY, zero_for_ns=zero_for_ns))
    assert sentence == "the demanded throttle has not been 0 for 200 ms"


@pytest.mark.parametrize(
    ("independent", "sentence"),
    [(False, "both controllers must have the same direction"), (True, "")],
)
def test_two_directions_refuse_arming_unless_they_are_configured(independent, sentence):
    demanded = NOTHING_DEMANDED | {"PCU2": ControllerDemand(motor_reverse=True)}
    two = inputs(*STANDBY, demanded=demanded, independent_directions=independent)
    assert arming_refusal(two) == sentence


@pytest.mark.parametrize("absent_ms", [0, 1, 999])
@pytest.mark.parametrize("effect", [Effect.STOP, Effect.CUT])
def test_a_violation_that_stands_or_stood_a_moment_ago_refuses_arming(effect, absent_ms):
    found = causes(effect, absent_ms=absent_ms)
    sentence = arming_refusal(inputs(*STANDBY, found=found))
    assert sentence == f"BMS_Status.X 2: {effect.value} stands or stood a moment ago"


@pytest.mark.parametrize(
    "effect",
    [Effect.ALARM, Effect.TURBO_OFF, Effect.POWER_LIMIT, Effect.REGEN_LIMIT, Effect.REGEN_OFF],
)
def test_alarms_and_limits_do_not_refuse_arming(effect):
    assert arming_refusal(inputs(*STANDBY, found=causes(effect))) == ""


def test_a_violation_absent_for_the_hold_no_longer_refuses_arming():
    found = causes(Effect.STOP, absent_ms=1000)
    assert arming_refusal(inputs(*STANDBY, found=found)) == ""


def test_without_a_fresh_demand_arming_is_refused():
    sentence = arming_refusal(inputs(*STANDBY, demanded=None, zero_for_ns=None))
    assert sentence == "there is no fresh demand"


@pytest.mark.parametrize("demanded", [(0.39, 0), (0, 0.39), (1e-9, 0), (100, 100)])
def test_arming_is_refused_while_either_throttle_is_demanded(demanded):
    pressed = inputs(*STANDBY, demanded=throttle(*demanded), zero_for_ns=None)
    sentence = arming_refusal(pressed)
    assert sentence == "the demanded throttle is not 0"


def test_arming_is_refused_while_a_change_of_direction_is_pending():
    sentence = arming_refusal(inputs(*STANDBY, reverse_pending=True))
    assert sentence == "a change of direction is pending"


def test_arming_is_refused_until_the_speed_limit_has_come_down_to_its_cap():
    sentence = arming_refusal(inputs(*STANDBY, speed_pending=True))
    assert sentence == "the speed limit has not come down to its cap"


@pytest.mark.parametrize("stimuli", [(), STANDBY, (*STANDBY, Stimulus.ARM), (Stimulus.TERMINATE,)])
def test_outside_fault_there_is_nothing_to_reset(stimuli):
    sentence = reset_refusal(inputs(*stimuli, demanded=None), SERVICE)
    assert sentence == "nothing is latched"


def test_a_latch_that_is_kept_while_ending_cannot_be_reset():
    ending = inputs(*CUT, Stimulus.TERMINATE, demanded=None)
    assert ending.supervisor.latch is not None
    assert reset_refusal(ending, SERVICE) == "nothing is latched"


@pytest.mark.parametrize(
    ("stimuli", "level", "granted"),
    [
        (STOPPED, DRIVER, True),
        (STOPPED, SERVICE, True),
        (CUT, DRIVER, False),
        (CUT, SERVICE, True),
        ((*STOPPED, *CUT), DRIVER, False),
    ],
)
def test_a_cut_needs_a_reset_at_service_level(stimuli, level, granted):
    stopped = inputs(*stimuli)
    sentence = reset_refusal(stopped, level)
    needs = "BMS_Status.InternalFault 1 (level2): cut needs a reset at service level"
    assert sentence == ("" if granted else needs)
    assert stopped.supervisor.mode is Mode.FAULT


@pytest.mark.parametrize(("absent_ms", "granted"), [(0, False), (999, False), (1000, True)])
def test_a_reset_is_refused_while_the_cause_stands_or_was_seen_in_the_hold(absent_ms, granted):
    found = causes(Effect.STOP, absent_ms=absent_ms)
    sentence = reset_refusal(inputs(*STOPPED, found=found), DRIVER)
    assert sentence == ("" if granted else "BMS_Status.X 2: stop stands or stood a moment ago")


def test_an_emergency_stop_stands_from_its_request_on():
    sentence = "an emergency stop was requested"
    assert arming_refusal(inputs(*STANDBY, emergency_stop=True)) == sentence
    assert reset_refusal(inputs(*CUT, emergency_stop=True), SERVICE) == sentence


def test_of_several_causes_a_refusal_names_the_one_that_came_first():
    found = causes(Effect.ALARM, Effect.STOP, Effect.CUT)
    sentence = "BMS_Status.X 2: stop stands or stood a moment ago"
    assert arming_refusal(inputs(*STANDBY, found=found)) == sentence
    assert reset_refusal(inputs(*STOPPED, found=found), DRIVER) == sentence


def test_a_reset_is_refused_while_throttle_is_demanded_and_not_for_want_of_a_demand():
    pressed = inputs(*STOPPED, demanded=throttle(0, 1))
    assert reset_refusal(pressed, DRIVER) == "the demanded throttle is not 0"
    assert reset_refusal(pressed._replace(demanded=None), DRIVER) == ""


def test_too_many_restarts_refuse_arming_and_not_resetting():
    assert arming_refusal(inputs(*STANDBY, restarts=2)) == ""
    assert "was restarted 3 times" in arming_refusal(inputs(*STANDBY, restarts=3))
    assert reset_refusal(inputs(*STOPPED, restarts=3), DRIVER) == ""


def test_while_listening_nothing_is_armed_or_reset():
    assert arming_refusal(inputs(*STANDBY, listening=True)) == LISTENING
    assert reset_refusal(inputs(*STOPPED, listening=True), DRIVER) == LISTENING


def owners(drive) -> list[object]:
    drive.tick()
    return [event.fields["source"] for event in drive.events if event.name == "demand_owner"]


def demand_of(source: str, sequence: int = 1, ttl_ms: int = 200) -> Demand:
    both = {"PCU1": ControllerDemand(), "PCU2": ControllerDemand()}
    return Demand(source, sequence, ttl_ms, both)


def test_a_new_owner_of_the_demand_is_told_once():
    drive = standby()
    drive.demanded = None
    drive.run(400)
    for sequence in (1, 2):
        drive.gateway.requests.offer(demand_of("remote", sequence), drive.now_ns)
    assert owners(drive) == ["driver", "remote"]


def test_a_refused_source_is_no_owner():
    drive = standby()
    assert not drive.gateway.requests.offer(demand_of("remote"), drive.now_ns).granted
    assert owners(drive) == ["driver"]


def test_the_time_that_a_demand_waited_counts_for_the_tracks_of_the_pedal():
    drive = active()
    drive.demanded = None
    apart = ControllerDemand(20.0, throttle_track2_pct=40.0)
    assert drive.offer(apart, made_ns=drive.now_ns - 60 * MS).granted
    drive.tick()
    assert "the pedal's tracks differ" in drive.sentence


def test_a_request_to_arm_that_comes_too_late_finds_the_fault_of_the_late_tick():
    drive = active()
    drive.now_ns += 5 * PERIOD_NS + 1
    assert drive.arm().sentence == "arming needs standby, the mode is fault"


def test_a_drive_armed_while_the_tick_is_late_is_latched_by_the_next_request():
    drive = standby()
    drive.ttl_ms = 1000
    drive.tick()
    drive.now_ns += 5 * PERIOD_NS + 1
    assert drive.arm().granted
    assert drive.gateway.requests.disarm(drive.now_ns).granted
    assert drive.mode is Mode.FAULT


def test_a_reload_reaches_the_gate():
    drive = active()
    settings = replace(drive.gateway.settings, power_limit_max_w=1000)
    assert drive.gateway.reload(settings).granted
    assert drive.gateway.transmitter.gate.limits.power_limit_max_w == 1000.0


def test_the_bench_demand_asks_for_no_throttle_before_it_is_armed():
    bench = ControllerDemand(throttle_pct=30)
    drive = standby(bench_demand=bench)
    assert drive.mode is Mode.STANDBY
    demanded = drive.gateway.requests.demanded(drive.now_ns)
    assert {one.throttle_pct for one in demanded.values()} == {0.0}


def test_without_any_demand_nothing_is_asked():
    drive = standby()
    drive.gateway.requests.arbiter.end("driver")
    assert drive.gateway.requests.demanded(drive.now_ns) is None
