"""Systemd units: the gateway's, and those of the exporter and the web page where installed."""

import os
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome, Unreadable

SUBJECT = CheckSubject("service")
_BOOTED = "/run/systemd/system"
_TIMEOUT_S = 2.0
_BAD_CONFIGURATION = ("65", "66", "78")
_INSTANCES = Path("/etc/vcu-gateway")
_PROPERTIES = (
    *("LoadState", "UnitFileState", "ActiveState", "SubState", "MainPID", "StatusText"),
    *("NRestarts", "Result", "ExecMainStatus", "User", "NeedDaemonReload"),
    *("LimitMEMLOCK", "CPUSchedulingPolicy", "ExecStart"),
    *("RootDirectory", "BindReadOnlyPaths", "BindPaths"),
)


class ServiceFacts(NamedTuple):
    """Properties of the unit by name; None where systemd does not run."""

    unit: str
    properties: Mapping[str, str] | Unreadable | None

    def get(self, name: str) -> str:
        """A property; empty where it is not known."""
        return self.properties.get(name, "") if isinstance(self.properties, Mapping) else ""

    @property
    def is_installed(self) -> bool:
        return self.get("LoadState") == "loaded"

    @property
    def pid(self) -> int | None:
        """The main process, while there is one."""
        return int(self.get("MainPID") or 0) or None

    @property
    def is_active(self) -> bool:
        return self.get("ActiveState") == "active"

    @property
    def is_enabled(self) -> bool:
        return self.get("UnitFileState").startswith("enabled")

    @property
    def fails(self) -> bool:
        """Whether it has failed, or is restarted again and again."""
        return self.get("ActiveState") == "failed" or self.get("SubState") == "auto-restart"

    @property
    def end(self) -> str:
        """How its process ended last."""
        return f"{self.get('Result')}, status {self.get('ExecMainStatus')}"

    @property
    def visible_folders(self) -> tuple[str, ...] | None:
        """Folders visible to the process under RootDirectory=; None where all are."""
        if not self.get("RootDirectory"):
            return None
        binds = self.get("BindReadOnlyPaths"), self.get("BindPaths")
        return tuple(word.lstrip("-").partition(":")[0] for one in binds for word in one.split())

    def runs_with(self, path: Path | None) -> bool:
        """Whether it is started with this configuration file; None is the default one."""
        words = self.get("ExecStart").split()
        return self.is_installed and (path is None or str(path.absolute()) in words)


def unit_of(path: Path | None) -> str:
    """The unit that runs with this configuration: an instance has a file of its name."""
    if path is not None and path.absolute().parent == _INSTANCES and path.stem != "gateway":
        return f"vcu-gateway@{path.stem}.service"
    return "vcu-gateway.service"


def read(unit: str, booted: str = _BOOTED) -> ServiceFacts:
    """Read the properties from systemd; `booted` is a folder that only systemd makes."""
    if not os.path.isdir(booted):
        return ServiceFacts(unit, None)
    program = shutil.which("systemctl")
    if program is None:
        return ServiceFacts(unit, Unreadable("there is no systemctl"))
    command = [program, "show", unit, "--property", ",".join(_PROPERTIES)]
    try:
        done = subprocess.run(  # noqa: S603 - systemd's own program
            command, check=False, capture_output=True, errors="replace", timeout=_TIMEOUT_S
        )
    except subprocess.TimeoutExpired:
        return ServiceFacts(unit, Unreadable(f"systemd did not answer within {_TIMEOUT_S:g} s"))
    except OSError as error:
        return ServiceFacts(unit, Unreadable(f"systemctl: {error.strerror}"))
    if done.returncode != 0:
        return ServiceFacts(unit, Unreadable(f"systemctl: {' '.join(done.stderr.split())}"))
    return ServiceFacts(unit, parsed(done.stdout))


def parsed(output: str) -> dict[str, str]:
    pairs = (line.partition("=") for line in output.splitlines())
    return {name: value for name, equals, value in pairs if equals}


