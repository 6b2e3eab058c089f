"""Optional dependencies of the verbs: a missing extra becomes a sentence and an exit code."""

import contextlib
from collections.abc import Iterator

from vcu_gateway.errors import Problem, UnavailableError

_TUI_LIBRARIES = ("textual", "rich")


@contextlib.contextmanager
def tui_needed() -> Iterator[None]:
    """Import of the live view; UnavailableError where its libraries are not installed."""
    try:
        yield
    except ImportError as error:
        if (error.name or "").partition(".")[0] not in _TUI_LIBRARIES:
            raise
        remedy = "install the extra: pip install 'vcu-gateway[tui]'"
        raise UnavailableError(Problem(f"the live view needs {error.name}", "", remedy)) from error
