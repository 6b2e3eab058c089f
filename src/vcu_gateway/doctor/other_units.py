"""Systemd units of the exporter and the web page, where installed: running or switched off."""

from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject
from vcu_gateway.doctor.service import ServiceFacts


class OtherUnit(NamedTuple):
    """Unit of a program beside the gateway; `lost` is what is not there without it."""

    subject: CheckSubject
    name: str
    lost: str


EXPORTER = OtherUnit(
    CheckSubject("exporter"), "vcu-gateway-exporter.service", "no metrics for Prometheus"
)
WEB = OtherUnit(CheckSubject("web"), "vcu-gateway-web.service", "no page, and no stop in a browser")


def judge(unit: OtherUnit, facts: ServiceFacts) -> Iterator[CheckResult]:
    """Judge the unit; nothing where it is not installed. No fault of it is `wrong`."""
    if not facts.is_installed:
        return
    subject, name = unit.subject, unit.name
    if facts.is_active:
        yield subject.ok("active", f"{name}: running as {facts.pid}")
    elif facts.fails:
        what = f"{name} does not stay up: {facts.end}; {unit.lost}"
        yield subject.warning("active", what, f"journalctl -u {name} -n 20")
    elif facts.is_enabled:
        what = f"{name} does not run: {unit.lost}"
        yield subject.warning("active", what, f"sudo systemctl start {name}")
    else:
        yield subject.ok("active", f"{name} is not enabled: {unit.lost}")
