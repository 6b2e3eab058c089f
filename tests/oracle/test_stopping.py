"""Stopping is always possible; what is latched stays so until the reset that it needs."""

import json
import socket
import time
from typing import Any

import pytest

from tests.oracle import wire
from tests.oracle.api import Client, RefusedError
from tests.oracle.bench import GRACE_S, Bench

BATTERY = "BMS_Status"


def estop(bench: Bench) -> float:
    sent = time.monotonic()
    bench.client.call("estop")
    return sent


def test_the_emergency_stop_cuts_from_active_and_from_standby(bench):
    bench.drive(throttle_pct=30)
    bench.client.call("estop")
    bench.must_be_safe_after(time.monotonic() - GRACE_S, wire.POWER_CUT)
    why = bench.why()
    assert (why["mode"], why["latch"]["fault_class"]) == ("fault", "service")
    bench.standby()
    bench.client.call("estop")
    bench.must_be_safe_after(time.monotonic() - GRACE_S, wire.POWER_CUT)


def test_a_cut_latches_in_standby_and_a_stop_does_not(bench):
    since = time.monotonic()
    bench.vehicle.set(BATTERY, CellUndervoltage=2)
    bench.must_be_safe_after(bench.frame(BATTERY, since).t, wire.ZERO_TORQUE)
    assert bench.mode() == "standby"
    since = time.monotonic()
    bench.vehicle.set(BATTERY, CellUndervoltage=3)
    bench.must_be_safe_after(bench.frame(BATTERY, since).t, wire.POWER_CUT)
    assert bench.mode() == "fault"


def test_a_latched_cut_stays_until_a_service_reset_that_is_refused_while_anything_is_wrong(bench):
    bench.drive(throttle_pct=30)
    bench.vehicle.set(BATTERY, InternalFault=1)
    bench.rest(0.2)
    bench.demand(throttle_pct=0)
    assert bench.client.refusal("reset", level="service"), "the cause stands"
    since = time.monotonic()
    bench.vehicle.set(BATTERY, InternalFault=0)
    gone = bench.frame(BATTERY, since).t
    bench.until(gone + 0.90)
    assert bench.client.refusal("reset", level="service"), "seen in the last second"
    bench.until(gone + 1.15)
    assert bench.client.refusal("reset"), "driver level"
    bench.demand(throttle_pct=1)
    assert bench.client.refusal("reset", level="service"), "throttle"
    bench.demand(throttle_pct=0)
    assert bench.command() == wire.Command.of(wire.POWER_CUT)
    reset = time.monotonic()
    bench.client.call("reset", level="service")
    bench.rest(0.2)
    assert all(f.data == wire.ZERO_TORQUE for f in bench.commands(reset + 0.08))
    assert bench.mode() == "standby"


def test_a_latched_stop_needs_a_reset_at_driver_level_and_a_new_arm(bench):
    bench.drive(throttle_pct=30)
    bench.vehicle.set("PCU2_Status1", TemperatureProtectLevel=2)
    bench.rest(0.15)
    assert bench.client.refusal("arm")
    bench.vehicle.heal()
    bench.demand(throttle_pct=0)
    bench.rest(1.2)
    assert bench.mode() == "fault"
    assert bench.client.refusal("arm")
    bench.client.call("reset")
    bench.rest(0.1)
    assert bench.mode() == "standby"
    bench.arm()
    assert bench.mode() == "active"


def test_disarming_ends_the_drive_without_a_latch(bench):
    bench.drive(throttle_pct=30)
    bench.client.call("disarm")
    bench.must_be_safe_after(time.monotonic() - GRACE_S, wire.ZERO_TORQUE)
    assert bench.mode() == "standby"


MALFORMED: list[dict[str, Any]] = [
    {"jsonrpc": "2.0", "id": 1, "params": []},
    {"jsonrpc": "2.0", "id": None, "params": {}},
    {"jsonrpc": "2.0", "id": None},
    {"id": 1},
    {"jsonrpc": "2.0", "id": 1, "params": None},
    {"jsonrpc": "2.0", "id": 1, "params": {"now": True}},
    {"jsonrpc": "2.0"},
    {"jsonrpc": "1.0", "id": 1},
    {},
]


