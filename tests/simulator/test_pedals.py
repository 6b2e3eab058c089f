"""Pedal node of the simulated vehicle: a foot drives.

What the gateway does about each fault of it: tests/faults/pure/test_pedals.py.
"""

import dataclasses

import pytest

from tests.simulator.driving import Drive, signals
from tests.simulator.pedals import BREAKS_S, CODEC, DRIVEN_PCT, PEDALS, PRESS, driven, throttle_pct
from vcu_gateway.core.can_pedals import checksum_of
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.errors import ConfigError
from vcu_gateway.simulator.pedals import Foot, PedalNode
from vcu_gateway.simulator.scenario import parse

MESSAGE = CODEC.by_name["Pedals_Position"]


def alarms(done: Drive, at_s: float) -> list[str]:
    why = done.tick_at(at_s).why
    return [one.finding.key[0] for one in (*why.alarms, *why.blocks)]


def test_the_foot_presses_and_the_vehicle_goes():
    done = driven()
    assert throttle_pct(done, 3.9) == 0
    assert throttle_pct(done, 6) > DRIVEN_PCT
    assert done.tick_at(9.9).mode is Mode.ACTIVE
    assert not alarms(done, 9.9)


def test_the_foot_lets_go_and_brakes():
    foot = "foot: {throttle_pct: [[0, 0], [4, 0], [5, 60], [7, 60], [7.1, 0]],"
    done = driven(foot=foot + " brake_pct: [[7.2, 0], [7.5, 50]]}")
    assert throttle_pct(done, 6.9) > DRIVEN_PCT
    assert throttle_pct(done, 7.3) == 0
    assert signals(CODEC, done.tick_at(9).frames[0])["Brake"] > 0


def test_frames_of_it_that_are_too_short_end_the_drive():
    done = driven("fault: shorten, of: PEDALS, length_bytes: 7")
    assert throttle_pct(done, BREAKS_S) > DRIVEN_PCT
    assert throttle_pct(done, BREAKS_S + 0.15) == 0
    assert done.tick_at(9.9).mode is Mode.STANDBY


@pytest.mark.parametrize("kind", ["xor", "sum", "sae_j1850"])
def test_its_frames_count_and_carry_the_checksum(kind):
    pedals = dataclasses.replace(PEDALS, checksum=dataclasses.replace(PEDALS.checksum, kind=kind))
    node = PedalNode(pedals, MESSAGE, Foot())
    counts = []
    for count in range(16):
        data = node.seal(MESSAGE.encode(node.values(0.0, count)))
        assert data[7] == checksum_of(data[:7], kind)
        counts.append(data[6])
    assert counts == [*range(16)]


def test_a_broken_signal_is_what_the_node_reads_and_so_its_checksum_holds():
    done = driven("fault: set, signal: Pedals_Position.Throttle1, raw: 0")
    _, frame = done.heard_of("Pedals_Position", BREAKS_S)[0]
    assert frame.data[:1] == b"\0"
    assert frame.data[7] == checksum_of(frame.data[:7], "sae_j1850")


@pytest.mark.parametrize(("foot", "text"), [
    ("{throttle_pct: [[0, 0]]}", "must have two points or more"),
    ("{throttle_pct: [[0, 0], [1]]}", "must be [seconds, %]"),
    ("{throttle_pct: [[1, 0], [1, 5]]}", "must be later than the point before"),
    ("{brake_pct: [[0, 0], [1, 101]]}", "must be a time from 0 on and 0 to 100 %"),
    ("{clutch_pct: [[0, 0], [1, 1]]}", "clutch_pct"),
])  # fmt: skip
def test_a_wrong_foot_is_refused(foot, text):
    with pytest.raises(ConfigError) as caught:
        parse(f"foot: {foot}", "a scenario", CODEC.protocol)
    assert text in str(caught.value)


def test_a_foot_without_pedals_is_refused():
    scenario = parse(PRESS, "press.yaml", CODEC.protocol)
    scenario.check_pedals(True, "press.yaml")
    with pytest.raises(ConfigError, match=r"press\.yaml: foot needs the pedals of pedals\.can"):
        scenario.check_pedals(False, "press.yaml")


@pytest.mark.parametrize("other", ["BMS_Status.SOC", "Pedals_Position.Throttle1",
                                   "Pedals_Position.Counter"])  # fmt: skip
def test_only_two_signals_of_one_message_and_width_are_swapped(other):
    step = f"{{at_s: 1, fault: swap, signal: Pedals_Position.Throttle1, with_signal: {other}}}"
    with pytest.raises(ConfigError, match="must"):
        parse(f"steps: [{step}]", "a scenario", CODEC.protocol)
