"""Network interface of the bus: present, up, queue, traffic."""

import errno
import os
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.bus import netlink
from vcu_gateway.bus.interface import can_socket_error
from vcu_gateway.bus.interface_info import InterfaceInfo, InterfaceTraffic
from vcu_gateway.doctor import controller
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome
from vcu_gateway.doctor.procfs import Unreadable, names, text, unreadable

SUBJECT = CheckSubject("interface")
_LONGEST_QUEUE = 4
_MS_PER_FRAME = 25  # two frames every 50 ms
_FIFO_DISCIPLINES = ("noqueue", "pfifo_fast", "pfifo", "bfifo", "mq")
_ARPHRD_CAN = "280"
_FOLDER = "/sys/class/net"


class InterfaceFacts(NamedTuple):
    """Facts about the interface.

    Attributes:
        kernel: error number of opening a CAN socket; None where it works.
        info: None where there is no interface of this name.
        others: CAN interfaces of other names.
        persistent: command that installs settings for networkd; empty where networkd does not
            run, or they do not fit.
        is_serial: an adapter on a serial line: a controller without a device of its own.
    """

    channel: str
    bit_rate_bit_s: int
    kernel: int | None = None
    info: InterfaceInfo | Unreadable | None = None
    others: tuple[str, ...] = ()
    persistent: str = ""
    is_serial: bool = False


def read(channel: str, bit_rate_bit_s: int, persistent: str = "") -> InterfaceFacts:
    others = tuple(name for name in _can_interfaces() if name != channel)
    refusal = can_socket_error()
    number = None if refusal is None else refusal.errno
    facts = InterfaceFacts(channel, bit_rate_bit_s, number, None, others, persistent)
    try:
        found = netlink.describe(channel)
        is_serial = found.controller is not None and not os.path.exists(
            f"{_FOLDER}/{channel}/device"
        )
        return facts._replace(info=found, is_serial=is_serial)
    except OSError as error:
        if error.errno == errno.ENODEV:
            return facts
        return facts._replace(info=unreadable("rtnetlink", error))


def _can_interfaces() -> list[str]:
    return [name for name in names(_FOLDER) if text(f"{_FOLDER}/{name}/type") == _ARPHRD_CAN]


def judge(facts: InterfaceFacts) -> Iterator[CheckResult]:
    if facts.kernel is not None:
        yield _no_can(facts.kernel)
    info, name = facts.info, facts.channel
    if info is None and facts.kernel is None:
        yield _missing(facts)
    elif info is None:
        return
    elif isinstance(info, Unreadable):
        yield SUBJECT.unknown("exists", f"{name}: the kernel does not report it: {info.reason}")
    elif not info.is_can:
        what = f"{name} is not a CAN interface"
        yield SUBJECT.wrong("is_can", what, f"set bus.channel to {_alternatives(facts.others)}")
    else:
        yield from SUBJECT.summarise(name, _checks(facts, info))


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
        remedy = f"set bus.channel to {_alternatives(facts.others)}, or plug {name} in"
    else:
        remedy = "plug the adapter in, or load its driver: sudo dmesg | grep -i can"
    return SUBJECT.wrong("exists", f"there is no interface {name}", remedy)


def _alternatives(others: tuple[str, ...]) -> str:
    return " or ".join(others) or "a CAN interface"


def _checks(facts: InterfaceFacts, info: InterfaceInfo) -> Iterator[Outcome | None]:
    has_controller = info.controller is not None
    settings = controller.ControllerSettings(
        facts.channel, facts.bit_rate_bit_s, facts.persistent, facts.is_serial
    )
    yield _up(settings, info)
    yield (
        controller.bit_rate(settings, info)
        if has_controller
        else f"{info.kind or 'virtual'}, no bit rate"
    )
    yield _queue(facts.channel, info)
    yield _discipline(facts.channel, info)
    yield from controller.checks(settings, info)
    yield _dropped(facts.channel, info.traffic)
    yield _overruns(facts.channel, info.traffic)


def _up(settings: controller.ControllerSettings, info: InterfaceInfo) -> Outcome:
    name = settings.channel
    command = f"sudo ip link set {name} up"
    if not info.up and info.controller is not None and info.details.bit_rate_bit_s is None:
        fix = settings.persistent or f"{command} {settings.ip_arguments}"
        return SUBJECT.wrong("up", f"{name} is down and has no bit rate", fix)
    if not info.up:
        return SUBJECT.wrong("up", f"{name} is down", command)
    if info.details.carrier is False and info.controller is None:
        return SUBJECT.wrong("carrier", f"{name} has no carrier", "check the adapter and its cable")
    return "up"


def _queue(name: str, info: InterfaceInfo) -> Outcome | None:
    frames = info.tx_queue_frames
    if frames is None or info.discipline == "noqueue":
        return None
    if frames <= _LONGEST_QUEUE:
        return f"queue of {frames}"
    what = f"{name}: a queue of {frames} frames holds {frames * _MS_PER_FRAME} ms of old commands"
    command = f"sudo ip link set {name} txqueuelen {_LONGEST_QUEUE}"
    return SUBJECT.warning("queue", what, command)


def _discipline(name: str, info: InterfaceInfo) -> Outcome | None:
    if not info.up or not info.discipline or info.discipline in _FIFO_DISCIPLINES:
        return None
    what = f"{name}: the queueing discipline {info.discipline} may delay or drop commands"
    return SUBJECT.warning("discipline", what, f"sudo tc qdisc replace dev {name} root pfifo_fast")


def _dropped(name: str, traffic: InterfaceTraffic | None) -> Outcome | None:
    if traffic is None or not (traffic.send_dropped or traffic.receive_dropped):
        return None
    what = (
        f"{name} has dropped {traffic.send_dropped} frames of {traffic.sent} to be sent and"
        f" {traffic.receive_dropped} of {traffic.received} received"
    )
    return SUBJECT.warning("dropped", what, f"check whether it grows: ip -s link show {name}")


def _overruns(name: str, traffic: InterfaceTraffic | None) -> Outcome | None:
    if traffic is None or not traffic.overruns:
        return None
    what = f"{name}: the controller had no room for {traffic.overruns} received frames"
    return SUBJECT.warning("overruns", what, f"check whether it grows: ip -s link show {name}")
