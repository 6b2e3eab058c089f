"""Why a request is refused: the first reason against it, as a sentence."""

import pytest

from tests.core.safety_world import MS
from vcu_gateway.core.causes import Causes, Effect, Finding
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.permission import Pedal, against_arming, against_resetting
from vcu_gateway.core.supervisor import FaultClass, Mode, Stimulus, Supervisor

NOTHING_ASKED = {"PCU1": ControllerDemand(), "PCU2": ControllerDemand()}
RELEASED = Pedal(NOTHING_ASKED, zero_for_ns=200 * MS)
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


def test_a_healthy_standby_with_a_fresh_demand_of_nothing_may_be_armed():
    assert against_arming(supervisor(*STANDBY), causes(), RELEASED) == ""


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
    sentence = against_arming(supervisor(*stimuli), causes(), RELEASED)
    assert sentence == f"arming needs standby, the mode is {mode}"


@pytest.mark.parametrize("zero_for_ns", [None, 0, 200 * MS - 1])
def test_a_throttle_that_was_not_zero_for_200_ms_refuses_arming(zero_for_ns):
    pedal = RELEASED._replace(zero_for_ns=zero_for_ns)
    sentence = against_arming(supervisor(*STANDBY), causes(), pedal)
    assert sentence == "the demanded throttle has not been 0 for 200 ms"


@pytest.mark.parametrize(
    ("independent", "sentence"),
    [(False, "both controllers must have the same direction"), (True, "")],
)
def test_two_directions_refuse_arming_unless_they_are_configured(independent, sentence):
    asked = NOTHING_ASKED | {"PCU2": ControllerDemand(motor_reverse=True)}
    pedal = RELEASED._replace(asked=asked, independent_directions=independent)
    assert against_arming(supervisor(*STANDBY), causes(), pedal) == sentence


@pytest.mark.parametrize("absent_ms", [0, 1, 999])
@pytest.mark.parametrize("effect", [Effect.STOP, Effect.CUT])
def test_a_violation_that_stands_or_stood_a_moment_ago_refuses_arming(effect, absent_ms):
    found = causes(effect, absent_ms=absent_ms)
    sentence = against_arming(supervisor(*STANDBY), found, RELEASED)
    assert sentence == f"BMS_Status.X 2: {effect.value} stands or stood a moment ago"


@pytest.mark.parametrize(
    "effect",
    [Effect.ALARM, Effect.TURBO_OFF, Effect.POWER_LIMIT, Effect.REGEN_LIMIT, Effect.REGEN_OFF],
)
def test_alarms_and_limits_do_not_refuse_arming(effect):
    assert against_arming(supervisor(*STANDBY), causes(effect), RELEASED) == ""


def test_a_violation_absent_for_the_hold_no_longer_refuses_arming():
    found = causes(Effect.STOP, absent_ms=1000)
    assert against_arming(supervisor(*STANDBY), found, RELEASED) == ""


def test_without_a_fresh_demand_arming_is_refused():
    sentence = against_arming(supervisor(*STANDBY), causes(), Pedal(None, None))
    assert sentence == "there is no fresh demand"


@pytest.mark.parametrize("asked", [(0.39, 0), (0, 0.39), (1e-9, 0), (100, 100)])
def test_arming_is_refused_while_either_throttle_is_asked(asked):
    sentence = against_arming(supervisor(*STANDBY), causes(), Pedal(throttle(*asked), None))
    assert sentence == "the demanded throttle is not 0"


def test_arming_is_refused_while_a_change_of_direction_is_pending():
    sentence = against_arming(
        supervisor(*STANDBY), causes(), RELEASED._replace(reverse_pending=True)
    )
    assert sentence == "a change of direction is pending"


@pytest.mark.parametrize("stimuli", [(), STANDBY, (*STANDBY, Stimulus.ARM), (Stimulus.TERMINATE,)])
def test_outside_fault_there_is_nothing_to_reset(stimuli):
    sentence = against_resetting(supervisor(*stimuli), causes(), None, SERVICE)
    assert sentence == "nothing is latched"


def test_a_latch_that_is_kept_while_ending_cannot_be_reset():
    ending = supervisor(*CUT, Stimulus.TERMINATE)
    assert ending.latch is not None
    assert against_resetting(ending, causes(), None, SERVICE) == "nothing is latched"


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
    stopped = supervisor(*stimuli)
    sentence = against_resetting(stopped, causes(), NOTHING_ASKED, level)
    needs = "BMS_Status.InternalFault 1 (level2): cut needs a reset at service level"
    assert sentence == ("" if granted else needs)
    assert stopped.mode is Mode.FAULT


@pytest.mark.parametrize(("absent_ms", "granted"), [(0, False), (999, False), (1000, True)])
def test_a_reset_is_refused_while_the_cause_stands_or_was_seen_in_the_hold(absent_ms, granted):
    found = causes(Effect.STOP, absent_ms=absent_ms)
    sentence = against_resetting(supervisor(*STOPPED), found, NOTHING_ASKED, DRIVER)
    assert sentence == ("" if granted else "BMS_Status.X 2: stop stands or stood a moment ago")


def test_a_reset_is_refused_while_throttle_is_asked_and_not_for_want_of_a_demand():
    stopped = supervisor(*STOPPED)
    asked = throttle(0, 1)
    assert against_resetting(stopped, causes(), asked, DRIVER) == "the demanded throttle is not 0"
    assert against_resetting(stopped, causes(), None, DRIVER) == ""
