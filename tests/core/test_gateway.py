"""The machine without a bus: what goes in, what is counted, what comes out."""

import dataclasses

import pytest

from tests.conftest import payload
from vcu_gateway.core.codec import Reason
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.gateway import Gateway, Settings
from vcu_gateway.core.state import Quality

MS = 1_000_000
PCU1_COMMAND, PCU2_COMMAND = 0x0008A7D0, 0x0008A8D0
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")


@pytest.fixture
def gateway(codec):
    return Gateway(codec, Settings())


def good_frame(codec, at_ns=0, **changes):
    frame = Frame(0x1808D0F4, payload(codec, "BMS_Status", {"SOC": 80}), at_ns)
    return dataclasses.replace(frame, **changes)


def test_a_good_frame_reaches_the_store(gateway, codec):
    gateway.receive(good_frame(codec, 5 * MS))
    reading = gateway.store.snapshot(6 * MS).reading("BMS_Status", "SOC")
    assert (reading.value, reading.quality, reading.age_ns) == (80, Quality.GOOD, MS)
    assert sum(gateway.rejected.values()) == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"error": True}, Reason.ERROR),
        ({"remote": True, "data": b""}, Reason.REMOTE),
        ({"extended": False, "can_id": 0x0F4}, Reason.STANDARD),
        ({"can_id": 0x18FECA15}, Reason.UNKNOWN),
        ({"can_id": 0x1808D0F5}, Reason.FOREIGN_SOURCE),
        ({"data": bytes(7)}, Reason.SHORT),
        ({"data": b""}, Reason.SHORT),
        ({"data": bytes(12)}, Reason.LONG),
    ],
)
def test_a_rejected_frame_is_counted_by_its_reason_and_changes_nothing(
    gateway, codec, changes, reason
):
    gateway.receive(good_frame(codec, **changes))
    assert {r: n for r, n in gateway.rejected.items() if n} == {reason: 1}
    assert gateway.store.snapshot(0).latest("BMS_Status") is None


def test_every_tick_yields_one_zero_torque_frame_for_each_controller(gateway):
    for now_ns in (0, 50 * MS, 100 * MS):
        result = gateway.tick(now_ns)
        assert [(frame.can_id, frame.data) for frame in result.frames] == [
            (PCU1_COMMAND, ZERO_TORQUE),
            (PCU2_COMMAND, ZERO_TORQUE),
        ]
        assert result.snapshot.now_ns == now_ns


def test_zero_torque_carries_the_configured_speed_limit(codec):
    gateway = Gateway(codec, Settings(speed_limit_max_rpm=3000))
    assert gateway.tick(0).frames[0].data == bytes.fromhex("0c000000b80b0000")


def test_the_transmit_priority_is_configuration(codec):
    gateway = Gateway(codec, Settings(transmit_priority=6))
    assert [frame.can_id for frame in gateway.tick(0).frames] == [0x1808A7D0, 0x1808A8D0]


def test_a_bench_demand_is_sent_within_the_configured_maxima(codec):
    demand = ControllerDemand(
        throttle_pct=100, brake_pct=10, power_mode=PowerMode.TURBO, motor_reverse=True,
        regen_brake=True, speed_limit_rpm=9000, power_limit_w=1000,
    )  # fmt: skip
    settings = Settings(bench_demand=demand, speed_limit_max_rpm=5000, power_limit_max_w=60000)
    first, second = Gateway(codec, settings).tick(0).frames
    assert first.data == second.data == bytes.fromhex("38ff1a008813e803")


def test_our_own_echo_confirms_the_sending_and_is_no_state(gateway):
    for can_id in (PCU1_COMMAND, PCU2_COMMAND, PCU2_COMMAND):
        gateway.receive(Frame(can_id, ZERO_TORQUE, 0, own_echo=True))
    assert gateway.confirmed == {"VCU_PCU1_Command": 1, "VCU_PCU2_Command": 2}
    assert sum(gateway.foreign_commands.values()) == 0


def test_a_command_of_another_sender_is_counted_whatever_its_priority(gateway):
    gateway.receive(Frame(PCU1_COMMAND, ZERO_TORQUE, 0))
    gateway.receive(Frame(PCU1_COMMAND | 6 << 26, ZERO_TORQUE, 0))
    assert gateway.foreign_commands == {"VCU_PCU1_Command": 2, "VCU_PCU2_Command": 0}
