"""The CAN controller behind the interface: bit rate, restart, modes, state and its past."""

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
    """What the interface should be set to.

    Attributes:
        shipped: the command that sets bit rate and restart for good, where networkd runs.
        is_serial: an adapter on a serial line: the kernel refuses it a restart, and every
            command that asks for one.
    """

    channel: str
    bit_rate_bit_s: int
    shipped: str = ""
    is_serial: bool = False

    @property
    def again(self) -> str:
        """Down and up: a controller can be set only while the interface is down."""
        return f"sudo ip link set {self.channel} down && sudo ip link set {self.channel} up"

    @property
    def whole(self) -> str:
        """All that is to be set, as words of ip's."""
        restart = "" if self.is_serial else f" restart-ms {_RESTART_MS}"
        return f"type can bitrate {self.bit_rate_bit_s}{restart}"


def checks(setting: ControllerSettings, it: InterfaceInfo) -> Iterator[Outcome | None]:
    """What to say of an interface's controller, but for the bit rate; nothing without one."""
    controller = it.controller
    if controller is None:
        return
    yield _restart(setting, controller)
    yield from _modes(setting, controller.modes)
    yield _state(setting, it, controller)
    yield _errors(controller)
    yield _past(setting.channel, controller.counters)
    if it.details.driver_echoes is False:
        what = (
            f"{setting.channel}: the driver does not confirm what it has sent; only the"
            " controllers' answers tell that commands leave"
        )
        yield SUBJECT.warning(
            "echo", what, "use an adapter whose driver echoes, where there is one"
        )


def bit_rate(setting: ControllerSettings, it: InterfaceInfo) -> Outcome | None:
    """The bit rate that the controller is set to."""
    found, wanted = it.details.bit_rate_bit_s, setting.bit_rate_bit_s
    if found == wanted:
        return f"{_kilo(found)} kbit/s"
    command = setting.shipped or f"{setting.again} {setting.whole}"
    if found is None and not it.up:
        return None  # setting it up sets it
    if found is None:
        what = f"{setting.channel}: no bit rate is set, or the driver does not tell it"
        return SUBJECT.unknown("bit_rate", what, command)
    what = (
        f"{setting.channel} runs at {_kilo(found)} kbit/s, bus.bit_rate_bit_s says"
        f" {_kilo(wanted)}: one of them disturbs the bus"
    )
    return SUBJECT.wrong("bit_rate", what, command)


def _kilo(bit_s: int) -> str:
    return f"{bit_s / 1000:g}"


def _restart(setting: ControllerSettings, controller: CanController) -> Outcome:
    restart_ms = controller.restart_ms
    if restart_ms is None:
        return SUBJECT.unknown("restart", f"{setting.channel}: the driver does not tell restart-ms")
    if restart_ms > 0:
        return f"restarts after {restart_ms} ms"
    if setting.is_serial:
        what = f"{setting.channel}, a serial adapter, cannot restart by itself after bus-off"
        return SUBJECT.warning("restart", what, f"after bus-off: {setting.again}")
    what = f"{setting.channel} does not restart after bus-off: it would stay off for ever"
    command = setting.shipped or f"{setting.again} type can restart-ms {_RESTART_MS}"
    return SUBJECT.warning("restart", what, command)


def _modes(setting: ControllerSettings, modes: ControllerMode | None) -> Iterator[Outcome]:
    name = setting.channel
    if modes is None:
        yield SUBJECT.unknown("modes", f"{name}: the driver does not tell its modes")
        return
    if ControllerMode.LISTEN_ONLY in modes:
        what = f"{name} only listens: nothing can be sent"
        yield SUBJECT.wrong("listen_only", what, f"{setting.again} type can listen-only off")
    if ControllerMode.LOOPBACK in modes:
        what = f"{name} is in loopback mode: it hears itself, others may not"
        yield SUBJECT.warning("loopback", what, f"{setting.again} type can loopback off")
    if ControllerMode.ONE_SHOT in modes:
        what = f"{name} is in one-shot mode: a command that loses arbitration is lost"
        yield SUBJECT.warning("one_shot", what, f"{setting.again} type can one-shot off")
    if ControllerMode.PRESUME_ACK in modes:
        what = f"{name} counts as sent what nobody acknowledged"
        yield SUBJECT.warning("presume_ack", what, f"{setting.again} type can presume-ack off")
    if ControllerMode.FD in modes:
        yield "CAN FD on (the protocol does not use it)"
    if ControllerMode.ERROR_REPORTING in modes:
        yield "bus errors reported (a flood where nobody answers)"


def _state(
    setting: ControllerSettings, it: InterfaceInfo, controller: CanController
) -> Outcome | None:
    name, state = setting.channel, it.details.state
    if not it.up:
        return None
    if state is LinkState.BUS_OFF:
        return SUBJECT.wrong("state", f"{name} is bus-off", _WIRING + _then(setting, controller))
    if it.details.carrier is False:
        return SUBJECT.wrong("carrier", f"{name} has no carrier", _WIRING)
    if state is LinkState.PASSIVE:
        return SUBJECT.wrong("state", f"{name} is error passive{_counted(controller)}", _WIRING)
    if state is LinkState.WARNING:
        what = f"{name} is at its error warning limit{_counted(controller)}"
        return SUBJECT.warning("state", what, _WIRING)
    if state is None:
        return SUBJECT.unknown("state", f"{name}: the driver does not tell the controller's state")
    return None


def _then(setting: ControllerSettings, controller: CanController) -> str:
    """What ends bus-off, where nothing does by itself."""
    if controller.restart_ms:
        return ""
    if setting.is_serial:
        return f"; then {setting.again}"
    return f"; then sudo ip link set {setting.channel} type can restart"


def _counted(controller: CanController) -> str:
    errors = controller.errors
    return "" if errors is None else f" (errors: tx {errors.transmit}, rx {errors.receive})"


def _errors(controller: CanController) -> Outcome | None:
    errors = controller.errors
    return None if errors is None else f"errors tx {errors.transmit} rx {errors.receive}"


def _past(name: str, counters: DeviceCounters | None) -> CheckResult | None:
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
    # Who loses arbitration waits its turn: that alone is a bus at work.
    if not any(counters._replace(arbitrations_lost=0)):
        return None
    past = ", ".join(f"{what} {count}" for what, count in counted.items() if count)
    remedy = f"check the wiring, if it grows: ip -s -d link show {name}"
    return SUBJECT.warning("past", f"{name} since it was made: {past}", remedy)
