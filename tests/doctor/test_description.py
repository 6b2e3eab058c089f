"""The kernel's whole answer to RTM_GETLINK: include/uapi/linux/can/netlink.h, if_link.h."""

import errno
import struct

import pytest

from tests.bus.test_interface import answer, attribute
from vcu_gateway.bus import netlink
from vcu_gateway.bus.netlink import (
    CanController,
    ControllerMode,
    DeviceCounters,
    ErrorCounters,
    InterfaceDetails,
    InterfaceInfo,
    InterfaceTraffic,
    described,
)
from vcu_gateway.core.link import LinkState

TIMING = attribute(1, struct.pack("=8I", 250_000, 875, 0, 0, 0, 0, 0, 0))
DATA = (
    TIMING,
    attribute(4, struct.pack("=I", 2)),
    attribute(5, struct.pack("=2I", 0xFF, 0x02 | 0x20)),
    attribute(6, struct.pack("=I", 100)),
    attribute(8, struct.pack("=2H", 128, 3)),
)
COUNTERS = attribute(3, struct.pack("=6I", 1, 2, 3, 4, 5, 6))
STATISTICS = attribute(23, struct.pack("=24Q", *range(100, 124)))


def whole(*data: bytes) -> bytes:
    info = attribute(18, attribute(1, b"can\0") + attribute(2, b"".join(data)) + COUNTERS)
    queue = attribute(6, b"pfifo_fast\0") + attribute(13, struct.pack("=I", 10))
    return answer(0x40000 | 0x10000 | 0x41, queue, STATISTICS, info)


def test_a_controller_tells_everything():
    assert described(whole(*DATA)) == InterfaceInfo(
        details=InterfaceDetails(True, True, LinkState.PASSIVE, 250_000, True),
        up=True,
        is_can=True,
        kind="can",
        discipline="pfifo_fast",
        tx_queue_frames=10,
        controller=CanController(
            100,
            ControllerMode.LISTEN_ONLY | ControllerMode.FD,
            ErrorCounters(transmit=128, receive=3),
            DeviceCounters(1, 2, 3, 4, 5, 6),
        ),
        traffic=InterfaceTraffic(
            received=100, sent=101, receive_dropped=106, send_dropped=107, overruns=111
        ),
    )


def test_what_a_driver_does_not_tell_is_unknown():
    controller = described(whole(*DATA[:2])).controller
    assert controller == CanController(counters=DeviceCounters(1, 2, 3, 4, 5, 6))


def test_an_interface_without_a_controller_has_none():
    vcan = answer(0x41, attribute(6, b"noqueue\0"), attribute(18, attribute(1, b"vcan\0")))
    found = described(vcan)
    assert (found.kind, found.controller, found.traffic) == ("vcan", None, None)
    tunnel = answer(0x41, attribute(18, attribute(1, b"x\0") + attribute(2, attribute(1, b"1234"))))
    assert described(tunnel).controller is None


def test_an_unknown_mode_bit_of_a_later_kernel_is_kept():
    told = described(whole(DATA[1], attribute(5, struct.pack("=2I", 0, 0x8002))))
    assert told.controller is not None
    assert ControllerMode.LISTEN_ONLY in (told.controller.modes or ControllerMode(0))


@pytest.mark.parametrize("length", range(0, 420, 3))
def test_a_torn_answer_is_an_error_or_less_known_and_nothing_else(length):
    try:
        described(whole(*DATA)[:length])
    except struct.error:
        return


def test_a_refusal_is_the_kernels_error():
    refusal = struct.pack("=IHHIIi", 20, 2, 0, 1, 0, -errno.ENODEV)
    with pytest.raises(OSError, match="No such device") as caught:
        described(refusal)
    assert caught.value.errno == errno.ENODEV


def test_the_loopback_of_this_machine_is_described_and_a_missing_one_is_enodev():
    lo = netlink.describe("lo")
    assert (lo.up, lo.is_can, lo.controller) == (True, False, None)
    assert lo.traffic is not None
    with pytest.raises(OSError, match="No such device"):
        netlink.describe("nocan9")
