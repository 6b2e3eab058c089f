"""Network interface of the bus and its CAN controller: up, queue, bit rate, state, counters."""

import errno
import os
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.bus import netlink
from vcu_gateway.bus.interface import can_socket_error
from vcu_gateway.bus.netlink import (
    CanController,
    ControllerMode,
    DeviceCounters,
    InterfaceInfo,
    InterfaceTraffic,
)
from vcu_gateway.core.link import LinkState
from vcu_gateway.doctor.check_result import (
    CheckResult,
    CheckSubject,
    Outcome,
    Unreadable,
    names,
    text,
    unreadable,
)

SUBJECT = CheckSubject("interface")
_LONGEST_QUEUE = 4
_MS_PER_FRAME = 25  # two frames every 50 ms
_FIFO_DISCIPLINES = ("noqueue", "pfifo_fast", "pfifo", "bfifo", "mq")
_ARPHRD_CAN = "280"
_FOLDER = "/sys/class/net"
_RESTART_MS = 100
_WIRING = "check wiring, bit rate and termination (60 ohm between CAN_H and CAN_L, power off)"
_DISTURBING_MODES = {
    ControllerMode.LISTEN_ONLY: "only listens: nothing can be sent",
    ControllerMode.LOOPBACK: "is in loopback mode: it receives its own frames, others may not",
    ControllerMode.ONE_SHOT: "is in one-shot mode: a command that loses arbitration is lost",
    ControllerMode.PRESUME_ACK: "counts unacknowledged frames as sent",
}


class InterfaceFacts(NamedTuple):
    """Facts about the interface, and the settings that it should have.

    Attributes:
        bit_rate_bit_s: that it should have.
        kernel: error number of opening a CAN socket; None where it works.
        info: None where there is no interface of this name.
        others: CAN interfaces of other names.
        persistent: command that sets bit rate and restart for good; empty where networkd does
            not run, or the packaged settings do not fit.
        is_serial: an adapter on a serial line, a controller without a device of its own: the
            kernel refuses it a restart, and every command that asks for one.
    """

    channel: str
    bit_rate_bit_s: int
    kernel: int | None = None
    info: InterfaceInfo | Unreadable | None = None
    others: tuple[str, ...] = ()
    persistent: str = ""
    is_serial: bool = False

    @property
    def restart_command(self) -> str:
        """Set it down and up: a controller can be configured only while it is down."""
        return f"sudo ip link set {self.channel} down && sudo ip link set {self.channel} up"

    @property
    def ip_arguments(self) -> str:
        restart = "" if self.is_serial else f" restart-ms {_RESTART_MS}"
        return f"type can bitrate {self.bit_rate_bit_s}{restart}"


def read(channel: str, bit_rate_bit_s: int, persistent: str = "") -> InterfaceFacts:
    can = (name for name in names(_FOLDER) if text(f"{_FOLDER}/{name}/type") == _ARPHRD_CAN)
    others = tuple(name for name in can if name != channel)
    refusal = can_socket_error()
    number = None if refusal is None else refusal.errno
    facts = InterfaceFacts(channel, bit_rate_bit_s, number, None, others, persistent)
    try:
        found = netlink.describe(channel)
        has_device = os.path.exists(f"{_FOLDER}/{channel}/device")
        is_serial = found.controller is not None and not has_device
        return facts._replace(info=found, is_serial=is_serial)
    except OSError as error:
        if error.errno == errno.ENODEV:
            return facts
        return facts._replace(info=unreadable("rtnetlink", error))


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
    yield _up(facts, info)
    if info.controller is not None:
        yield _bit_rate(facts, info)
    else:
        yield f"{info.kind or 'virtual'}, no bit rate"
    yield _queue(facts.channel, info)
    yield _discipline(facts.channel, info)
    yield from _controller(facts, info)
    if info.traffic is not None:
        yield from _lost(facts.channel, info.traffic)


def _up(facts: InterfaceFacts, info: InterfaceInfo) -> Outcome:
    name = facts.channel
    command = f"sudo ip link set {name} up"
    if not info.up and info.controller is not None and info.details.bit_rate_bit_s is None:
        fix = facts.persistent or f"{command} {facts.ip_arguments}"
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


def _lost(name: str, traffic: InterfaceTraffic) -> Iterator[CheckResult]:
    remedy = f"check whether it grows: ip -s link show {name}"
    if traffic.send_dropped or traffic.receive_dropped:
        what = f"{name} has dropped {traffic.send_dropped} frames of {traffic.sent} to be sent and"
        what += f" {traffic.receive_dropped} of {traffic.received} received"
        yield SUBJECT.warning("dropped", what, remedy)
    if traffic.overruns:
        what = f"{name}: the controller had no room for {traffic.overruns} received frames"
        yield SUBJECT.warning("overruns", what, remedy)


