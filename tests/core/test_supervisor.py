"""The table of modes, cell by cell, against docs/safety.md, Modes; latching and its classes."""

from itertools import product

import pytest

from vcu_gateway.core.causes import Severity
from vcu_gateway.core.supervisor import (
    TRANSITIONS,
    FaultClass,
    Mode,
    Stimulus,
    Supervisor,
    following,
)

CELLS = list(product(Mode, Stimulus))


def expected(mode: Mode, stimulus: Stimulus) -> Mode:
    """The sentences of docs/safety.md, Modes, in their order of precedence."""
    if mode is Mode.STOPPING or stimulus is Stimulus.TERMINATE:
        return Mode.STOPPING  # "then exit"
    if stimulus in (Stimulus.CUT, Stimulus.LATCHING_STOP):
        return Mode.FAULT  # "from every mode by a CUT effect or another sender"
    if mode is Mode.FAULT:
        return Mode.STARTING if stimulus is Stimulus.RESET else Mode.FAULT  # "never to ACTIVE"
    if mode is Mode.ACTIVE:
        return {
            Stimulus.STOP: Mode.FAULT,  # "entered from ACTIVE by any STOP effect"
            Stimulus.REQUIRED_LOST: Mode.FAULT,  # required messages that are stale are a STOP
            Stimulus.DEMAND_EXPIRED: Mode.STANDBY,  # "back to STANDBY"
            Stimulus.DISARM: Mode.STANDBY,
        }.get(stimulus, Mode.ACTIVE)
    if mode is Mode.STANDBY:
        return {
            Stimulus.ARM: Mode.ACTIVE,
            Stimulus.REQUIRED_LOST: Mode.STARTING,  # "leads back to STARTING"
        }.get(stimulus, Mode.STANDBY)  # "a STOP cause blocks arm and does not latch"
    return Mode.STANDBY if stimulus is Stimulus.QUALIFIED else Mode.STARTING


def in_mode(mode: Mode) -> Supervisor:
    way = {
        Mode.STARTING: (),
        Mode.STANDBY: (Stimulus.QUALIFIED,),
        Mode.ACTIVE: (Stimulus.QUALIFIED, Stimulus.ARM),
        Mode.FAULT: (Stimulus.LATCHING_STOP,),
        Mode.STOPPING: (Stimulus.TERMINATE,),
    }
    supervisor = Supervisor(0)
    for stimulus in way[mode]:
        supervisor.apply(stimulus, 0, "another sender")
    assert supervisor.mode is mode
    return supervisor


def test_the_table_is_total():
    assert set(TRANSITIONS) == set(Stimulus)
    assert all(len(cells) == len(Mode) for cells in TRANSITIONS.values())
    assert len(CELLS) == 50


@pytest.mark.parametrize(
    ("mode", "stimulus"), CELLS, ids=[f"{mode.name}-{stimulus.name}" for mode, stimulus in CELLS]
)
def test_every_cell_is_what_the_safety_page_says(mode, stimulus):
    assert following(mode, stimulus) is expected(mode, stimulus)
    supervisor = in_mode(mode)
    supervisor.apply(stimulus, 1)
    assert supervisor.mode is expected(mode, stimulus)


def test_a_restart_always_begins_in_starting_and_unlatched():
    supervisor = Supervisor(7)
    assert (supervisor.mode, supervisor.since_ns, supervisor.latch) == (Mode.STARTING, 7, None)
    assert not supervisor.power_is_cut


def test_only_arm_and_only_from_standby_leads_to_active():
    entries = {
        (mode, stimulus)
        for mode, stimulus in CELLS
        if mode is not Mode.ACTIVE and following(mode, stimulus) is Mode.ACTIVE
    }
    assert entries == {(Mode.STANDBY, Stimulus.ARM)}


def test_only_reset_leaves_a_fault_and_nothing_leaves_stopping():
    leaving = {s for s in Stimulus if following(Mode.FAULT, s) is not Mode.FAULT}
    assert leaving == {Stimulus.RESET, Stimulus.TERMINATE}
    assert {following(Mode.STOPPING, stimulus) for stimulus in Stimulus} == {Mode.STOPPING}


