"""Imports without what the gateway does not use: it starts sooner and stays smaller.

asyncio, hashlib and hmac, which libraries import, are imported here without OpenSSL: nothing in the
program uses TLS, and Python has a SHA-256 of its own. pydantic looks for no plugins: it would read
what every installed package says of itself, and run those. `run` imports this module first.
"""

import contextlib
import os
import sys
from collections.abc import Iterator


@contextlib.contextmanager
def hidden(*names: str) -> Iterator[None]:
    """Importing these modules fails as if they were not installed; those imported before stay."""
    absent = [name for name in names if name not in sys.modules]
    # None is what Python itself takes for "cannot be imported", in every thread; no gateway
    # process has begun another thread yet.
    sys.modules.update(dict.fromkeys(absent))  # type: ignore[arg-type]
    try:
        yield
    finally:
        for name in absent:
            del sys.modules[name]


with hidden("ssl", "_hashlib"):
    import asyncio  # noqa: F401 - each as the program gets it from here on
    import hashlib  # noqa: F401
    import hmac  # noqa: F401

os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