def _controller(facts: InterfaceFacts, info: InterfaceInfo) -> Iterator[Outcome | None]:
    """Judge an interface's controller, but for the bit rate; nothing without one."""
    controller = info.controller
    if controller is None:
        return
    yield _restart(facts, controller)
    yield from _modes(facts, controller.modes)
    yield _state(facts, info, controller)
    if (errors := controller.errors) is not None:
        yield f"errors tx {errors.transmit} rx {errors.receive}"
    yield _counters(facts.channel, controller.counters)
    if info.details.driver_echoes is False:
        what = f"{facts.channel}: the driver does not confirm what it has sent; only the"
        what += " controllers' answers show that commands leave"
        remedy = "use an adapter whose driver echoes, where there is one"
        yield SUBJECT.warning("echo", what, remedy)


def _bit_rate(facts: InterfaceFacts, info: InterfaceInfo) -> Outcome | None:
    found, wanted = info.details.bit_rate_bit_s, facts.bit_rate_bit_s
    if found == wanted:
        return f"{_kilo(found)} kbit/s"
    command = facts.persistent or f"{facts.restart_command} {facts.ip_arguments}"
    if found is None and not info.up:
        return None  # setting it up sets it
    if found is None:
        what = f"{facts.channel}: no bit rate is set, or the driver does not report it"
        return SUBJECT.unknown("bit_rate", what, command)
    what = (
        f"{facts.channel} runs at {_kilo(found)} kbit/s, bus.bit_rate_bit_s says"
        f" {_kilo(wanted)}: one of them disturbs the bus"
    )
    return SUBJECT.wrong("bit_rate", what, command)


def _kilo(bit_s: int) -> str:
    return f"{bit_s / 1000:g}"


def _restart(facts: InterfaceFacts, controller: CanController) -> Outcome:
    restart_ms = controller.restart_ms
    if restart_ms is None:
        what = f"{facts.channel}: the driver does not report restart-ms"
        return SUBJECT.unknown("restart", what)
    if restart_ms > 0:
        return f"restarts after {restart_ms} ms"
    if facts.is_serial:
        what = f"{facts.channel}, a serial adapter, cannot restart by itself after bus-off"
        return SUBJECT.warning("restart", what, f"after bus-off: {facts.restart_command}")
    what = f"{facts.channel} does not restart after bus-off: it stays off for ever"
    command = facts.persistent or f"{facts.restart_command} type can restart-ms {_RESTART_MS}"
    return SUBJECT.warning("restart", what, command)


def _modes(facts: InterfaceFacts, modes: ControllerMode | None) -> Iterator[Outcome]:
    name = facts.channel
    if modes is None:
        yield SUBJECT.unknown("modes", f"{name}: the driver does not report its modes")
        return
    for mode, what in _DISTURBING_MODES.items():
        if mode in modes:
            check = (mode.name or "").lower()
            remedy = f"{facts.restart_command} type can {check.replace('_', '-')} off"
            judged = SUBJECT.wrong if mode is ControllerMode.LISTEN_ONLY else SUBJECT.warning
            yield judged(check, f"{name} {what}", remedy)
    if ControllerMode.FD in modes:
        yield "CAN FD on (the protocol does not use it)"
    if ControllerMode.ERROR_REPORTING in modes:
        yield "bus errors reported (a flood without another node)"


def _state(facts: InterfaceFacts, info: InterfaceInfo, controller: CanController) -> Outcome | None:
    name, state = facts.channel, info.details.state
    if not info.up:
        return None
    if state is LinkState.BUS_OFF:
        return SUBJECT.wrong("state", f"{name} is bus-off", _WIRING + _then(facts, controller))
    if info.details.carrier is False:
        return SUBJECT.wrong("carrier", f"{name} has no carrier", _WIRING)
    if state is LinkState.PASSIVE:
        return SUBJECT.wrong("state", f"{name} is error passive{_counted(controller)}", _WIRING)
    if state is LinkState.WARNING:
        what = f"{name} is at its error warning limit{_counted(controller)}"
        return SUBJECT.warning("state", what, _WIRING)
    if state is None:
        what = f"{name}: the driver does not report the controller's state"
        return SUBJECT.unknown("state", what)
    return None


def _then(facts: InterfaceFacts, controller: CanController) -> str:
    """Command that ends bus-off, where no restart is configured."""
    if controller.restart_ms:
        return ""
    if facts.is_serial:
        return f"; then {facts.restart_command}"
    return f"; then sudo ip link set {facts.channel} type can restart"


def _counted(controller: CanController) -> str:
    errors = controller.errors
    return "" if errors is None else f" (errors: tx {errors.transmit}, rx {errors.receive})"


def _counters(name: str, counters: DeviceCounters | None) -> CheckResult | None:
    if counters is None:
        return None
    counted = {
        "bus-off": counters.bus_offs,
        "restarted": counters.restarts,
        "error passive": counters.passives,
        "at the warning limit": counters.warnings,
        "bus errors": counters.bus_errors,
        "arbitration lost": counters.arbitrations_lost,
    }
    # Lost arbitration alone is normal traffic.
    if not any(counters._replace(arbitrations_lost=0)):
        return None
    past = ", ".join(f"{what} {count}" for what, count in counted.items() if count)
    remedy = f"check the wiring, if it grows: ip -s -d link show {name}"
    return SUBJECT.warning("past", f"{name} since it was created: {past}", remedy)
