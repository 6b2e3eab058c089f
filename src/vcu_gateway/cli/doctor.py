"""`vcu-gateway doctor`: what this machine lacks before the gateway can drive."""

import json
import os
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import click

from vcu_gateway.cli.options import config_option, resolve_config
from vcu_gateway.doctor.check_result import CheckResult, CheckStatus
from vcu_gateway.doctor.checks import run_checks
from vcu_gateway.errors import ConfigError, Problem

_COLOURS = {
    CheckStatus.OK: "green",
    CheckStatus.WARNING: "yellow",
    CheckStatus.WRONG: "red",
    CheckStatus.UNKNOWN: "cyan",
}
_SEVEREST_FIRST = (CheckStatus.WRONG, CheckStatus.WARNING, CheckStatus.UNKNOWN, CheckStatus.OK)
_HELP = """Check everything that the gateway needs before it can drive.

Looks at the configuration and its DBC, the interface, time, permissions, buffers, process,
service, libraries and the running gateway. A line each: how it is, the subject, what was found,
and after a semicolon the command that mends it. Nothing is changed and nothing is sent; run as
root it tells more. Exit code 1 where something is wrong, 0 otherwise, warnings or not.

\b
--json prints one object:
  healthy   true where nothing is wrong
  counts    how many lines are ok, warning, wrong, unknown
  findings  a list of objects: subject, check (a stable word), kind, what, remedy (or "")
"""


@click.command("doctor", help=_HELP)
@config_option
@click.option("--listen", is_flag=True, help="Also listen on the bus for a second: who talks?")
@click.option("--json", "as_json", is_flag=True, help="One JSON object.")
def command(config_path: Path | None, listen: bool, as_json: bool) -> None:
    """Examine, show, and exit with the answer."""
    path, missing = _file(config_path)
    findings = list(run_checks(path, missing, listen=listen))
    click.echo(_as_json(findings) if as_json else _as_text(findings), color=_colour())
    if any(finding.kind is CheckStatus.WRONG for finding in findings):
        sys.exit(1)


def _file(given: Path | None) -> tuple[Path | None, tuple[Problem, ...]]:
    try:
        return resolve_config(given), ()
    except ConfigError as error:
        return None, error.problems


def _colour() -> bool | None:
    """On a terminal alone, and not where NO_COLOR is set (no-color.org)."""
    return False if os.environ.get("NO_COLOR") else None


def _as_json(findings: list[CheckResult]) -> str:
    counts = _counts(findings)
    told = {
        "healthy": not counts[CheckStatus.WRONG],
        "counts": {kind.value: counts[kind] for kind in CheckStatus},
        "findings": [{**finding._asdict(), "kind": finding.kind.value} for finding in findings],
    }
    return json.dumps(told, ensure_ascii=False)


def _as_text(findings: list[CheckResult]) -> str:
    width = max((len(finding.subject) for finding in findings), default=0)
    return "\n".join([*(_line(finding, width) for finding in findings), _summary(findings)])


def _line(finding: CheckResult, width: int) -> str:
    kind = click.style(f"{finding.kind.value:<7}", fg=_COLOURS[finding.kind])
    remedy = f"; {finding.remedy}" if finding.remedy else ""
    return f"{kind}  {finding.subject:<{width}}  {finding.what}{remedy}"


def _summary(findings: list[CheckResult]) -> str:
    counts = _counts(findings)
    told = ", ".join(_counted(kind, counts[kind]) for kind in _SEVEREST_FIRST if counts[kind])
    more = counts[CheckStatus.UNKNOWN] and os.geteuid() != 0
    return told + ("; sudo vcu-gateway doctor tells more" if more else "")


def _counted(kind: CheckStatus, count: int) -> str:
    plural = "s" if kind is CheckStatus.WARNING and count > 1 else ""
    return f"{count} {kind.value}{plural}"


def _counts(findings: Iterable[CheckResult]) -> Counter[CheckStatus]:
    return Counter(finding.kind for finding in findings)
