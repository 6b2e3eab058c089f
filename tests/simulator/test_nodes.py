"""Who sends which frame when, and that every frame is what the protocol says."""

import dataclasses
import itertools
import random
import runpy
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vcu_gateway import simulator
from vcu_gateway.core import j1939
from vcu_gateway.core.codec import Codec, Decoded
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.faults import Fault, FaultInterval
from vcu_gateway.simulator.nodes import ANSWER_DELAY_NS, NodeFrame, Nodes, sources
from vcu_gateway.simulator.vehicle import LEFT, RIGHT, Vehicle

MS_NS = 1_000_000
S_NS = 1_000_000_000
START_NS = 12_345_678_901
LOGS = Path(__file__).parents[1] / "logs"
CODEC = Codec(dbc.load(packaged("vcu.dbc")))
SPOKEN = [message for message in CODEC.protocol.messages if message.sender != "VCU"]
CYCLIC = [message for message in SPOKEN if not message.name.endswith("_Status2")]
MODELLED = [one for one in SPOKEN if one.name in sources(Vehicle(0), random.Random(0))]
FULL: dict[str, float] = {
    "PowerMode": 2,
    "Throttle": 99.45,
    "SpeedLimit": 12000,
    "PowerLimit": 60000,
}


def command(controller: str, values: dict[str, float]) -> tuple[int, bytes]:
    message = CODEC.by_name[f"VCU_{controller}_Command"]
    return message.spec.can_id, message.encode(values)


def run(nodes: Nodes, until_ns: int) -> list[NodeFrame]:
    """Every frame up to then, asked for exactly when it is due."""
    frames = []
    while nodes.next_due_ns() <= until_ns:
        frames += nodes.due(nodes.next_due_ns())
    return frames


def commanded(
    nodes: Nodes, seconds: float, values: dict[str, float], start_ns: int = START_NS
) -> list[NodeFrame]:
    """As `run`, with both controllers commanded every 50 ms."""
    frames = []
    for now_ns in range(start_ns, start_ns + round(seconds * S_NS), 50 * MS_NS):
        frames += run(nodes, now_ns)
        for controller in (LEFT, RIGHT):
            nodes.receive(*command(controller, values), now_ns)
    return frames


def decoded(frame: NodeFrame) -> Decoded:
    found = CODEC.find(Frame(frame.can_id, frame.data, frame.due_ns))
    assert found is CODEC.by_name[frame.message]
    return found.decode(frame.data)


def signal(frame: NodeFrame, name: str) -> float:
    spec = CODEC.by_name[frame.message].spec
    return decoded(frame).values[spec.signal_names.index(name)]


def of(frames: Iterable[NodeFrame], message: str) -> list[NodeFrame]:
    return [frame for frame in frames if frame.message == message]


def test_every_period_is_exactly_the_protocols_over_ten_seconds() -> None:
    times_ns = defaultdict(list)
    for frame in run(simulator.build(CODEC, START_NS), START_NS + 10 * S_NS - 1):
        times_ns[frame.message].append(frame.due_ns)
    assert set(times_ns) == {message.name for message in CYCLIC}
    for message in CYCLIC:
        intervals_ns = {b - a for a, b in itertools.pairwise(times_ns[message.name])}
        assert intervals_ns == {message.period_ms * MS_NS}
        assert len(times_ns[message.name]) == 10_000 // message.period_ms


def test_no_two_cyclic_frames_ever_leave_in_the_same_millisecond() -> None:
    frames = run(simulator.build(CODEC, START_NS), START_NS + 2 * S_NS)
    gaps_ns = [b.due_ns - a.due_ns for a, b in itertools.pairwise(frames)]
    assert min(gaps_ns) >= MS_NS


def test_the_life_signal_toggles_on_every_frame() -> None:
    frames = of(run(simulator.build(CODEC, START_NS), START_NS + 10 * S_NS), "BMS_Status")
    assert [signal(frame, "LifeSignal") for frame in frames[:4]] == [0, 1, 0, 1]
    assert all(
        signal(a, "LifeSignal") != signal(b, "LifeSignal") for a, b in itertools.pairwise(frames)
    )


def test_status2_is_silent_without_a_command() -> None:
    frames = run(simulator.build(CODEC, START_NS), START_NS + 10 * S_NS)
    assert not [frame for frame in frames if frame.message.endswith("_Status2")]


