"""All rooms, one after the other: what each needs to know of the others goes through here."""

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.doctor import (
    buffers,
    bus_traffic,
    clock,
    configuration,
    interface,
    libraries,
    permissions,
    process,
    protocol,
    running_gateway,
    service,
)
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject
from vcu_gateway.errors import Problem

_SHIPPED = "/usr/share/vcu-gateway/network"
_NETWORKD_RUNS = "/run/systemd/netif/state"
_SHIPPED_FOR, _SHIPPED_BIT_S = "can0", 250_000
_ORDER = (
    *("protocol", "interface", "bus", "time", "permissions", "buffers", "process", "service"),
    *("libraries", "gateway"),
)
_Room = Callable[[], Iterable[CheckResult]]
_DEFAULT_SERVICE_USER = "root"  # what systemd takes where a unit names nobody


class _Case(NamedTuple):
    """What more than one room looks at."""

    file: configuration.ConfigurationFacts
    unit: service.ServiceFacts
    running_gateway: running_gateway.GatewayFacts

    @property
    def is_of_the_service(self) -> bool:
        """The service is started with the configuration that is looked at."""
        return self.unit.runs_with(self.file.path)

    @property
    def pid(self) -> int | None:
        """Of a running gateway, as the service or by hand."""
        return (self.unit.pid if self.is_of_the_service else None) or self.gateway.pid


def run_checks(
    path: Path | None, missing: tuple[Problem, ...] = (), *, listen: bool = False
) -> Iterator[CheckResult]:
    """Look at everything, the configuration at `path` or the defaults in mind.

    Nothing is raised. `missing` says why there is no path; `listen` adds a second on the bus.
    """
    case = _case(path, missing)
    rooms = _of_machine(case)
    if case.file.can_be_held_to:
        rooms |= _of_configuration(case, listen=listen)
    yield from _guarded("configuration", lambda: configuration.judge(case.file))
    for name in _ORDER:
        if name in rooms:
            yield from _guarded(name, rooms[name])


def _of_configuration(case: _Case, *, listen: bool) -> dict[str, _Room]:
    """Rooms that hold the machine to the configuration."""
    config = case.file.in_effect
    rooms: dict[str, _Room] = {
        "protocol": lambda: protocol.judge(protocol.read(config)),
        "interface": lambda: _interface(case),
        "permissions": lambda: _permissions(case),
        "buffers": lambda: buffers.judge(buffers.read(config.bus.receive_buffer_bytes)),
    }
    if listen and config.bus.interface == "socketcan":
        rooms["bus"] = lambda: _bus(case)
    return rooms


def _of_machine(case: _Case) -> dict[str, _Room]:
    """Rooms that have something to tell whatever the configuration says."""
    return {
        "time": lambda: clock.judge(clock.read()),
        "process": lambda: _process(case),
        "service": lambda: service.judge(case.unit),
        "libraries": lambda: libraries.judge(libraries.read()),
        "gateway": lambda: running_gateway.judge(case.gateway),
    }


def _guarded(name: str, room: _Room) -> list[CheckResult]:
    """A room that breaks must not hide the others."""
    try:
        return list(room())
    except Exception as error:  # noqa: BLE001 - told as unknown, with its reason
        what = f"could not be looked at: {type(error).__name__}: {error}"
        return [CheckSubject(name).unknown("examination", what, "please report this")]


def _case(path: Path | None, missing: tuple[Problem, ...]) -> _Case:
    file = configuration.read(path, missing)
    unit = service.read(service.unit_of(path))
    expected = unit.is_active and unit.runs_with(path)
    return _Case(file, unit, running_gateway.read(file.in_effect, expected))


def _interface(case: _Case) -> Iterable[CheckResult]:
    bus = case.file.in_effect.bus
    if bus.interface != "socketcan":
        what = f"{bus.interface} {bus.channel} needs no CAN interface"
        return [interface.SUBJECT.ok("exists", what)]
    fits = (bus.channel, bus.bit_rate_bit_s) == (_SHIPPED_FOR, _SHIPPED_BIT_S)
    return interface.judge(
        interface.read(bus.channel, bus.bit_rate_bit_s, _shipped() if fits else "")
    )


def _shipped() -> str:
    """The command that puts our networkd files in effect; empty where networkd is not in use."""
    network = f"{_SHIPPED}/{_SHIPPED_FOR}.network"
    if not (os.path.exists(_NETWORKD_RUNS) and os.path.exists(network)):
        return ""
    copy = f"sudo cp {network} {_SHIPPED}/10-{_SHIPPED_FOR}.link /etc/systemd/network/"
    apply = f"sudo networkctl reload && sudo networkctl reconfigure {_SHIPPED_FOR}"
    return f"{copy} && {apply}"


def _bus(case: _Case) -> Iterable[CheckResult]:
    config = case.file.in_effect
    spec = protocol.read(config).spec
    if spec is None:
        return [
            bus_traffic.SUBJECT.unknown("listen", "without a protocol nobody knows what to hear")
        ]
    heard = bus_traffic.listen(config.bus.channel)
    required = config.safety.required_messages
    runs = case.pid is not None
    return bus_traffic.judge(
        bus_traffic.TrafficFacts(config.bus.channel, heard, spec, required, runs)
    )


def _permissions(case: _Case) -> Iterable[CheckResult]:
    unit, user = case.unit, None
    if case.is_of_the_service:
        user = unit.get("User") or _DEFAULT_SERVICE_USER
    return permissions.judge(
        permissions.read(case.file.in_effect, case.file.path, user, unit.shown)
    )


def _process(case: _Case) -> Iterable[CheckResult]:
    asked = [case.unit.get(name) for name in ("LimitMEMLOCK", "CPUSchedulingPolicy")]
    known = case.is_of_the_service
    return process.judge(process.read(case.pid, *asked) if known else process.read(case.pid))
