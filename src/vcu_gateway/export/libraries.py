"""Libraries of an extra: what is said where one is not installed."""

from contextlib import AbstractContextManager

from vcu_gateway.errors import extra_needed


def needed(package: str, extra: str) -> AbstractContextManager[None]:
    """Import of a library of a second environment; UnavailableError where it is not installed."""
    remedy = (
        "install it beside the gateway's environment, not into it: python3 -m venv ~/vcu-tools"
        f" && ~/vcu-tools/bin/pip install 'vcu-gateway[{extra}]' (docs/install.md)"
    )
    return extra_needed(f"writing {extra} needs the package", extra, package, remedy=remedy)