@pytest.mark.parametrize("controller", [LEFT, RIGHT])
def test_each_command_is_answered_once_by_its_controller_a_millisecond_later(
    controller: str,
) -> None:
    nodes = simulator.build(CODEC, START_NS)
    at_ns = [START_NS + offset_ms * MS_NS for offset_ms in (0, 50, 100, 117)]
    frames = []
    for now_ns in at_ns:
        frames += run(nodes, now_ns)
        assert nodes.receive(*command(controller, FULL), now_ns) == f"VCU_{controller}_Command"
    frames += run(nodes, START_NS + S_NS)
    answers = [frame for frame in frames if frame.message.endswith("_Status2")]
    assert {frame.message for frame in answers} == {f"{controller}_Status2"}
    assert [frame.due_ns for frame in answers] == [now_ns + ANSWER_DELAY_NS for now_ns in at_ns]


def test_a_command_is_obeyed_at_any_priority() -> None:
    nodes = simulator.build(CODEC, START_NS)
    can_id, data = command(LEFT, FULL)
    assert nodes.receive(j1939.with_priority(can_id, 6), data, START_NS) == "VCU_PCU1_Command"


@pytest.mark.parametrize("message", [message.name for message in SPOKEN])
def test_other_frames_are_no_commands(message: str) -> None:
    nodes = simulator.build(CODEC, START_NS)
    assert nodes.receive(CODEC.by_name[message].spec.can_id, bytes(8), START_NS) is None


@pytest.mark.parametrize("data", [b"", bytes(7), bytes(9)])
def test_a_command_of_another_length_is_not_obeyed_or_answered(data: bytes) -> None:
    nodes = simulator.build(CODEC, START_NS)
    can_id, _ = command(LEFT, FULL)
    assert nodes.receive(can_id, data, START_NS) is None
    assert not of(run(nodes, START_NS + S_NS), "PCU1_Status2")


def test_missed_grid_points_are_skipped_and_not_made_up() -> None:
    nodes = simulator.build(CODEC, START_NS)
    run(nodes, START_NS + S_NS)
    late = nodes.due(START_NS + 4 * S_NS)
    assert max(Counter(frame.message for frame in late).values()) == 1
    after = of(run(nodes, START_NS + 5 * S_NS), "IMU_Acceleration")
    assert {(frame.due_ns - START_NS) % (10 * MS_NS) for frame in after} == {3 * MS_NS}


def test_status1_echoes_what_the_controller_obeys() -> None:
    nodes = simulator.build(CODEC, START_NS)
    values = FULL | {"PowerMode": 1, "Throttle": 39.0, "Brake": 7.8, "RegenBrake": 1}
    last = of(commanded(nodes, 1.1, values), "PCU2_Status1")[-1]
    echoed = {name: signal(last, name) for name in ("PowerMode", "Throttle", "Brake", "RegenBrake")}
    assert echoed == pytest.approx({name: values[name] for name in echoed})
    assert (signal(last, "VoltageLevel"), signal(last, "CurrentLevel")) == (3, 1)


def test_a_silent_gateway_shows_in_status1_as_safety_mode_and_no_throttle() -> None:
    nodes = simulator.build(CODEC, START_NS)
    commanded(nodes, 1, FULL)
    last = of(run(nodes, START_NS + 3 * S_NS), "PCU1_Status1")[-1]
    assert (signal(last, "PowerMode"), signal(last, "Throttle")) == (3, 0)


def test_full_throttle_shows_on_every_node() -> None:
    frames = commanded(simulator.build(CODEC, START_NS), 3, FULL)
    last = {frame.message: frame for frame in frames}
    assert signal(last["PCU1_Status2"], "MotorSpeed") > 3000
    assert signal(last["PCU1_Status2"], "BatteryCurrent") > 50
    assert signal(last["PCU2_Status2"], "PhaseCurrent") > 50
    assert signal(last["ARD2_SteeringWheel"], "WheelSpeedFL") > 30
    assert signal(last["ARD2_SteeringWheel"], "WheelSpeedFR") > 30
    assert signal(last["IMU_Acceleration"], "AccelerationX") > 2
    assert signal(last["IMU_Acceleration"], "AccelerationZ") == pytest.approx(9.81, abs=0.2)
    assert signal(last["BMS_Status"], "BatteryState") == 2
    assert signal(last["BMS_Status"], "PackVoltage") < 78


def test_regeneration_shows_as_negative_current() -> None:
    nodes = simulator.build(CODEC, START_NS)
    commanded(nodes, 3, FULL)
    braking: dict[str, float] = {"PowerMode": 1, "Brake": 10, "RegenBrake": 1}
    frames = commanded(nodes, 1, braking, START_NS + 3 * S_NS)
    assert signal(of(frames, "PCU1_Status2")[-1], "BatteryCurrent") < -1
    assert signal(of(frames, "PCU1_Status2")[-1], "PhaseCurrent") < -1


