"""The network interface that is the bus: there, up, and with a short way to the wire."""

import errno
import os
import socket
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.bus import netlink
from vcu_gateway.bus.interface_info import InterfaceInfo, InterfaceTraffic
from vcu_gateway.doctor import controller
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome
from vcu_gateway.doctor.procfs import Unreadable, names, refused, text

SUBJECT = CheckSubject("interface")
_QUEUE_AT_MOST = 4
_MS_PER_FRAME = 25  # two frames every 50 ms
_IN_ORDER = ("noqueue", "pfifo_fast", "pfifo", "bfifo", "mq")
_ARPHRD_CAN = "280"
_ALL = "/sys/class/net"


class InterfaceFacts(NamedTuple):
    """What was read.

    Attributes:
        kernel: why there are no CAN sockets here, as an error number; None where there are.
        described: None where there is no interface of this name.
        others: CAN interfaces of other names.
        shipped: a file of settings for networkd that may be copied; empty where networkd
            does not run, or it does not fit.
        is_serial: it has a controller and no device of its own: an adapter on a serial line.
    """

    channel: str
    bit_rate_bit_s: int
    kernel: int | None = None
    described: InterfaceInfo | Unreadable | None = None
    others: tuple[str, ...] = ()
    shipped: str = ""
    is_serial: bool = False


def read(channel: str, bit_rate_bit_s: int, shipped: str = "") -> InterfaceFacts:
    """Ask the kernel."""
    others = tuple(name for name in _can_interfaces() if name != channel)
    facts = InterfaceFacts(channel, bit_rate_bit_s, can_sockets_refused(), None, others, shipped)
    try:
        it = netlink.describe(channel)
        is_serial = it.controller is not None and not os.path.exists(f"{_ALL}/{channel}/device")
        return facts._replace(described=it, is_serial=is_serial)
    except OSError as error:
        if error.errno == errno.ENODEV:
            return facts
        return facts._replace(described=refused("rtnetlink", error))


def can_sockets_refused() -> int | None:
    """The error that a CAN socket meets here; None where there is none."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except AttributeError:
        return errno.EAFNOSUPPORT  # this Python was built without
    except OSError as error:
        return error.errno
    return None


def _can_interfaces() -> list[str]:
    return [name for name in names(_ALL) if text(f"{_ALL}/{name}/type") == _ARPHRD_CAN]


def judge(facts: InterfaceFacts) -> Iterator[CheckResult]:
    """What to say of it."""
    if facts.kernel is not None:
        yield _no_can(facts.kernel)
    described, name = facts.described, facts.channel
    if described is None and facts.kernel is None:
        yield _missing(facts)
    elif described is None:
        return
    elif isinstance(described, Unreadable):
        yield SUBJECT.unknown("exists", f"{name}: the kernel does not tell: {described.reason}")
    elif not described.is_can:
        what = f"{name} is no CAN interface"
        yield SUBJECT.wrong("is_can", what, f"set bus.channel to {_either(facts.others)}")
    else:
        yield from SUBJECT.summed(name, _checks(facts, described))


def _no_can(number: int) -> CheckResult:
    if number in (errno.EPERM, errno.EACCES):
        what = "this process may not open CAN sockets"
        return SUBJECT.wrong("sockets", what, "allow it AF_CAN (RestrictAddressFamilies=, seccomp)")
    what = f"this kernel has no CAN: {os.strerror(number)}"
    remedy = "sudo modprobe can-raw; or another kernel; `vcu-gateway demo` needs neither"
    return SUBJECT.wrong("sockets", what, remedy)


def _missing(facts: InterfaceFacts) -> CheckResult:
    name = facts.channel
    if name.startswith("vcan"):
        remedy = f"sudo ip link add dev {name} type vcan && sudo ip link set {name} up"
    elif facts.others:
        remedy = f"set bus.channel to {_either(facts.others)}, or plug {name} in"
    else:
        remedy = "plug the adapter in, or load its driver: sudo dmesg | grep -i can"
    return SUBJECT.wrong("exists", f"there is no interface {name}", remedy)


def _either(others: tuple[str, ...]) -> str:
    return " or ".join(others) or "a CAN interface"


def _checks(facts: InterfaceFacts, it: InterfaceInfo) -> Iterator[Outcome | None]:
    has_one = it.controller is not None
    setting = controller.ControllerSettings(
        facts.channel, facts.bit_rate_bit_s, facts.shipped, facts.is_serial
    )
    yield _up(setting, it)
    yield controller.bit_rate(setting, it) if has_one else f"{it.kind or 'virtual'}, no bit rate"
    yield _queue(facts.channel, it)
    yield _discipline(facts.channel, it)
    yield from controller.checks(setting, it)
    yield _dropped(facts.channel, it.traffic)
    yield _overruns(facts.channel, it.traffic)


def _up(setting: controller.ControllerSettings, it: InterfaceInfo) -> Outcome:
    name = setting.channel
    command = f"sudo ip link set {name} up"
    if not it.up and it.controller is not None and it.details.bit_rate_bit_s is None:
        whole = setting.shipped or f"{command} {setting.whole}"
        return SUBJECT.wrong("up", f"{name} is down and has no bit rate", whole)
    if not it.up:
        return SUBJECT.wrong("up", f"{name} is down", command)
    if it.details.carrier is False and it.controller is None:
        return SUBJECT.wrong(
            "carrier", f"{name} has no carrier", "look at the adapter and its cable"
        )
    return "up"


def _queue(name: str, it: InterfaceInfo) -> Outcome | None:
    frames = it.tx_queue_frames
    if frames is None or it.discipline == "noqueue":
        return None
    if frames <= _QUEUE_AT_MOST:
        return f"queue of {frames}"
    what = f"{name}: a queue of {frames} frames holds {frames * _MS_PER_FRAME} ms of old commands"
    command = f"sudo ip link set {name} txqueuelen {_QUEUE_AT_MOST}"
    return SUBJECT.warning("queue", what, command)


def _discipline(name: str, it: InterfaceInfo) -> Outcome | None:
    if not it.up or not it.discipline or it.discipline in _IN_ORDER:
        return None
    what = f"{name}: the queueing discipline {it.discipline} may delay or drop commands"
    return SUBJECT.warning("discipline", what, f"sudo tc qdisc replace dev {name} root pfifo_fast")


def _dropped(name: str, traffic: InterfaceTraffic | None) -> Outcome | None:
    if traffic is None or not (traffic.send_dropped or traffic.receive_dropped):
        return None
    what = (
        f"{name} has dropped {traffic.send_dropped} frames of {traffic.sent} to be sent and"
        f" {traffic.receive_dropped} of {traffic.received} received"
    )
    return SUBJECT.warning("dropped", what, f"watch whether it grows: ip -s link show {name}")


def _overruns(name: str, traffic: InterfaceTraffic | None) -> Outcome | None:
    if traffic is None or not traffic.overruns:
        return None
    what = f"{name}: the controller had no room for {traffic.overruns} received frames"
    return SUBJECT.warning("overruns", what, f"watch whether it grows: ip -s link show {name}")
