"""Libraries of an extra: what is said where one is not installed."""

import contextlib
from collections.abc import Iterator

from vcu_gateway.errors import Problem, UnavailableError


@contextlib.contextmanager
def needed(package: str, extra: str) -> Iterator[None]:
    """Import of a library of a second environment; UnavailableError where it is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != package:
            raise
        remedy = (
            "install it beside the gateway's environment, not into it: python3 -m venv ~/vcu-tools"
        )
        remedy += f" && ~/vcu-tools/bin/pip install 'vcu-gateway[{extra}]' (docs/install.md)"
        problem = Problem(f"writing {extra} needs the package {package}", "", remedy)
        raise UnavailableError(problem) from error
