"""The interface: a healthy can0 at 250 kbit/s; break one thing."""

import errno
from typing import Any

import pytest

from tests.doctor.judged import not_ok, only, well
from vcu_gateway.bus.netlink import (
    CanController,
    ControllerMode,
    DeviceCounters,
    ErrorCounters,
    InterfaceDetails,
    InterfaceInfo,
    InterfaceTraffic,
)
from vcu_gateway.core.link import LinkState
from vcu_gateway.doctor import interface
from vcu_gateway.doctor.check_result import Unreadable
from vcu_gateway.doctor.interface import InterfaceFacts, judge

QUIET_PAST = DeviceCounters(0, 0, 0, 0, 17, 0)
CONTROLLER = CanController(100, ControllerMode(0), ErrorCounters(0, 0), QUIET_PAST)
DETAILS = InterfaceDetails(True, True, LinkState.UP, 250_000, True)
TRAFFIC = InterfaceTraffic(9000, 800, 0, 0, 0)
CAN0 = InterfaceInfo(DETAILS, True, True, "can", "pfifo_fast", 4, CONTROLLER, TRAFFIC)
VCAN0 = InterfaceInfo(
    InterfaceDetails(False, False, None, None, True),
    True,
    True,
    "vcan",
    "noqueue",
    1000,
    None,
    TRAFFIC,
)
HEALTHY = InterfaceFacts("can0", 250_000, None, CAN0)
PERSISTENT = (
    "sudo cp /usr/share/vcu-gateway/network/can0.network"
    " /usr/share/vcu-gateway/network/10-can0.link /etc/systemd/network/"
)


def of(it: InterfaceInfo, **facts: Any) -> list:
    return list(judge(HEALTHY._replace(info=it, **facts)))


def details(**changed: Any) -> InterfaceInfo:
    return CAN0._replace(details=DETAILS._replace(**changed))


def controller(**changed: Any) -> InterfaceInfo:
    return CAN0._replace(controller=CONTROLLER._replace(**changed))


def past(**changed: int) -> InterfaceInfo:
    return controller(counters=QUIET_PAST._replace(**changed))


def test_a_healthy_interface_is_one_line():
    findings = of(CAN0)
    assert not_ok(findings) == {}
    expected = "can0: up, 250 kbit/s, queue of 4, restarts after 100 ms, errors tx 0 rx 0"
    assert well(findings) == expected


def test_a_virtual_interface_has_neither_bit_rate_nor_queue_and_that_is_well():
    findings = list(judge(InterfaceFacts("vcan0", 250_000, None, VCAN0)))
    assert not_ok(findings) == {}
    assert well(findings) == "vcan0: up, vcan, no bit rate"


