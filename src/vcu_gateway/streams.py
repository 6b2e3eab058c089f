"""The standard streams at the end of the program."""

import os
import sys


def flush() -> None:
    """Flush stdout and stderr, or drop what cannot be written.

    Else Python tries it again after the last line of the program, fails and makes the exit code
    120 of whatever it was.
    """
    for stream in (sys.stdout, sys.stderr):
        if stream is None:  # closed before the program began
            continue
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