def test_every_frame_of_an_eventful_drive_decodes_with_all_signals_good() -> None:
    nodes = simulator.build(CODEC, START_NS, soc_pct=20, battery_speedup=50)
    script: list[dict[str, float]] = [
        FULL,
        FULL | {"MotorReverse": 1},
        FULL | {"Brake": 50, "RegenBrake": 1},
        FULL | {"SpeedLimit": 65535, "PowerLimit": 65535},
        {"PowerCut": 1},
        FULL,
    ]
    seen = set()
    for index, values in enumerate(script):
        for frame in commanded(nodes, 3, values, START_NS + index * 3 * S_NS):
            seen.add(frame.message)
            assert decoded(frame).marks == 0, frame
    assert seen == {message.name for message in SPOKEN}


@pytest.mark.ci
@given(
    st.lists(
        st.tuples(
            st.sampled_from([LEFT, RIGHT]),
            st.binary(min_size=8, max_size=8),
            st.integers(min_value=0, max_value=2000),
        ),
        max_size=8,
    )
)
@settings(max_examples=60, deadline=None)
def test_no_command_payload_drives_any_signal_out_of_range(
    commands: list[tuple[str, bytes, int]],
) -> None:
    nodes = simulator.build(CODEC, START_NS, battery_speedup=100)
    now_ns = START_NS
    for controller, data, wait_ms in commands:
        nodes.receive(command(controller, {})[0], data, now_ns)
        now_ns += wait_ms * MS_NS
        for frame in run(nodes, now_ns):
            assert decoded(frame).marks == 0, frame


@pytest.mark.parametrize("message", MODELLED, ids=lambda message: message.name)
def test_the_values_before_encoding_name_every_signal_and_lie_in_its_range(message) -> None:
    vehicle = Vehicle(0)
    for now_ns in range(0, 8 * S_NS, 50 * MS_NS):
        for controller in (LEFT, RIGHT):
            vehicle.command(controller, FULL | {"PowerCut": 0}, now_ns)
        vehicle.advance(now_ns)
    assert vehicle.speed_m_s > 16
    values = sources(vehicle, random.Random(0))[message.name](1)
    assert list(values) == list(message.signal_names)
    for spec in message.signals:
        assert spec.minimum <= values[spec.name] <= spec.maximum


def test_a_message_that_the_vehicle_does_not_model_is_sent_with_values_nearest_to_0() -> None:
    stranger = dataclasses.replace(CYCLIC[0], name="ARD2_Pedals", can_id=0x040B_D092)
    protocol = dataclasses.replace(CODEC.protocol, messages=(*CODEC.protocol.messages, stranger))
    sent = run(simulator.build(Codec(protocol), START_NS), START_NS + S_NS)
    found = [frame.data for frame in sent if frame.message == "ARD2_Pedals"]
    assert found == [(30_000).to_bytes(2, "little") + bytes(6)] * 10


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    first, same, other = (
        [frame.data for frame in run(simulator.build(CODEC, 0, seed=seed), S_NS)]
        for seed in (1, 1, 2)
    )
    assert first == same
    assert first != other


def test_a_transform_can_lose_change_double_and_delay_frames() -> None:
    def lose_imu(frame: NodeFrame) -> list[NodeFrame]:
        return [] if frame.message.startswith("IMU") else [frame]

    def freeze_life(frame: NodeFrame) -> list[NodeFrame]:
        if frame.message != "BMS_Status":
            return [frame]
        return [frame._replace(data=frame.data[:7] + bytes([frame.data[7] & 0x7F]))]

    def double_late(frame: NodeFrame) -> list[NodeFrame]:
        if frame.message != "ARD2_SteeringWheel":
            return [frame]
        return [frame, frame._replace(due_ns=frame.due_ns + 30 * MS_NS)]

    faults = [
        FaultInterval("test", Fault(one), START_NS, None, lambda _: None)
        for one in (lose_imu, freeze_life, double_late)
    ]
    nodes = simulator.build(CODEC, START_NS, faults=faults)
    frames = run(nodes, START_NS + S_NS - 1)
    assert not [frame for frame in frames if frame.message.startswith("IMU")]
    assert {signal(frame, "LifeSignal") for frame in of(frames, "BMS_Status")} == {0}
    offsets_ms = [(f.due_ns - START_NS) // MS_NS for f in of(frames, "ARD2_SteeringWheel")]
    assert offsets_ms[:4] == [0, 30, 100, 130]


@pytest.fixture(scope="module")
def made_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recordings, made anew."""
    directory = tmp_path_factory.mktemp("logs")
    runpy.run_path(str(LOGS / "make.py"))["make"](directory)
    return directory


@pytest.mark.parametrize("name", ["nominal.log", "drive.log", "nominal.expected.json"])
def test_the_recordings_come_out_again_byte_for_byte(name: str, made_logs: Path) -> None:
    """Where this fails after a wanted change: python tests/logs/make.py."""
    assert (made_logs / name).read_bytes() == (LOGS / name).read_bytes()