@pytest.mark.parametrize("mode", [mode for mode in Mode if mode is not Mode.STOPPING])
@pytest.mark.parametrize(
    ("stimulus", "fault_class"),
    [
        (Stimulus.STOP, FaultClass.DRIVER),
        (Stimulus.REQUIRED_LOST, FaultClass.DRIVER),
        (Stimulus.LATCHING_STOP, FaultClass.DRIVER),
        (Stimulus.CUT, FaultClass.SERVICE),
    ],
)
def test_a_fault_is_latched_with_its_class_where_it_is_entered(mode, stimulus, fault_class):
    supervisor = in_mode(mode)
    supervisor.apply(stimulus, 5, "because")
    if expected(mode, stimulus) is not Mode.FAULT:
        assert supervisor.latch is None
        return
    assert supervisor.latch is not None
    assert supervisor.latch.fault_class is fault_class
    assert supervisor.power_is_cut is (fault_class is FaultClass.SERVICE)


@pytest.mark.parametrize("stimulus", Stimulus)
def test_while_ending_a_cut_alone_is_latched(stimulus):
    supervisor = in_mode(Mode.STOPPING)
    events = supervisor.apply(stimulus, 5, "because")
    assert supervisor.mode is Mode.STOPPING
    if stimulus is Stimulus.CUT:
        (latched,) = events
        assert latched.fields == {"fault_class": "service", "reason": "because"}
        assert supervisor.power_is_cut
        assert supervisor.apply(stimulus, 6, "again") == []
    else:
        assert (events, supervisor.latch) == ([], None)


def test_entering_a_fault_tells_the_latch_and_the_mode():
    supervisor = in_mode(Mode.ACTIVE)
    latched, moved = supervisor.apply(Stimulus.STOP, 5, "BMS_Status 1601 ms: stop")
    assert (latched.name, latched.severity) == ("fault_latched", Severity.CRITICAL)
    assert latched.fields == {"fault_class": "driver", "reason": "BMS_Status 1601 ms: stop"}
    assert (moved.name, moved.severity) == ("mode_changed", Severity.ERROR)
    assert moved.fields == {
        "before": "active",
        "after": "fault",
        "reason": "BMS_Status 1601 ms: stop",
    }
    assert (supervisor.since_ns, supervisor.latch.since_ns) == (5, 5)


def test_a_cut_raises_a_fault_to_service_class_and_nothing_lowers_it():
    supervisor = in_mode(Mode.ACTIVE)
    supervisor.apply(Stimulus.STOP, 5, "first")
    assert supervisor.apply(Stimulus.STOP, 6, "second") == []
    assert supervisor.latch.reason == "first", "the first reason stays"
    (raised,) = supervisor.apply(Stimulus.CUT, 7, "third")
    assert raised.fields == {"fault_class": "service", "reason": "third"}
    assert (supervisor.latch.reason, supervisor.since_ns) == ("third", 5)
    for stimulus in (Stimulus.STOP, Stimulus.LATCHING_STOP, Stimulus.CUT, Stimulus.REQUIRED_LOST):
        assert supervisor.apply(stimulus, 8, "later") == []
    assert (supervisor.latch.fault_class, supervisor.latch.reason) == (FaultClass.SERVICE, "third")


def test_what_does_not_latch_leaves_the_latch_alone():
    supervisor = in_mode(Mode.FAULT)
    latch = supervisor.latch
    for stimulus in (Stimulus.DEMAND_EXPIRED, Stimulus.QUALIFIED, Stimulus.ARM, Stimulus.DISARM):
        assert supervisor.apply(stimulus, 9, "whatever") == []
        assert supervisor.latch is latch


def test_a_reset_takes_the_latch_away():
    supervisor = in_mode(Mode.FAULT)
    (moved,) = supervisor.apply(Stimulus.RESET, 9, "reset at driver level")
    assert (moved.fields["before"], moved.fields["after"]) == ("fault", "starting")
    assert moved.severity is Severity.INFO
    assert supervisor.latch is None


def test_ending_out_of_a_fault_keeps_the_power_cut():
    supervisor = in_mode(Mode.ACTIVE)
    supervisor.apply(Stimulus.CUT, 5, "emergency stop requested: cut")
    supervisor.apply(Stimulus.TERMINATE, 6)
    assert supervisor.mode is Mode.STOPPING
    assert supervisor.power_is_cut
