"""Each fault does one thing, to what it names, while it lasts."""

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vcu_gateway import simulator
from vcu_gateway.core.codec import Codec
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.faults import NEVER_NS, Fault, FaultInterval, ForeignNode
from vcu_gateway.simulator.nodes import NodeFrame, Nodes
from vcu_gateway.simulator.scenario import FAULTS, PROTOCOL
from vcu_gateway.simulator.vehicle import LEFT, RIGHT

CODEC = Codec(dbc.load(packaged("vcu.dbc")))
MS_NS = 1_000_000
S_NS = 1_000_000_000
START_NS = 77 * S_NS
FRAME = NodeFrame(0x1808D0F4, bytes(range(8)), "BMS_Status", START_NS)
ORDERED = {"PowerMode": 1, "Throttle": 50, "SpeedLimit": 12_000, "PowerLimit": 60_000}
SIGNALS = [
    (message.name, signal)
    for message in CODEC.protocol.messages
    for signal in message.signals
    if message.sender != "VCU"
]


def broken(name: str, **given: Any) -> Fault:
    """The fault of a scenario's step."""
    step = {"at_s": 0, "fault": name, **given}
    return FAULTS[name].model_validate(step, context={PROTOCOL: CODEC.protocol}).broken(CODEC)


def spell(fault: Fault, begin_s: float = 0.0, end_s: float | None = None) -> FaultInterval:
    end_ns = None if end_s is None else START_NS + round(end_s * S_NS)
    return FaultInterval("fault", fault, START_NS + round(begin_s * S_NS), end_ns, lambda _: None)


def drive(nodes: Nodes, seconds: float, **order: float) -> list[NodeFrame]:
    """Every frame, with both controllers commanded every 50 ms."""
    frames = []
    for now_ns in range(START_NS, START_NS + round(seconds * S_NS), 50 * MS_NS):
        while nodes.next_due_ns() <= now_ns:
            frames += nodes.due(nodes.next_due_ns())
        for name in (LEFT, RIGHT):
            command = CODEC.by_name[f"VCU_{name}_Command"]
            nodes.receive(command.spec.can_id, command.encode({**ORDERED, **order}), now_ns)
    return frames


def says(frame: NodeFrame, signal: str) -> float:
    codec = CODEC.by_name[frame.message]
    return codec.decode(frame.data).values[codec.spec.signal_names.index(signal)]


def test_frames_are_lost_doubled_delayed_and_shortened():
    delayed, shortened = broken("delay", delay_ms=3), broken("shorten", length_bytes=5)
    assert list(Fault().transform(FRAME)) == [FRAME]
    assert list(broken("silence", of="BMS").transform(FRAME)) == []
    assert list(broken("duplicate").transform(FRAME)) == [FRAME, FRAME]
    assert list(delayed.transform(FRAME)) == [FRAME._replace(due_ns=START_NS + 3 * MS_NS)]
    assert list(shortened.transform(FRAME)) == [FRAME._replace(data=bytes(range(5)))]


@given(data=st.binary(max_size=8), flips=st.integers(1, 64), seed=st.integers())
def test_corruption_flips_exactly_so_many_bits_and_repeats_with_its_seed(data, flips, seed):
    frame = FRAME._replace(data=data)
    (found,) = broken("corrupt", flip_bits=flips, seed=seed).transform(frame)
    wrong = int.from_bytes(found.data, "little") ^ int.from_bytes(data, "little")
    assert len(found.data) == len(data)
    assert wrong.bit_count() == min(flips, 8 * len(data))
    assert list(broken("corrupt", flip_bits=flips, seed=seed).transform(frame)) == [found]


@pytest.mark.parametrize(("message", "signal"), SIGNALS)
def test_a_signal_is_overridden_with_any_code_and_no_other_changes(message, signal):
    codec = CODEC.by_name[message]
    index = codec.spec.signal_names.index(signal.name)
    dice = random.Random(signal.name)
    for raw in (signal.raw_lowest, signal.raw_highest, dice.randrange(0, signal.raw_highest + 1)):
        data = dice.randbytes(8)
        set_to = broken("set", signal=f"{message}.{signal.name}", raw=raw)
        (found,) = set_to.transform(FRAME._replace(data=data, message=message))
        raws = list(codec.decode(data).raws)
        raws[index] = raw
        assert list(codec.decode(found.data).raws) == raws


def test_a_signal_of_a_short_frame_is_overridden_as_far_as_it_is_there():
    set_to = broken("set", signal="BMS_Status.LifeSignal", raw=1)
    (found,) = set_to.transform(FRAME._replace(data=b"\0\0\0"))
    assert found.data == b"\0\0\0"


@pytest.mark.parametrize(("message", "signal"), SIGNALS)
def test_a_signal_is_shifted_as_far_as_its_bits_go_and_no_other_changes(message, signal):
    codec = CODEC.by_name[message]
    index = codec.spec.signal_names.index(signal.name)
    data = random.Random(signal.name).randbytes(8)
    before = codec.decode(data).raws[index]
    most = (1 << signal.length_bits) - 1
    for by in (1, -1, most, -most):
        shifted = broken("shift", signal=f"{message}.{signal.name}", by=by * signal.factor)
        (found,) = shifted.transform(FRAME._replace(data=data, message=message))
        raws = list(codec.decode(data).raws)
        raws[index] = max(signal.raw_lowest, min(signal.raw_highest, before + by))
        assert list(codec.decode(found.data).raws) == raws