@pytest.mark.parametrize(
    ("it", "check", "kind", "remedy"),
    [
        (CAN0._replace(up=False), "up", "wrong", "sudo ip link set can0 up"),
        (
            details(bit_rate_bit_s=500_000),
            "bit_rate",
            "wrong",
            "can0 down && sudo ip link set can0 up type can bitrate 250000 restart-ms 100",
        ),
        (details(bit_rate_bit_s=None), "bit_rate", "unknown", "bitrate 250000"),
        (
            CAN0._replace(tx_queue_frames=5),
            "queue",
            "warning",
            "sudo ip link set can0 txqueuelen 4",
        ),
        (
            CAN0._replace(discipline="fq_codel"),
            "discipline",
            "warning",
            "sudo tc qdisc replace dev can0 root pfifo_fast",
        ),
        (controller(restart_ms=0), "restart", "warning", "up type can restart-ms 100"),
        (controller(restart_ms=None), "restart", "unknown", ""),
        (controller(modes=None), "modes", "unknown", ""),
        (
            controller(modes=ControllerMode.LISTEN_ONLY),
            "listen_only",
            "wrong",
            "type can listen-only off",
        ),
        (controller(modes=ControllerMode.LOOPBACK), "loopback", "warning", "type can loopback off"),
        (controller(modes=ControllerMode.ONE_SHOT), "one_shot", "warning", "type can one-shot off"),
        (controller(modes=ControllerMode.PRESUME_ACK), "presume_ack", "warning", "presume-ack off"),
        (details(state=LinkState.WARNING), "state", "warning", "termination"),
        (details(state=LinkState.PASSIVE), "state", "wrong", "termination"),
        (details(state=LinkState.BUS_OFF, carrier=False), "state", "wrong", "termination"),
        (details(state=None), "state", "unknown", ""),
        (details(carrier=False), "carrier", "wrong", "wiring"),
        (details(driver_echoes=False), "echo", "warning", "driver"),
        (past(bus_offs=1), "past", "warning", "wiring"),
        (past(restarts=1), "past", "warning", "wiring"),
        (past(bus_errors=1), "past", "warning", "wiring"),
        (past(passives=1), "past", "warning", "wiring"),
        (past(warnings=1), "past", "warning", "wiring"),
        (CAN0._replace(traffic=TRAFFIC._replace(send_dropped=1)), "dropped", "warning", "ip -s"),
        (
            CAN0._replace(traffic=TRAFFIC._replace(receive_dropped=1)),
            "dropped",
            "warning",
            "ip -s",
        ),
        (CAN0._replace(traffic=TRAFFIC._replace(overruns=1)), "overruns", "warning", "ip -s"),
        (CAN0._replace(is_can=False), "is_can", "wrong", "set bus.channel"),
        (
            VCAN0._replace(details=VCAN0.details._replace(carrier=False)),
            "carrier",
            "wrong",
            "cable",
        ),
    ],
)
def test_each_fault_is_one_finding_with_the_command_that_mends_it(it, check, kind, remedy):
    found = only(of(it))
    assert (found.subject, found.check, found.kind.value) == ("interface", check, kind)
    assert remedy in found.remedy
    assert "can0" in found.what


@pytest.mark.parametrize(
    "it",
    [
        CAN0._replace(tx_queue_frames=None),
        CAN0._replace(discipline=""),
        CAN0._replace(discipline="mq"),
        CAN0._replace(traffic=None),
        controller(errors=None),
        controller(counters=None),
        controller(modes=ControllerMode.FD),
        controller(modes=ControllerMode.ERROR_REPORTING),
        details(driver_echoes=None),
        details(carrier=None),
        past(arbitrations_lost=1000),
    ],
)
def test_what_a_driver_need_not_tell_and_what_a_busy_bus_does_is_well(it):
    assert not_ok(of(it)) == {}


def test_a_queue_is_told_by_the_age_of_the_commands_in_it():
    found = only(of(CAN0._replace(tx_queue_frames=10)))
    assert found.what == "can0: a queue of 10 frames holds 250 ms of old commands"


def test_bus_off_without_a_restart_names_the_restart_by_hand():
    it = details(state=LinkState.BUS_OFF, carrier=False)
    without = it._replace(controller=CONTROLLER._replace(restart_ms=0))
    state = next(one for one in of(without) if one.check == "state")
    assert state.remedy.endswith("then sudo ip link set can0 type can restart")
    assert "type can restart" not in only(of(it)).remedy


def test_a_serial_adapter_is_never_told_to_restart_by_itself():
    off = details(state=LinkState.BUS_OFF, carrier=False)
    it = off._replace(controller=CONTROLLER._replace(restart_ms=0))
    findings = [
        *of(it, is_serial=True),
        *of(details(bit_rate_bit_s=500_000), is_serial=True),
    ]
    assert not_ok(findings) == {"restart": "warning", "state": "wrong", "bit_rate": "wrong"}
    assert not any("restart" in one.remedy for one in findings)


def test_a_controller_in_trouble_tells_its_error_counters():
    it = details(state=LinkState.PASSIVE)
    it = it._replace(controller=CONTROLLER._replace(errors=ErrorCounters(128, 3)))
    assert only(of(it)).what == "can0 is error passive (errors: tx 128, rx 3)"


def test_an_interface_that_was_never_set_up_is_set_up_by_one_command():
    it = CAN0._replace(
        up=False,
        discipline="noop",
        details=DETAILS._replace(bit_rate_bit_s=None, state=None, carrier=False),
    )
    findings = of(it)
    assert not_ok(findings) == {"up": "wrong"}
    command = "sudo ip link set can0 up type can bitrate 250000 restart-ms 100"
    assert only(findings).remedy == command
    assert only(of(it, persistent=PERSISTENT)).remedy == PERSISTENT
    assert only(of(it, is_serial=True)).remedy == command.removesuffix(" restart-ms 100")


