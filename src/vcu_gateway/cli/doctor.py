"""`vcu-gateway doctor`: checks of this machine, and how to fix what fails."""

import json
import os
import sys
from collections import Counter
from pathlib import Path

import click

from vcu_gateway.cli.options import config_option, json_option, resolve_config
from vcu_gateway.doctor.check_result import CheckResult, CheckStatus
from vcu_gateway.doctor.checks import run_checks
from vcu_gateway.errors import MissingInputError, Problem

_COLOURS = {
    CheckStatus.OK: "green",
    CheckStatus.WARNING: "yellow",
    CheckStatus.WRONG: "red",
    CheckStatus.UNKNOWN: "cyan",
}
_SEVEREST_FIRST = (CheckStatus.WRONG, CheckStatus.WARNING, CheckStatus.UNKNOWN, CheckStatus.OK)
_HELP = """Check everything that the gateway needs before it can drive.

Looks at the configuration and its DBC, the interface, time, permissions, buffers, process,
service, libraries and the running gateway. A line each: status, subject, finding, and
after a semicolon how to fix it. Nothing is changed and nothing is sent; run as root it checks
more. Exit code 1 where something is wrong, 0 otherwise, warnings or not.

\b
--json prints one object:
  healthy   true where nothing is wrong
  counts    how many lines are ok, warning, wrong, unknown
  findings  a list of objects: subject, check (a stable identifier), kind, what, remedy (or "")
"""


@click.command("doctor", help=_HELP)
@config_option
@click.option("--listen", is_flag=True, help="Also receive from the bus for a second.")
@json_option
def doctor(config_path: Path | None, listen: bool, as_json: bool) -> None:
    path, missing = _file(config_path)
    results = list(run_checks(path, missing, listen=listen))
    counts = Counter(result.kind for result in results)
    # Colours on a terminal alone, and not where NO_COLOR is set (no-color.org).
    colour = False if os.environ.get("NO_COLOR") else None
    click.echo(_as_json(results, counts) if as_json else _as_text(results, counts), color=colour)
    if counts[CheckStatus.WRONG]:
        sys.exit(1)


def _file(given: Path | None) -> tuple[Path | None, tuple[Problem, ...]]:
    try:
        return resolve_config(given), ()
    except MissingInputError as error:
        return None, error.problems


def _as_json(results: list[CheckResult], counts: Counter[CheckStatus]) -> str:
    document = {
        "healthy": not counts[CheckStatus.WRONG],
        "counts": {kind.value: counts[kind] for kind in CheckStatus},
        "findings": [{**result._asdict(), "kind": result.kind.value} for result in results],
    }
    return json.dumps(document, ensure_ascii=False)


def _as_text(results: list[CheckResult], counts: Counter[CheckStatus]) -> str:
    width = max((len(result.subject) for result in results), default=0)
    return "\n".join([*(_line(result, width) for result in results), _summary(counts)])


def _line(result: CheckResult, width: int) -> str:
    kind = click.style(f"{result.kind.value:<7}", fg=_COLOURS[result.kind])
    remedy = f"; {result.remedy}" if result.remedy else ""
    return f"{kind}  {result.subject:<{width}}  {result.what}{remedy}"


def _summary(counts: Counter[CheckStatus]) -> str:
    summary = ", ".join(_counted(kind, counts[kind]) for kind in _SEVEREST_FIRST if counts[kind])
    more = counts[CheckStatus.UNKNOWN] and os.geteuid() != 0
    return summary + ("; sudo vcu-gateway doctor checks more" if more else "")


def _counted(kind: CheckStatus, count: int) -> str:
    plural = "s" if kind is CheckStatus.WARNING and count > 1 else ""
    return f"{count} {kind.value}{plural}"
