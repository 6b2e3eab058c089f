"""What the program says when it cannot go on: what, where, and what to do.

Exit codes follow sysexits.h and are part of the interface:

    0   done
    1   a check answered no (`dbc --check`, `status --check`, `doctor`)
    2   the command line is wrong
    65  a file's contents are wrong (EX_DATAERR)
    66  a file cannot be read (EX_NOINPUT)
    69  the bus or something else outside is not there (EX_UNAVAILABLE)
    70  a bug in this program (EX_SOFTWARE)
    75  the gateway refused a request, or did not answer in time (EX_TEMPFAIL)
    77  this user may not ask for that (EX_NOPERM)
    78  the configuration is wrong (EX_CONFIG)
"""

import os
from typing import NamedTuple


class Problem(NamedTuple):
    """One thing that is wrong: `where` is file:line or empty, `remedy` what to do or empty."""

    what: str
    where: str = ""
    remedy: str = ""

    def __str__(self) -> str:
        where = f"{self.where}: " if self.where else ""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{where}{self.what}{remedy}"


class GatewayError(Exception):
    """Problems to show, a line each, and the exit code that goes with them."""

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
    """The running gateway said no, or did not answer."""

    exit_code = os.EX_TEMPFAIL


class NotPermittedError(GatewayError):
    """This user has not the right."""

    exit_code = os.EX_NOPERM
