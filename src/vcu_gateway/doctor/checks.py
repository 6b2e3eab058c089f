"""All checks, subject after subject, with the facts that they share."""

import os
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.doctor import (
    bus_traffic,
    clock,
    configuration,
    interface,
    libraries,
    permissions,
    process,
    recorder,
    running_gateway,
    service,
)
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, number
from vcu_gateway.errors import Problem

_NETWORK_FILES = "/usr/share/vcu-gateway/network"
_NETWORKD_RUNS = "/run/systemd/netif/state"
_PACKAGED_CHANNEL, _PACKAGED_BIT_S = "can0", 250_000
_DEFAULT_SERVICE_USER = "root"  # what systemd takes where a unit names nobody


class _SharedFacts(NamedTuple):
    """Facts that more than one subject needs."""

    file: configuration.ConfigurationFacts
    unit: service.ServiceFacts
    gateway: running_gateway.GatewayFacts

    @property
    def is_of_the_service(self) -> bool:
        return self.unit.runs_with(self.file.path)

    @property
    def pid(self) -> int | None:
        """Process of a running gateway, as the service or by hand."""
        return (self.unit.pid if self.is_of_the_service else None) or self.gateway.pid


def run_checks(
    path: Path | None, missing: tuple[Problem, ...] = (), *, listen: bool = False
) -> Iterator[CheckResult]:
    """Run all checks for the configuration at `path`, or for the defaults.

    Args:
        path: None checks for the defaults.
        missing: why there is no path.
        listen: also receive from the bus for a second.

    Raises nothing: a check that fails by itself is an unknown result.
    """
    file, unit = configuration.read(path, missing), service.read(service.unit_of(path))
    expected = unit.is_active and unit.runs_with(path)
    shared = _SharedFacts(file, unit, running_gateway.read(file.in_effect, expected))
    yield from _guarded("configuration", lambda: configuration.judge(shared.file))
    left_out = set() if shared.file.can_be_checked else set(_OF_CONFIGURATION)
    left_out |= set() if listen else {"bus"}
    for name, check in _CHECKS.items():
        if name not in left_out:
            yield from _guarded(name, partial(check, shared))


def _recorder(shared: _SharedFacts) -> Iterable[CheckResult]:
    """The recorder, which is there for every gateway of the machine."""
    runs = shared.unit.is_active or isinstance(shared.gateway.answers, tuple)
    socket = service.read(recorder.SOCKET_UNIT)
    return recorder.judge(recorder.read(socket, gateway_runs=runs))


def _other_unit(program: str) -> Iterable[CheckResult]:
    return service.judge_other(program, service.read(f"vcu-gateway-{program}.service"))


def _guarded(name: str, check: Callable[[], Iterable[CheckResult]]) -> list[CheckResult]:
    """Results of a subject; an exception there must not hide the others."""
    try:
        return list(check())
    except Exception as error:  # noqa: BLE001 - an unknown result, with the reason
        what = f"the check failed: {type(error).__name__}: {error}"
        return [CheckSubject(name).unknown("examination", what, "please report this")]


def _interface(shared: _SharedFacts) -> Iterable[CheckResult]:
    bus = shared.file.in_effect.bus
    if bus.interface != "socketcan":
        what = f"{bus.interface} {bus.channel} needs no CAN interface"
        return [interface.SUBJECT.ok("exists", what)]
    fits = (bus.channel, bus.bit_rate_bit_s) == (_PACKAGED_CHANNEL, _PACKAGED_BIT_S)
    persistent = _networkd_command() if fits else ""
    return interface.judge(interface.read(bus.channel, bus.bit_rate_bit_s, persistent))


def _networkd_command() -> str:
    """Command that installs the packaged networkd files; empty where networkd is not in use."""
    network = f"{_NETWORK_FILES}/{_PACKAGED_CHANNEL}.network"
    if not (os.path.exists(_NETWORKD_RUNS) and os.path.exists(network)):
        return ""
    copy = f"sudo cp {network} {_NETWORK_FILES}/10-{_PACKAGED_CHANNEL}.link /etc/systemd/network/"
    apply = f"sudo networkctl reload && sudo networkctl reconfigure {_PACKAGED_CHANNEL}"
    return f"{copy} && {apply}"


def _bus(shared: _SharedFacts) -> Iterable[CheckResult]:
    config = shared.file.in_effect
    if config.bus.interface != "socketcan":
        return []
    spec = configuration.read_protocol(config).spec
    if spec is None:
        return [bus_traffic.SUBJECT.unknown("listen", "needs a valid protocol")]
    observed = bus_traffic.listen(config.bus.channel)
    facts = bus_traffic.TrafficFacts(
        config.bus.channel,
        observed,
        spec,
        required=config.safety.required_messages,
        gateway_runs=shared.pid is not None,
    )
    return bus_traffic.judge(facts)


def _permissions(shared: _SharedFacts) -> Iterable[CheckResult]:
    unit, user = shared.unit, None
    if shared.is_of_the_service:
        user = unit.get("User") or _DEFAULT_SERVICE_USER
    config, path = shared.file.in_effect, shared.file.path
    return permissions.judge(permissions.read(config, path, user, unit.visible_folders))


def _process(shared: _SharedFacts) -> Iterable[CheckResult]:
    names = ("LimitMEMLOCK", "CPUSchedulingPolicy") if shared.is_of_the_service else ()
    return process.judge(process.read(shared.pid, *map(shared.unit.get, names)))


_CHECKS: dict[str, Callable[[_SharedFacts], Iterable[CheckResult]]] = {
    "protocol": lambda shared: configuration.judge_protocol(
        configuration.read_protocol(shared.file.in_effect)
    ),
    "interface": _interface,
    "bus": _bus,
    "time": lambda _: clock.judge(clock.read()),
    "permissions": _permissions,
    "buffers": lambda shared: process.judge_buffers(
        shared.file.in_effect.bus.receive_buffer_bytes, number(process.RMEM_MAX)
    ),
    "process": _process,
    "service": lambda shared: service.judge(shared.unit),
    "libraries": lambda _: libraries.judge(libraries.read()),
    "gateway": lambda shared: running_gateway.judge(shared.gateway),
    "recorder": _recorder,
    "exporter": lambda _: _other_unit("exporter"),
    "web": lambda _: _other_unit("web"),
}
"""In the order of the output."""
_OF_CONFIGURATION = ("protocol", "interface", "bus", "permissions", "buffers")
"""Checks of the machine against the configuration."""
