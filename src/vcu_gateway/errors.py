"""Errors with their problems (what, where, remedy) and exit codes.

Exit codes follow sysexits.h and are part of the interface:

    0   done
    1   a check answered no (`dbc --check`, `status --check`, `doctor`, `estop`, ...)
    2   the command line is wrong
    3   a recording is incomplete
    65  a file's contents are wrong, or a recording was changed or damaged (EX_DATAERR)
    66  a file cannot be read (EX_NOINPUT)
    69  the bus or something else outside is not there (EX_UNAVAILABLE)
    70  a bug in this program (EX_SOFTWARE)
    75  the gateway refused a request, or nobody answered or confirmed in time (EX_TEMPFAIL)
    77  this user may not ask for that (EX_NOPERM)
    78  the configuration is wrong (EX_CONFIG)
"""

import contextlib
import os
from collections.abc import Iterable, Iterator
from typing import NamedTuple


class Problem(NamedTuple):
    """One problem: `where` is file:line or empty, `remedy` the way to fix it or empty."""

    what: str
    where: str = ""
    remedy: str = ""

    def __str__(self) -> str:
        where = f"{self.where}: " if self.where else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{where}{self.what}{remedy}"


class GatewayError(Exception):
    """Base of the program's errors: problems, shown a line each, and the exit code."""

    exit_code = os.EX_SOFTWARE

    def __init__(self, *problems: Problem) -> None:
        super().__init__(*problems)
        self.problems = problems

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)


class ConfigError(GatewayError):
    """The configuration cannot be used."""

    exit_code = os.EX_CONFIG


class DataError(GatewayError):
    """A definition, DBC or recording has wrong contents."""

    exit_code = os.EX_DATAERR


class MissingInputError(GatewayError):
    """A file is not there or cannot be read."""

    exit_code = os.EX_NOINPUT


class UnavailableError(GatewayError):
    """The bus, or an optional part of the program, is not there."""

    exit_code = os.EX_UNAVAILABLE


class RequestRefusedError(GatewayError):
    """The running gateway refused a request, or did not answer."""

    exit_code = os.EX_TEMPFAIL


class NotPermittedError(GatewayError):
    """This user lacks the right to make the request."""

    exit_code = os.EX_NOPERM


@contextlib.contextmanager
def extra_needed(what: str, extra: str, *packages: str, remedy: str = "") -> Iterator[None]:
    """Import of what an extra brings; UnavailableError where one of its packages is missing.

    `what` is the beginning of the sentence that ends with the package's name.
    """
    try:
        yield
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in packages:
            raise
        remedy = remedy or f"install the extra: pip install 'vcu-gateway[{extra}]'"
        raise UnavailableError(Problem(f"{what} {error.name}", "", remedy)) from error


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The known word that is most like this one; None where none is alike enough.

    `cutoff` is the least likeness, 0 to 1. The time it takes grows with the word's length.
    """
    import difflib  # seldom needed, and not for nothing

    return next(iter(difflib.get_close_matches(word, tuple(known), n=1, cutoff=cutoff)), None)


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The question with the nearest known word; empty where none is near."""
    found = nearest(word, known, cutoff)
    return f'did you mean "{found}"?' if found else ""
