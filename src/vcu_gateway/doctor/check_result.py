"""What an examination says: one thing a line."""

from collections.abc import Iterable, Iterator
from enum import Enum
from typing import NamedTuple


class CheckStatus(Enum):
    """How it is; only WRONG keeps the gateway from driving safely."""

    OK = "ok"
    WARNING = "warning"
    WRONG = "wrong"
    UNKNOWN = "unknown"


class CheckResult(NamedTuple):
    """One thing that was looked at.

    Attributes:
        check: stable word for machines, unique within its subject but for problems of a file.
        what: what was found, as a person reads it.
        remedy: the command or the step that mends it; empty where there is none to take.
    """

    subject: str
    check: str
    kind: CheckStatus
    what: str
    remedy: str = ""


Outcome = str | CheckResult
"""A check's answer: a few words for the line of what is well, or a finding of its own."""


class CheckSubject(NamedTuple):
    """Makes the findings of one subject."""

    name: str

    def ok(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """It is as it should be; a remedy here is a hint."""
        return CheckResult(self.name, check, CheckStatus.OK, what, remedy)

    def warning(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """It works, and should be otherwise."""
        return CheckResult(self.name, check, CheckStatus.WARNING, what, remedy)

    def wrong(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """The gateway cannot drive, or not safely."""
        return CheckResult(self.name, check, CheckStatus.WRONG, what, remedy)

    def unknown(self, check: str, what: str, remedy: str = "") -> CheckResult:
        """It could not be found out; `what` says why."""
        return CheckResult(self.name, check, CheckStatus.UNKNOWN, what, remedy)

    def summed(self, opening: str, told: Iterable[Outcome | None]) -> Iterator[CheckResult]:
        """All that is well in one line, then every finding; None says nothing."""
        answers = [one for one in told if one]
        well = ", ".join(one for one in answers if isinstance(one, str))
        if well:
            yield self.ok("well", f"{opening}: {well}" if opening else well)
        yield from (one for one in answers if isinstance(one, CheckResult))