def judge(facts: ServiceFacts) -> Iterator[CheckResult]:
    if facts.properties is None:
        yield SUBJECT.ok("systemd", "no systemd here: the gateway is started by hand")
    elif isinstance(facts.properties, Unreadable):
        yield SUBJECT.unknown("systemd", facts.properties.reason)
    elif facts.get("LoadState") == "not-found":
        yield SUBJECT.ok("installed", f"{facts.unit} is not installed; a vehicle computer needs it")
    elif not facts.is_installed:
        what = f"{facts.unit} cannot be loaded: {facts.get('LoadState')}"
        is_masked = facts.get("LoadState") == "masked"
        command = "sudo systemctl unmask" if is_masked else "systemctl status"
        yield SUBJECT.wrong("installed", what, f"{command} {facts.unit}")
    else:
        checks = (_active(facts), _enabled(facts), _restarts(facts), _changed_on_disk(facts))
        yield from SUBJECT.summarise(facts.unit, checks)


def _enabled(facts: ServiceFacts) -> Outcome:
    state = facts.get("UnitFileState")
    if facts.is_enabled or state in ("static", "generated"):
        return "starts at boot"
    what = f"{facts.unit} does not start at boot ({state or 'state unknown'})"
    remedy = "unmask" if state.startswith("masked") else "enable"
    return SUBJECT.warning("enabled", what, f"sudo systemctl {remedy} {facts.unit}")


def _active(facts: ServiceFacts) -> Outcome:
    state, unit = facts.get("ActiveState"), facts.unit
    text = facts.get("StatusText")
    if state == "active":
        return f"running as {facts.pid}" + (f' ("{text}")' if text else "")
    if facts.fails:
        how = "has failed" if state == "failed" else "restarts repeatedly"
        what = f"{unit} {how}: {facts.end}" + (f" ({text})" if text else "")
        return SUBJECT.wrong("active", what, _remedy(facts))
    if state in ("activating", "reloading", "deactivating"):
        return SUBJECT.warning("active", f"{unit} is {state}", "check again in some seconds")
    return SUBJECT.warning("active", f"{unit} does not run", f"sudo systemctl start {unit}")


def _remedy(facts: ServiceFacts) -> str:
    if facts.get("ExecMainStatus") in _BAD_CONFIGURATION:
        return f"fix the configuration, then sudo systemctl start {facts.unit}"
    return f"journalctl -u {facts.unit} -n 50"


def _restarts(facts: ServiceFacts) -> Outcome | None:
    count = facts.get("NRestarts")
    if not count.isdecimal() or int(count) == 0:
        return None
    what = f"{facts.unit} was restarted {count} times after a failure"
    return SUBJECT.warning("restarts", what, f"journalctl -u {facts.unit} -p warning")


def _changed_on_disk(facts: ServiceFacts) -> Outcome | None:
    if facts.get("NeedDaemonReload") != "yes":
        return None
    what = f"{facts.unit} has changed on disk since systemd read it"
    return SUBJECT.warning("changed", what, "sudo systemctl daemon-reload")


OTHERS = {
    "exporter": "no metrics for Prometheus",
    "web": "no page, and no stop in a browser",
}
"""Program beside the gateway -> what is not there without it."""


def judge_other(program: str, facts: ServiceFacts) -> Iterator[CheckResult]:
    """Judge the unit; nothing where it is not installed. No fault of it is `wrong`."""
    if not facts.is_installed:
        return
    subject, name, lost = CheckSubject(program), facts.unit, OTHERS[program]
    if facts.is_active:
        yield subject.ok("active", f"{name}: running as {facts.pid}")
    elif facts.fails:
        what = f"{name} does not stay up: {facts.end}; {lost}"
        yield subject.warning("active", what, f"journalctl -u {name} -n 20")
    elif facts.is_enabled:
        what = f"{name} does not run: {lost}"
        yield subject.warning("active", what, f"sudo systemctl start {name}")
    else:
        yield subject.ok("active", f"{name} is not enabled: {lost}")