def test_a_frozen_signal_keeps_its_first_code():
    frozen = broken("freeze", signal="BMS_Status.LifeSignal").transform
    found = [
        next(iter(frozen(FRAME._replace(data=bytes(7) + bytes([byte]))))).data[7]
        for byte in (0x81, 0x02, 0x83)
    ]
    assert found == [0x81, 0x82, 0x83]


def test_only_the_named_messages_are_met():
    transform = broken("silence", of="BMS_Status").transform
    assert list(transform(FRAME)) == []
    other = FRAME._replace(message="IMU_Attitude")
    assert list(transform(other)) == [other]


@pytest.mark.parametrize("share_pct", [0, 30, 100])
def test_a_share_of_the_frames_is_met_and_the_same_ones_for_the_same_seed(share_pct):
    def met(seed: int) -> list[bool]:
        transform = broken("drop", share_pct=share_pct, seed=seed).transform
        return [not list(transform(FRAME)) for _ in range(2000)]

    assert sum(met(1)) / 20 == pytest.approx(share_pct, abs=3)
    assert met(1) == met(1)
    assert (met(1) == met(2)) is (share_pct in (0, 100))


def test_a_spell_lasts_from_its_begin_until_just_before_its_end():
    lasting = spell(broken("silence", of="BMS"), 1, 2)
    found = [
        bool(list(lasting.transform(FRAME._replace(due_ns=START_NS + at_ns))))
        for at_ns in (S_NS - 1, S_NS, 2 * S_NS - 1, 2 * S_NS)
    ]
    assert found == [True, False, False, True]


def test_a_spell_wakes_the_nodes_when_it_begins_and_ends_and_never_again():
    lasting = spell(Fault(), 0.0015, 0.0025)
    nodes = simulator.build(CODEC, START_NS, faults=[lasting])
    for _ in range(10):
        nodes.due(nodes.next_due_ns())
    assert lasting.next_due_ns() == NEVER_NS
    assert spell(Fault(), 3).next_due_ns() == START_NS + 3 * S_NS


def test_a_controller_that_ignores_commands_keeps_torque_and_echo_without_a_time_out():
    ignoring = spell(broken("ignore_commands", controller=LEFT), 1, 3)
    nodes = simulator.build(CODEC, START_NS, faults=[ignoring])
    drive(nodes, 1)
    nodes.vehicle.advance(START_NS + S_NS)
    nodes.due(START_NS + 2 * S_NS)  # a second without any command
    left, right = nodes.vehicle.motors[LEFT], nodes.vehicle.motors[RIGHT]
    assert left.order.throttle_pct == pytest.approx(50, abs=0.2)
    assert left.torque_nm > 1
    assert (right.order.throttle_pct, right.torque_nm) == (0, 0)
    nodes.due(START_NS + 4 * S_NS)
    assert left.torque_nm == 0, "mended, it times out as ever"


def test_a_controller_that_runs_away_echoes_a_throttle_of_its_own():
    runaway = spell(broken("ignore_commands", controller=LEFT, throttle_pct=90.0), 0.5)
    frames = drive(simulator.build(CODEC, START_NS, faults=[runaway]), 1.2)
    echoes = [says(frame, "Throttle") for frame in frames if frame.message == "PCU1_Status1"]
    assert echoes[-1] == pytest.approx(90, abs=0.2)


def test_both_controllers_turned_round_drive_the_vehicle_backwards():
    turned = spell(broken("wrong_direction"), 0, 2)
    nodes = simulator.build(CODEC, START_NS, faults=[turned])
    frames = drive(nodes, 2)
    assert nodes.vehicle.speed_m_s < -1
    assert says([f for f in frames if f.message == "PCU1_Status1"][-1], "MotorReverse") == 1
    nodes = simulator.build(CODEC, START_NS)
    drive(nodes, 2)
    assert nodes.vehicle.speed_m_s > 1


def test_a_speed_below_0_reads_as_one_that_no_motor_has():
    negated = broken("wrong_direction", controller=LEFT).transform
    codec = CODEC.by_name["PCU1_Status2"]
    for rpm, expected in ((0, 0), (1, 65_535), (3000, 62_536)):
        frame = NodeFrame(0x0809D0A7, codec.encode({"MotorSpeed": rpm}), "PCU1_Status2", START_NS)
        (found,) = negated(frame)
        assert says(found, "MotorSpeed") == expected


def test_a_foreign_node_sends_at_its_period_and_is_obeyed_and_answered():
    command = CODEC.by_name["VCU_PCU2_Command"]
    data = command.encode({**ORDERED, "Throttle": 80})
    node = ForeignNode(command.spec.can_id, data, "VCU_PCU2_Command", 20 * MS_NS)
    nodes = simulator.build(CODEC, START_NS, faults=[spell(Fault(foreign_node=node), 0.1, 0.5)])
    frames = []
    while nodes.next_due_ns() < START_NS + S_NS:
        frames += nodes.due(nodes.next_due_ns())
    times_ms = [
        (frame.due_ns - START_NS) // MS_NS for frame in frames if frame.message == node.message
    ]
    assert times_ms == list(range(100, 500, 20))
    answers = [frame for frame in frames if frame.message == "PCU2_Status2"]
    assert len(answers) == len(times_ms)
    assert not [frame for frame in frames if frame.message == "PCU1_Status2"]
    assert nodes.vehicle.speed_m_s > 0


def test_without_faults_the_nodes_send_what_they_ever_sent():
    plain, whole = (
        drive(simulator.build(CODEC, START_NS, faults=given), 1)
        for given in ((), [spell(Fault(), 0.2, 0.4)])
    )
    assert plain == whole
