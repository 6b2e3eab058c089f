"""Result of a check, one a line, how a subject makes them, and the small files they read."""

import os
from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from typing import NamedTuple, TypeVar

from vcu_gateway.errors import Problem

Found = TypeVar("Found")


class Unreadable(NamedTuple):
    """A fact that could not be read, and why."""

    reason: str


def text(path: str) -> str | Unreadable:
    """The file's text, stripped."""
    try:
        with open(path, encoding="utf-8", errors="replace") as file:
            return file.read().strip()
    except OSError as error:
        return unreadable(path, error)


def number(path: str) -> int | Unreadable:
    """The file's content as a natural number."""
    found = text(path)
    if isinstance(found, Unreadable):
        return found
    return int(found) if found.isdecimal() else Unreadable(f"{path} holds no number")


def fields(path: str) -> dict[str, str] | Unreadable:
    """The lines `name: value` of a file."""
    found = text(path)
    if isinstance(found, Unreadable):
        return found
    pairs = (line.partition(":") for line in found.splitlines())
    return {name.strip(): value.strip() for name, _, value in pairs}


def existing(path: str, look: Callable[[str], Found]) -> Found | Unreadable | None:
    """What `look` finds at the path; None where nothing is there."""
    try:
        return look(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        return unreadable(path, error)


def unreadable(what: str, error: OSError) -> Unreadable:
    return Unreadable(f"{what}: {error.strerror or error}")


def names(folder: str) -> list[str]:
    """Names in a folder, sorted; empty where it cannot be listed."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []


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
        return self.wrong(check, str(problem._replace(remedy="")), problem.remedy)

    def summarise(self, heading: str, outcomes: Iterable[Outcome | None]) -> Iterator[CheckResult]:
        """All that is ok in one line, then every other result; None is left out."""
        done = [one for one in outcomes if one]
        well = ", ".join(one for one in done if isinstance(one, str))
        if well:
            yield self.ok("well", f"{heading}: {well}" if heading else well)
        yield from (one for one in done if isinstance(one, CheckResult))
