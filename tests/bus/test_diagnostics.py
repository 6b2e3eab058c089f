"""A bus that cannot be opened: the problem, and what to do about it."""

import errno
import os

import pytest

from vcu_gateway.bus import interface
from vcu_gateway.bus.settings import BusSettings

CAN0 = BusSettings("socketcan", "can0")
MULTICAST = BusSettings("udp_multicast", "239.74.163.2")
NEW_INTERFACE = "; for an adapter: plug it in and ip link set can0 up type can bitrate "


@pytest.mark.parametrize(
    ("settings", "error", "remedy"),
    [
        (CAN0, errno.EAFNOSUPPORT, "this kernel has no CAN; try `vcu-gateway demo`, "),
        (CAN0, errno.ENODEV, "for a bench: ip link add dev can0 type vcan && "),
        (CAN0, errno.EPERM, "look at: ip -details link show can0"),
        (MULTICAST, errno.ENODEV, "check bus.interface and bus.channel"),
        (BusSettings("virtual", "bench"), errno.EPERM, "check bus.interface and bus.channel"),
    ],
)
def test_each_failure_of_opening_has_its_remedy(settings, error, remedy):
    text = os.strerror(error)
    problem = interface.unopened(OSError(error, text), settings)
    opening = f"cannot open {settings.interface} {settings.channel}: "
    assert problem.what == f"{opening}[Errno {error}] {text}"
    assert problem.remedy.startswith(remedy)


def test_a_multicast_bus_without_its_library_is_told_which_extra_to_install():
    problem = interface.unopened(ImportError("msgpack not installed"), MULTICAST)
    assert problem.remedy == "install the extra: pip install 'vcu-gateway[multicast]'"


@pytest.mark.parametrize(("configured", "named"), [(None, 250_000), (500_000, 500_000)])
def test_an_adapter_is_set_up_with_the_configured_bit_rate_or_the_usual(configured, named):
    settings = BusSettings("socketcan", "can0", bit_rate_bit_s=configured)
    problem = interface.unopened(OSError(errno.ENODEV, "No such device"), settings)
    assert problem.remedy.endswith(f"{NEW_INTERFACE}{named}")
