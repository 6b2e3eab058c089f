"""Other senders of our commands, and a bus that fails."""

import subprocess
import time

import pytest

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench

FOREIGN = [
    0x0008A7D0, 0x1808A7D0, 0x0008A8D0, 0x1C08A8D0, 0x0808FFD0, 0x1808FF33, 0x0008A7F0, 0x0C08A833,
]  # fmt: skip
NO_COMMANDS = [0x0809A7D0, 0x0808D0D0, 0x0808A9D0, 0x0808D033]
ERROR_CONTROLLER, ERROR_BUS_OFF, ERROR_RESTARTED = 0x04, 0x40, 0x100
PASSIVE, ACTIVE_AGAIN = 0x30, 0x40


@pytest.mark.parametrize("can_id", FOREIGN, ids=lambda can_id: f"{can_id:08X}")
def test_another_sender_of_a_command_latches_from_standby(bench, can_id):
    bench.vehicle.script((0.0, None, wire.packed(can_id, wire.intruding())))
    bench.rest(0.15)
    why = bench.why()
    assert why["mode"] == "fault", why["sentence"]
    assert why["latch"]["fault_class"] == "driver"


def test_another_sender_of_a_command_stops_the_drive(bench):
    bench.drive(throttle_pct=20)
    since = time.monotonic()
    bench.vehicle.script((0.0, None, wire.packed(0x0008A7D0, wire.intruding())))
    bench.wait(lambda: bench.recorder.intruders(since), "the intruder", 1.0)
    bench.must_be_safe_after(bench.recorder.intruders(since)[0].t, wire.ZERO_TORQUE)
    assert bench.mode() == "fault"


def test_frames_that_only_resemble_a_command_are_no_cause(bench):
    for can_id in NO_COMMANDS:
        bench.vehicle.script((0.0, None, wire.packed(can_id, wire.intruding())))
    bench.rest(0.15)
    assert bench.mode() == "standby"


def controller(bench: Bench, *states: tuple[float, int]) -> None:
    """The CAN controller's states as its driver tells them, each after so many seconds."""
    items = [(after, None, wire.error_packed(ERROR_CONTROLLER, state)) for after, state in states]
    bench.vehicle.script(*items)


@pytest.fixture
def well_again(bench):
    yield bench
    bench.vehicle.script((0.0, None, wire.error_packed(ERROR_RESTARTED)))
    controller(bench, (0.005, ACTIVE_AGAIN))
    bench.rest(0.1)


def test_bus_off_stops(well_again):
    bench = well_again

    bench.drive(throttle_pct=20)
    since = time.monotonic()
    bench.vehicle.script((0.0, None, wire.error_packed(ERROR_BUS_OFF)))
    bench.wait(lambda: bench.recorder.errors(since), "the error frame", 1.0)
    bench.rest(0.2)
    told = bench.recorder.errors(since)[0].t
    late = bench.commands(told + GRACE_S)
    assert not any(not bench.is_safe(f.command) for f in late)
    assert bench.mode() == "fault"


def test_error_passive_for_less_than_a_second_in_five_goes_on(well_again):
    bench = well_again
    bench.rest(5.0)
    bench.drive(throttle_pct=20)
    controller(bench, (0.0, PASSIVE), (0.9, ACTIVE_AGAIN))
    bench.rest(1.3)
    assert bench.mode() == "active"


def test_error_passive_that_flickers_stops_after_a_second_in_all(well_again, figures):
    bench = well_again
    bench.standby()
    bench.rest(5.0)
    bench.drive(throttle_pct=20)
    since = time.monotonic()
    states = [
        (0.95 * n + after, state)
        for n in range(4)
        for after, state in ((0, PASSIVE), (0.9, ACTIVE_AGAIN))
    ]
    controller(bench, *states)
    bench.rest(1.5)
    torque = [f.t for f in bench.commands(since) if not bench.is_safe(f.command)]
    figures.append(f"error passive for 0.9 of every 0.95 s: stops {torque[-1] - since:.2f} s after")
    assert 0.95 <= torque[-1] - since <= 1.05 + 0.075
    assert bench.mode() == "fault"
    bench.rest(2.2)


def test_an_interface_that_goes_down_stops_and_comes_back_without_torque(bench):
    bench.drive(throttle_pct=20)
    subprocess.run(["ip", "link", "set", wire.CHANNEL, "down"], check=True)
    bench.rest(0.4)
    bench.rules.begin()
    assert bench.mode() == "fault"
    subprocess.run(["ip", "link", "set", wire.CHANNEL, "up"], check=True)
    up = time.monotonic()
    bench.wait(lambda: bench.commands(up), "commands again", 5.0)
    bench.rest(0.3)
    assert {f.data for f in bench.commands(up)} == {wire.ZERO_TORQUE}
    assert bench.mode() == "fault"
