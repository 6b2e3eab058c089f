"""`vcu-gateway doctor` of a real controller, held against what `ip` says of it."""

import pytest

from tests.controller.conftest import GATEWAY, SETTING, VEHICLE, link, set_link
from tests.vcan.conftest import Stand, ip
from tests.vcan.test_doctor import examined, examined_until
from vcu_gateway.bus import netlink
from vcu_gateway.bus.netlink import ControllerMode, DeviceCounters, ErrorCounters
from vcu_gateway.core.link import LinkState


def test_what_the_kernel_is_asked_for_is_what_ip_says(bus):
    of_ip, told = link(GATEWAY), netlink.describe(GATEWAY)
    data, counted = of_ip["linkinfo"]["info_data"], of_ip["linkinfo"]["info_xstats"]
    assert told.controller is not None
    assert told.controller.errors is not None
    assert data["state"] == "ERROR-ACTIVE"
    assert told.details.state is LinkState.UP
    assert told.details.bit_rate_bit_s == data["bittiming"]["bitrate"] == 250_000
    assert told.controller.restart_ms == data["restart_ms"] == 100
    assert told.controller.modes == ControllerMode(0)
    assert told.controller.errors == ErrorCounters(
        data["berr_counter"]["tx"], data["berr_counter"]["rx"]
    )
    assert told.controller.counters == DeviceCounters(
        counted["bus_error"],
        counted["error_warning"],
        counted["error_passive"],
        counted["bus_off"],
        counted["arbitration_lost"],
        counted["restarts"],
    )
    assert told.details.driver_echoes is ("ECHO" in of_ip["flags"]) is True
    assert told.tx_queue_frames == of_ip["txqlen"] == 4
    assert (told.kind, told.discipline) == ("can", of_ip["qdisc"])


def test_what_was_sent_and_received_is_counted_as_ip_counts_it(stand: Stand):
    stand.configure("")
    vehicle = stand.vehicle()
    stand.record().wait_for(lambda frames: len(frames) > 50, "traffic")
    vehicle.stop()
    of_ip, told = link(GATEWAY)["stats64"], netlink.describe(GATEWAY).traffic
    assert told is not None
    assert told.received == of_ip["rx"]["packets"] > 50
    assert told.sent == of_ip["tx"]["packets"]
    assert netlink.describe(VEHICLE).traffic.sent == link(VEHICLE)["stats64"]["tx"]["packets"] > 50


def test_a_controller_that_is_set_as_it_should_be_is_well(stand: Stand):
    stand.configure("")
    found = examined_until(stand, "interface well")
    assert found["interface well"]["what"] == (
        "can0: up, 250 kbit/s, queue of 4, restarts after 100 ms, errors tx 0 rx 0"
    )


@pytest.mark.parametrize(
    ("setting", "check", "kind", "word"),
    [
        (("bitrate", "500000"), "bit_rate", "wrong", "500 kbit/s, bus.bit_rate_bit_s says 250"),
        (("restart-ms", "0"), "restart", "warning", "stays off for ever"),
        (("listen-only", "on"), "listen_only", "wrong", "only listens"),
        (("one-shot", "on"), "one_shot", "warning", "one-shot"),
        (("loopback", "on"), "loopback", "warning", "loopback"),
        (("presume-ack", "on"), "presume_ack", "warning", "unacknowledged"),
    ],
)
def test_a_controller_that_is_set_wrongly_is_told(
    stand: Stand, setting: tuple[str, ...], check: str, kind: str, word: str
):
    set_link(GATEWAY, *setting)
    stand.configure("")
    told = examined_until(stand, f"interface {check}")[f"interface {check}"]
    assert told["kind"] == kind
    assert word in told["what"]


def test_what_doctor_says_mends_the_bit_rate(stand: Stand):
    set_link(GATEWAY, "bitrate", "500000")
    stand.configure("")
    told = examined_until(stand, "interface bit_rate")["interface bit_rate"]
    for command in told["remedy"].split(" && "):
        ip(*command.split()[2:])  # without "sudo ip"
    assert link(GATEWAY)["linkinfo"]["info_data"]["bittiming"]["bitrate"] == 250_000
    assert "250 kbit/s" in examined_until(stand, "interface well")["interface well"]["what"]


def test_reported_bus_errors_and_a_long_queue_are_told(stand: Stand):
    set_link(GATEWAY, "berr-reporting", "on", queue_frames=10)
    stand.configure("")
    found = examined(stand)
    assert "a queue of 10 frames holds 250 ms" in found["interface queue"]["what"]
    set_link(GATEWAY, "berr-reporting", "on")
    found = examined_until(stand, "interface well")
    assert "bus errors reported" in found["interface well"]["what"]


def test_an_interface_that_is_down_is_told_with_the_command_that_sets_it_up(stand: Stand):
    ip("link", "set", GATEWAY, "down")
    stand.configure("")
    assert netlink.describe(GATEWAY).details.carrier is False
    told = examined_until(stand, "interface up")["interface up"]
    assert told["kind"] == "wrong"
    assert told["remedy"] == "sudo ip link set can0 up"
    assert SETTING[1] == str(link(GATEWAY)["linkinfo"]["info_data"]["bittiming"]["bitrate"])
