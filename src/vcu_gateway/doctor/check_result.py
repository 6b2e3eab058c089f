"""Result of a check, one a line, and how a subject makes them."""

from collections.abc import Iterable, Iterator
from enum import Enum
from typing import NamedTuple

from vcu_gateway.errors import Problem


class CheckStatus(Enum):
    """Status of a check; only WRONG keeps the gateway from driving safely."""

    OK = "ok"
    WARNING = "warning"
    WRONG = "wrong"
    UNKNOWN = "unknown"


class CheckResult(NamedTuple):
    """Result of one check.

    Attributes:
        check: stable identifier, unique within its subject but for problems of a file.
        what: the finding, for people.
        remedy: how to fix it, a command or a step; empty where there is none.
    """

    subject: str
    check: str
    kind: CheckStatus
    what: str
    remedy: str = ""


Outcome = str | CheckResult
"""Outcome of a check: words for the line of what is ok, or a result of its own."""


class CheckSubject(NamedTuple):
    """Subject of checks, which makes their results."""

    name: str

    def ok(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """Check passed; a remedy here is a hint."""
        return CheckResult(self.name, check, CheckStatus.OK, what, remedy)

    def warning(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """It works and should be improved."""
        return CheckResult(self.name, check, CheckStatus.WARNING, what, remedy)

    def wrong(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """The gateway cannot drive, or not safely."""
        return CheckResult(self.name, check, CheckStatus.WRONG, what, remedy)

    def unknown(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """It could not be checked; `what` says why."""
        return CheckResult(self.name, check, CheckStatus.UNKNOWN, what, remedy)

    def problem(self, check: str, problem: Problem) -> CheckResult:
        where = f"{problem.where}: " if problem.where else ""
        return self.wrong(check, f"{where}{problem.what}", problem.remedy)

    def summarise(self, heading: str, outcomes: Iterable[Outcome | None]) -> Iterator[CheckResult]:
        """All that is ok in one line, then every other result; None is left out."""
        done = [one for one in outcomes if one]
        well = ", ".join(one for one in done if isinstance(one, str))
        if well:
            yield self.ok("well", f"{heading}: {well}" if heading else well)
        yield from (one for one in done if isinstance(one, CheckResult))
