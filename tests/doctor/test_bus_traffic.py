"""Who talks on the bus: everybody at the right rate; break one thing."""

import socket
import struct
import threading
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest

from tests.doctor.judged import not_ok, only, well
from vcu_gateway.core.settings import REQUIRED_MESSAGES
from vcu_gateway.doctor import bus_traffic
from vcu_gateway.doctor.bus_traffic import ObservedTraffic, TrafficFacts, judge, listen
from vcu_gateway.doctor.check_result import Unreadable
from vcu_gateway.protocol import dbc, packaged

SPEC = dbc.load(packaged("vcu.dbc"))
SECONDS = 2.0
COMMANDS = tuple(message.can_id for message in SPEC.sent_by("VCU"))
OTHER_PRIORITY = 0x18000000


def frames(*skipped: str) -> Counter[int]:
    return Counter(
        {
            message.can_id: int(SECONDS * 1000 / (message.period_ms or 1000))
            for message in SPEC.received_by("VCU")
            if message.name not in skipped
        }
    )


SENT = Counter(dict.fromkeys(COMMANDS, 40))
HEALTHY = TrafficFacts(
    "can0", ObservedTraffic(SENT, frames(), SECONDS), SPEC, REQUIRED_MESSAGES, True
)


def results(local: Counter[int], remote: Counter[int], **changed: Any) -> list:
    return list(
        judge(HEALTHY._replace(observed=ObservedTraffic(local, remote, SECONDS), **changed))
    )


def test_a_whole_vehicle_is_one_line_with_every_rate():
    findings = list(judge(HEALTHY))
    assert not_ok(findings) == {}
    for word in ("BMS_Status 2/s", "PCU1_Status2 20/s", "IMU_Attitude 100/s", "PCU2_Command sent"):
        assert word in well(findings)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "wrong") for name in REQUIRED_MESSAGES),
        *((name, "warning") for name in ("IMU_Attitude", "BMS_Temperatures", "PCU1_Status1")),
    ],
)
def test_a_missing_message_is_wrong_where_nothing_moves_without_it(name, kind):
    found = only(results(SENT, frames(name)))
    assert (found.subject, found.check, found.kind.value) == ("bus", "missing", kind)
    assert name in found.what


def test_a_message_at_less_than_half_its_rate_is_a_warning_and_at_half_is_not():
    imu = SPEC.message("IMU_Attitude").can_id
    assert only(results(SENT, frames() + Counter({imu: -101}))).check == "slow"
    assert not_ok(results(SENT, frames() + Counter({imu: -100}))) == {}


def test_an_alias_and_another_priority_count_for_their_message():
    imu = SPEC.message("IMU_Attitude").can_id
    for one in (0x08F02DE2, imu ^ OTHER_PRIORITY):
        spec = HEALTHY.protocol
        aliased = TrafficFacts("can0", HEALTHY.observed, _with_alias(spec), REQUIRED_MESSAGES, True)
        remote = frames("IMU_Attitude") + Counter({one: 200})
        assert (
            not_ok(judge(aliased._replace(observed=ObservedTraffic(SENT, remote, SECONDS)))) == {}
        )


def _with_alias(spec):
    import dataclasses

    return dataclasses.replace(spec, aliases={0x08F02DE2: "IMU_Attitude"})


def test_a_silent_bus_is_one_wrong_line():
    found = only(results(Counter(), Counter()))
    assert (found.check, found.kind.value) == ("silent", "wrong")


def test_controllers_that_nobody_commands_need_not_answer():
    remote = frames("PCU1_Status2", "PCU2_Status2")
    assert not_ok(results(Counter(), remote, gateway_runs=False)) == {}
    assert not_ok(results(SENT, remote)) == {"missing": "wrong"}


@pytest.mark.parametrize("can_id", [COMMANDS[0], COMMANDS[1], COMMANDS[0] ^ OTHER_PRIORITY])
def test_a_command_from_another_node_is_wrong_beside_a_gateway_or_without(can_id):
    remote = frames() + Counter({can_id: 1})
    for local, runs in ((SENT, True), (Counter(), False)):
        found = only(results(local, remote, gateway_runs=runs))
        assert (found.check, found.kind.value) == ("other_sender", "wrong")
        assert "another node" in found.what


@pytest.mark.parametrize("can_id", [0x0008A755, 0x1C08A855])
def test_a_command_from_another_source_address_is_wrong_and_named(can_id):
    found = only(results(SENT, frames() + Counter({can_id: 1})))
    assert (found.check, found.kind.value) == ("other_sender", "wrong")
    assert f"({can_id:08X})" in found.what
    found = only(results(SENT + Counter({can_id: 1}), frames()))
    assert found.check == "other_sender"


def test_a_command_to_all_is_a_command_to_both_controllers():
    found = [
        one
        for one in results(SENT, frames() + Counter({0x0008FF55: 1}))
        if one.kind.value == "wrong"
    ]
    assert [one.check for one in found] == ["other_sender", "other_sender"]
    assert all("(0008FF55)" in one.what for one in found)


def test_a_second_program_of_this_machine_is_known_by_too_many_commands():
    assert not_ok(results(Counter(dict.fromkeys(COMMANDS, 60)), frames())) == {}
    found = only(results(Counter({COMMANDS[0]: 61, COMMANDS[1]: 40}), frames()))
    assert found.check == "other_sender"


def test_commands_of_this_machine_without_a_gateway_are_wrong():
    assert not_ok(results(SENT, frames(), gateway_runs=False)) == {"other_sender": "wrong"}


def test_an_interface_that_cannot_be_opened_is_unknown():
    no_socket = listen("nocan9", duration_s=0.01)
    assert isinstance(no_socket, Unreadable)
    assert only(judge(HEALTHY._replace(observed=no_socket))).kind.value == "unknown"


# Receiving, from a socket whose other end is the test's.


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    bus, node = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with bus, node:
        yield bus, node


def can_frame(can_id: int) -> bytes:
    return struct.pack("=IB3x8s", can_id, 8, bytes(8))


def test_only_data_frames_with_29_bits_are_counted(ends):
    bus, node = ends
    extended, remote_request, error = 0x8000_0000, 0x4000_0000, 0x2000_0000
    for flags in (extended, extended, extended | remote_request, error, 0):
        node.send(can_frame(flags | 0x0F4))
    observed = bus_traffic._received(bus, 0.05)
    assert observed == ObservedTraffic(Counter(), Counter({0x0F4: 2}), 0.05)


def test_a_flooded_bus_is_received_from_until_enough_is_known(ends):
    bus, node = ends
    frame = can_frame(0x8000_00F4)
    flood = threading.Thread(target=lambda: [node.send(frame) for _ in range(20_000)])
    flood.start()
    observed = bus_traffic._received(bus, 60.0)
    flood.join()
    assert observed.remote == Counter({0x0F4: 20_000})
    assert 0 < observed.duration_s < 60, "rates are those of the time that it took"
