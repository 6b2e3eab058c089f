"""CAN controller of the interface: bit rate, restart, modes, state and counters."""

from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.bus.interface_info import (
    CanController,
    ControllerMode,
    DeviceCounters,
    InterfaceInfo,
)
from vcu_gateway.core.link import LinkState
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome

SUBJECT = CheckSubject("interface")
_RESTART_MS = 100
_WIRING = "check wiring, bit rate and termination (60 ohm between CAN_H and CAN_L, power off)"


class ControllerSettings(NamedTuple):
    """Settings that the interface should have.

    Attributes:
        persistent: command that sets bit rate and restart for good, where networkd runs.
        is_serial: an adapter on a serial line: the kernel refuses it a restart, and every
            command that asks for one.
    """

    channel: str
    bit_rate_bit_s: int
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


def checks(settings: ControllerSettings, info: InterfaceInfo) -> Iterator[Outcome | None]:
    """Judge an interface's controller, but for the bit rate; nothing without one."""
    controller = info.controller
    if controller is None:
        return
    yield _restart(settings, controller)
    yield from _modes(settings, controller.modes)
    yield _state(settings, info, controller)
    yield _errors(controller)
    yield _counters(settings.channel, controller.counters)
    if info.details.driver_echoes is False:
        what = (
            f"{settings.channel}: the driver does not confirm what it has sent; only the"
            " controllers' answers show that commands leave"
        )
        yield SUBJECT.warning(
            "echo", what, "use an adapter whose driver echoes, where there is one"
        )


def bit_rate(settings: ControllerSettings, info: InterfaceInfo) -> Outcome | None:
    found, wanted = info.details.bit_rate_bit_s, settings.bit_rate_bit_s
    if found == wanted:
        return f"{_kilo(found)} kbit/s"
    command = settings.persistent or f"{settings.restart_command} {settings.ip_arguments}"
    if found is None and not info.up:
        return None  # setting it up sets it
    if found is None:
        what = f"{settings.channel}: no bit rate is set, or the driver does not report it"
        return SUBJECT.unknown("bit_rate", what, command)
    what = (
        f"{settings.channel} runs at {_kilo(found)} kbit/s, bus.bit_rate_bit_s says"
        f" {_kilo(wanted)}: one of them disturbs the bus"
    )
    return SUBJECT.wrong("bit_rate", what, command)


def _kilo(bit_s: int) -> str:
    return f"{bit_s / 1000:g}"


def _restart(settings: ControllerSettings, controller: CanController) -> Outcome:
    restart_ms = controller.restart_ms
    if restart_ms is None:
        return SUBJECT.unknown(
            "restart", f"{settings.channel}: the driver does not report restart-ms"
        )
    if restart_ms > 0:
        return f"restarts after {restart_ms} ms"
    if settings.is_serial:
        what = f"{settings.channel}, a serial adapter, cannot restart by itself after bus-off"
        return SUBJECT.warning("restart", what, f"after bus-off: {settings.restart_command}")
    what = f"{settings.channel} does not restart after bus-off: it stays off for ever"
    command = settings.persistent or f"{settings.restart_command} type can restart-ms {_RESTART_MS}"
    return SUBJECT.warning("restart", what, command)


def _modes(settings: ControllerSettings, modes: ControllerMode | None) -> Iterator[Outcome]:
    name = settings.channel
    if modes is None:
        yield SUBJECT.unknown("modes", f"{name}: the driver does not report its modes")
        return
    if ControllerMode.LISTEN_ONLY in modes:
        what = f"{name} only listens: nothing can be sent"
        yield SUBJECT.wrong(
            "listen_only", what, f"{settings.restart_command} type can listen-only off"
        )
    if ControllerMode.LOOPBACK in modes:
        what = f"{name} is in loopback mode: it receives its own frames, others may not"
        yield SUBJECT.warning("loopback", what, f"{settings.restart_command} type can loopback off")
    if ControllerMode.ONE_SHOT in modes:
        what = f"{name} is in one-shot mode: a command that loses arbitration is lost"
        yield SUBJECT.warning("one_shot", what, f"{settings.restart_command} type can one-shot off")
    if ControllerMode.PRESUME_ACK in modes:
        what = f"{name} counts unacknowledged frames as sent"
        yield SUBJECT.warning(
            "presume_ack", what, f"{settings.restart_command} type can presume-ack off"
        )
    if ControllerMode.FD in modes:
        yield "CAN FD on (the protocol does not use it)"
    if ControllerMode.ERROR_REPORTING in modes:
        yield "bus errors reported (a flood without another node)"


def _state(
    settings: ControllerSettings, info: InterfaceInfo, controller: CanController
) -> Outcome | None:
    name, state = settings.channel, info.details.state
    if not info.up:
        return None
    if state is LinkState.BUS_OFF:
        return SUBJECT.wrong("state", f"{name} is bus-off", _WIRING + _then(settings, controller))
    if info.details.carrier is False:
        return SUBJECT.wrong("carrier", f"{name} has no carrier", _WIRING)
    if state is LinkState.PASSIVE:
        return SUBJECT.wrong("state", f"{name} is error passive{_counted(controller)}", _WIRING)
    if state is LinkState.WARNING:
        what = f"{name} is at its error warning limit{_counted(controller)}"
        return SUBJECT.warning("state", what, _WIRING)
    if state is None:
        return SUBJECT.unknown(
            "state", f"{name}: the driver does not report the controller's state"
        )
    return None


def _then(settings: ControllerSettings, controller: CanController) -> str:
    """Command that ends bus-off, where no restart is configured."""
    if controller.restart_ms:
        return ""
    if settings.is_serial:
        return f"; then {settings.restart_command}"
    return f"; then sudo ip link set {settings.channel} type can restart"


def _counted(controller: CanController) -> str:
    errors = controller.errors
    return "" if errors is None else f" (errors: tx {errors.transmit}, rx {errors.receive})"


def _errors(controller: CanController) -> Outcome | None:
    errors = controller.errors
    return None if errors is None else f"errors tx {errors.transmit} rx {errors.receive}"


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
