"""Systemd unit of the metrics exporter, where it is installed: it runs or is switched off."""

from collections.abc import Iterator

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject
from vcu_gateway.doctor.service import ServiceFacts

SUBJECT = CheckSubject("exporter")
UNIT = "vcu-gateway-exporter.service"


def judge(facts: ServiceFacts) -> Iterator[CheckResult]:
    """Judge the exporter; nothing where its unit is not installed. No fault of it is `wrong`."""
    if not facts.is_installed:
        return
    if facts.is_active:
        yield SUBJECT.ok("active", f"{UNIT}: running as {facts.pid}")
    elif facts.get("ActiveState") == "failed" or facts.get("SubState") == "auto-restart":
        ended = f"{facts.get('Result')}, status {facts.get('ExecMainStatus')}"
        what = f"{UNIT} does not stay up: {ended}; there are no metrics"
        yield SUBJECT.warning("active", what, f"journalctl -u {UNIT} -n 20")
    elif facts.get("UnitFileState").startswith("enabled"):
        what = f"{UNIT} does not run: there are no metrics"
        yield SUBJECT.warning("active", what, f"sudo systemctl start {UNIT}")
    else:
        yield SUBJECT.ok("active", f"{UNIT} is not enabled: no metrics for Prometheus")