def test_where_networkd_runs_the_shipped_files_mend_bit_rate_and_restart():
    for it in (details(bit_rate_bit_s=500_000), controller(restart_ms=0)):
        assert only(of(it, persistent=PERSISTENT)).remedy == PERSISTENT
    assert (
        "listen-only off"
        in only(of(controller(modes=ControllerMode.LISTEN_ONLY), persistent=PERSISTENT)).remedy
    )


@pytest.mark.parametrize(
    ("channel", "others", "remedy"),
    [
        ("can0", (), "plug the adapter in, or load its driver: sudo dmesg | grep -i can"),
        ("can0", ("can1", "can2"), "set bus.channel to can1 or can2, or plug can0 in"),
        ("vcan3", (), "sudo ip link add dev vcan3 type vcan && sudo ip link set vcan3 up"),
    ],
)
def test_a_missing_interface_is_wrong_and_says_what_there_is_instead(channel, others, remedy):
    found = only(judge(InterfaceFacts(channel, 250_000, others=others)))
    assert (found.check, found.kind.value) == ("exists", "wrong")
    assert found.remedy == remedy


def test_a_kernel_without_can_is_one_line_not_two():
    found = only(judge(InterfaceFacts("can0", 250_000, kernel=errno.EAFNOSUPPORT)))
    assert (found.check, found.kind.value) == ("sockets", "wrong")
    assert "vcu-gateway demo" in found.remedy


def test_a_process_that_may_not_open_can_sockets_is_told_so():
    found = only(judge(HEALTHY._replace(kernel=errno.EPERM)))
    assert found.what == "this process may not open CAN sockets"


def test_a_kernel_that_does_not_tell_is_unknown_with_the_reason():
    found = only(judge(HEALTHY._replace(info=Unreadable("rtnetlink: timed out"))))
    assert (found.check, found.kind.value) == ("exists", "unknown")
    assert "timed out" in found.what


def test_this_machines_loopback_is_read_and_no_can_interface():
    facts = interface.read("lo", 250_000)._replace(kernel=None)
    assert only(judge(facts)).check == "is_can"


def test_an_interface_that_is_not_there_is_read_as_none():
    assert interface.read("nocan9", 250_000).info is None


def test_what_is_down_and_set_up_is_only_taken_up():
    command = "sudo ip link set can0 up"
    assert only(of(CAN0._replace(up=False))).remedy == command
    assert only(of(VCAN0._replace(up=False))).remedy == command


def test_a_wrong_bit_rate_is_told_while_the_interface_is_down_too():
    found = not_ok(of(details(bit_rate_bit_s=500_000)._replace(up=False)))
    assert found == {"up": "wrong", "bit_rate": "wrong"}


def test_modes_that_do_no_harm_stand_in_the_line():
    assert "CAN FD on" in well(of(controller(modes=ControllerMode.FD)))
    assert "bus errors reported" in well(of(controller(modes=ControllerMode.ERROR_REPORTING)))


def test_a_driver_without_error_counters_tells_its_state_alone():
    it = details(state=LinkState.PASSIVE)
    it = it._replace(controller=CONTROLLER._replace(errors=None))
    assert only(of(it)).what == "can0 is error passive"


def test_any_restart_is_well():
    assert "restarts after 1 ms" in well(of(controller(restart_ms=1)))


def test_a_forbidden_family_is_told_by_either_error():
    for number in (errno.EPERM, errno.EACCES):
        assert "may not open" in only(judge(HEALTHY._replace(kernel=number))).what


def test_without_another_can_interface_any_one_is_asked_for():
    assert only(of(CAN0._replace(is_can=False))).remedy == "set bus.channel to a CAN interface"


def test_an_interface_of_no_known_kind_is_called_virtual():
    assert well(of(VCAN0._replace(kind=""))) == "can0: up, virtual, no bit rate"