@pytest.mark.parametrize("method", ["estop", "disarm"])
def test_a_request_to_stop_is_done_though_its_form_is_wrong(bench, figures, method):
    wanted = wire.POWER_CUT if method == "estop" else wire.ZERO_TORQUE
    done = []
    for number, request in enumerate(MALFORMED):
        bench.drive(throttle_pct=10)
        with bench.another() as other:
            other.write(json.dumps({**request, "method": method}).encode() + b"\n")
            bench.rest(0.15)
            if bench.command() == wire.Command.of(wanted):
                done.append(number)
    figures.append(f"malformed {method}: done {len(done)} of {len(MALFORMED)}")
    assert done == list(range(len(MALFORMED)))


def test_sixteen_idle_connections_shut_nobody_out(bench, figures):
    idle = []
    for _ in range(16):
        one = socket.socket(socket.AF_UNIX)
        one.connect(str(bench.gateway.folder / "control.sock"))
        idle.append(one)
    bench.rest(0.2)
    try:
        bench.client.call("why")  # the driver's own is not idle
        bench.drive(throttle_pct=10)
        stopped = 0
        for _ in range(3):
            with Client(str(bench.gateway.folder / "control.sock"), 2.0) as late:
                try:
                    late.call("estop")
                    stopped += 1
                except (RefusedError, OSError):
                    break
        figures.append(f"estop beside 16 idle connections: {stopped} of 3")
        assert stopped == 3
        bench.wait(lambda: bench.command().cut, "the power cut", 1.0)
    finally:
        for one in idle:
            one.close()
        bench.rest(0.1)


# --- the reset leads through STARTING --------------------------------------------------------


@pytest.fixture
def starting(bench):
    """STARTING, its listening over: a required message was lost."""
    bench.vehicle.silence("PCU1_Status2")
    bench.wait(lambda: bench.mode() == "starting", "starting", 2.0)
    yield bench
    bench.vehicle.heal()


def test_a_lost_required_message_leads_back_to_starting_without_a_new_silence(starting):
    bench = starting
    since = time.monotonic()
    bench.rest(0.3)
    assert len(bench.commands(since)) >= 8
    assert {f.data for f in bench.commands(since)} == {wire.ZERO_TORQUE}
    bench.vehicle.resume("PCU1_Status2")
    bench.wait(lambda: bench.mode() == "standby", "standby", 3.0)


def test_an_emergency_stop_in_starting_and_a_reset_do_not_go_round_the_qualification(
    starting, figures
):
    """Also where no battery frame is a good one: state of charge 101 %."""
    bench = starting
    went_round = 0
    bench.vehicle.silence(BATTERY)
    bench.wait(
        lambda: time.monotonic() - bench.recorder.of(BATTERY)[-1].t > 1.7, "a stale battery", 3.0
    )
    bench.vehicle.set(BATTERY, SOC=101)
    bench.vehicle.resume(BATTERY, "PCU1_Status2")
    for _ in range(3):
        bench.client.call("estop")
        bench.wait(lambda: bench.command().cut, "the power cut", 1.0)
        bench.service_reset()
        bench.rest(0.12)
        went_round += bench.mode() != "starting"
        assert bench.client.refusal("arm") or went_round
        if bench.mode() == "active":
            bench.client.call("disarm")
    figures.append(f"estop in STARTING, then reset: the qualification avoided {went_round} of 3")
    bench.rules.may_drive = False
    assert went_round == 0
    bench.vehicle.set(BATTERY, SOC=80)
    bench.wait(lambda: bench.mode() == "standby", "standby", 3.0)


def test_a_reset_with_a_complete_qualification_is_in_standby_in_the_same_tick(bench):
    estop(bench)
    bench.rest(0.1)
    bench.service_reset()
    bench.rest(0.06)
    assert bench.mode() == "standby"


def test_a_direction_and_a_cut_stay_as_applied(bench):
    bench.drive(throttle_pct=10)
    bench.demand(throttle_pct=10, motor_reverse=True)
    bench.wait(lambda: bench.command().reverse, "reverse", 1.0)
    bench.client.call("estop")
    bench.must_be_safe_after(time.monotonic() - GRACE_S, wire.safe_frame(reverse=1, cut=1))
