"""Pedal node of the simulated vehicle: a foot drives, and each fault of the node."""

import dataclasses

import pytest

from tests.simulator.driving import Drive, drive, signals
from vcu_gateway.config import core_settings, load
from vcu_gateway.core.can_pedals import checksum_of
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.errors import ConfigError
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.pedals import Foot, PedalNode
from vcu_gateway.simulator.scenario import parse

CODEC = Codec(dbc.load(packaged("pedals.dbc")))
PEDALS = core_settings(load(packaged("pedals.yaml"))).pedals
MESSAGE = CODEC.by_name["Pedals_Position"]
PRESS = "foot: {throttle_pct: [[0, 0], [4, 0], [4.5, 43]]}"  # asks for 42.55 %
BREAKS_S = 7.0
DRIVEN_PCT = 40.0


def driven(fault: str = "", foot: str = PRESS) -> Drive:
    """Ten seconds; the foot presses at 4 s, and something breaks at 7 s."""
    step = f"steps: [{{at_s: {BREAKS_S}, {fault}}}]" if fault else ""
    scenario = parse(f"{foot}\n{step}", "a scenario", CODEC.protocol)
    return drive(CODEC, scenario, 10, None, pedals=PEDALS)


def throttle_pct(done: Drive, at_s: float) -> float:
    return signals(CODEC, done.tick_at(at_s).frames[0])["Throttle"]


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


@pytest.mark.parametrize("fault", [
    "fault: duplicate, of: PEDALS",
    "fault: drop, of: Pedals_Position, share_pct: 2, seed: 3",
    "fault: delay, of: PEDALS, delay_ms: 30",
])  # fmt: skip
def test_it_drives_on_where_frames_come_twice_late_or_not_always(fault):
    done = driven(fault)
    assert done.tick_at(9.9).mode is Mode.ACTIVE
    assert throttle_pct(done, 9.9) > DRIVEN_PCT


@pytest.mark.parametrize("fault", [
    "fault: silence, of: PEDALS",
    "fault: freeze, signal: Pedals_Position.Counter",
    "fault: set, signal: Pedals_Position.Checksum, raw: 1, for_s: 1",
    "fault: corrupt, of: PEDALS",
    "fault: shorten, of: PEDALS, length_bytes: 7",
])  # fmt: skip
def test_a_node_whose_frames_are_no_demands_ends_the_drive_until_it_is_armed_again(fault):
    done = driven(fault)
    assert throttle_pct(done, BREAKS_S) > DRIVEN_PCT
    assert throttle_pct(done, BREAKS_S + 0.25) == 0
    assert done.tick_at(9.9).mode is Mode.STANDBY


@pytest.mark.parametrize("fault", [
    "fault: set, signal: Pedals_Position.Throttle1, value: 0",
    "fault: set, signal: Pedals_Position.Throttle2, value: 5",
    "fault: set, signal: Pedals_Position.BrakePressure, raw: 1023",
    "fault: set, signal: Pedals_Position.ReverseSwitch, raw: 3",
])  # fmt: skip
def test_an_open_wire_takes_the_throttle_away_until_the_foot_is_off(fault):
    done = driven(fault)
    assert throttle_pct(done, BREAKS_S + 0.1) == 0
    assert throttle_pct(done, 9.9) == 0
    assert "pedal_signal" in alarms(done, 9.9)


@pytest.mark.parametrize(("fault", "foot"), [
    ("fault: swap, signal: Pedals_Position.Throttle1, with_signal: Pedals_Position.Throttle2",
     PRESS),
    ("fault: freeze, signal: Pedals_Position.Throttle1",
     "foot: {throttle_pct: [[0, 0], [4, 0], [4.5, 43], [8, 43], [8.1, 0]]}"),
    ("fault: freeze, signal: Pedals_Position.Throttle2",
     "foot: {throttle_pct: [[0, 0], [4, 0], [4.5, 43], [8, 43], [8.1, 0]]}"),
])  # fmt: skip
def test_tracks_that_disagree_take_the_throttle_away(fault, foot):
    done = driven(fault, foot)
    assert throttle_pct(done, BREAKS_S) > DRIVEN_PCT
    assert throttle_pct(done, 8.4) == 0
    assert throttle_pct(done, 9.9) == 0


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
