"""What is kept of a tick explains later what a fresh explanation said then."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.core.simulated_drive import MS, Drive, active, in_mode, standby
from vcu_gateway.core import calls
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.daemon.loop import LastTick

DEMANDED = ControllerDemand(throttle_pct=20)
CHANGES = {
    "released": lambda drive: setattr(drive, "demanded", ControllerDemand()),
    "driven": lambda drive: setattr(drive, "demanded", DEMANDED),
    "reversed": lambda drive: setattr(drive, "demanded", ControllerDemand(motor_reverse=True)),
    "safety": lambda drive: setattr(
        drive, "demanded", replace(DEMANDED, power_mode=PowerMode.SAFETY)
    ),
    "braked": lambda drive: setattr(
        drive, "demanded", ControllerDemand(throttle_pct=50, brake_pct=50)
    ),
    "nobody": lambda drive: setattr(drive, "demanded", None),
    "turning": lambda drive: drive.turn(3000),
    "standing": lambda drive: drive.turn(0),
    "limited": lambda drive: drive.codes.update({"BMS_Status.CellUndervoltage": 1}),
    "stopped": lambda drive: drive.codes.update({"BMS_Status.CellUndervoltage": 2}),
    "cut": lambda drive: drive.codes.update({"BMS_Status.CellUndervoltage": 3}),
    "well": lambda drive: (drive.codes.clear(), drive.silent.clear()),
    "silent": lambda drive: drive.silent.update({"BMS_Status", "PCU1_Status2"}),
    "foreign": lambda drive: drive.receive_foreign(),
    "lost": lambda drive: drive.gateway.apply(calls.LoseLink(drive.now_ns)),
    "opened": lambda drive: drive.open_link(),
    "refused": lambda drive: setattr(drive, "accepted", False),
    "accepted": lambda drive: setattr(drive, "accepted", True),
    "armed": lambda drive: drive.arm(),
    "disarmed": lambda drive: drive.gateway.requests.disarm(drive.now_ns),
    "reset": lambda drive: drive.reset(),
    "emergency stop": lambda drive: drive.gateway.requests.emergency_stop(),
    "restarted": lambda drive: drive.gateway.apply(calls.CountRestarts(3)),
}
BEGUN = {mode: in_mode(mode) for mode in Mode}
BENCH = Drive(bench_demand=DEMANDED, auto_arm=True)


def explained(drive, before=None):
    return LastTick.explained(drive.gateway, drive.result, drive.now_ns, before)


@pytest.mark.ci
@given(
    st.sampled_from([*BEGUN.values(), BENCH]),
    st.lists(st.tuples(st.sampled_from(sorted(CHANGES)), st.integers(0, 30)), max_size=12),
)
def test_what_is_kept_of_each_tick_reads_as_a_fresh_explanation_did(begun, legs):
    drive, kept, fresh = begun.twin(), [], []
    for change, ticks in [("standing", 1), *legs]:
        CHANGES[change](drive)
        for _ in range(ticks):
            drive.tick()
            kept.append(explained(drive, kept[-1] if kept else None))
            fresh.append(drive.gateway.why(drive.now_ns))
            assert kept[-1].why_signature == drive.gateway.reasons(drive.now_ns).signature()
    assert [tick.why for tick in kept] == fresh


def test_while_nothing_changes_the_signature_is_made_once():
    drive = active()
    before = explained(drive)
    drive.run(500)
    after = explained(drive, before)
    assert after.why_signature is before.why_signature
    assert after.why.demand_age_ns == 0
    assert after.why.now_ns - before.why.now_ns == 500 * MS


def test_a_change_makes_another_signature():
    drive = standby()
    before = explained(drive)
    drive.arm()
    assert explained(drive, before).why_signature != before.why_signature


def test_between_two_ticks_the_age_of_the_demand_goes_on():
    drive = active()
    drive.now_ns += 20 * MS
    assert explained(drive).why.demand_age_ns == 20 * MS
    assert explained(drive).why == drive.gateway.why(drive.now_ns)
