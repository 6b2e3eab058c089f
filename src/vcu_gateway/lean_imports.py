"""Imports without what the gateway does not use: it starts sooner and stays smaller.

hashlib and hmac, which libraries import, are imported here without OpenSSL: nothing in the program
uses TLS, and Python has a SHA-256 of its own. pydantic looks for no plugins: it would read what
every installed package says of itself, and run those. `run` imports this module first.
"""

import contextlib
import importlib
import os
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any


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


@contextlib.contextmanager
def put_off(name: str, **known: Any) -> Iterator[None]:
    """Importing this module gives a stand-in with what is known; one imported before stays.

    Asked for anything else, at any time, the stand-in imports the module and has it of that.
    """
    if name in sys.modules:
        yield
        return
    stand_in = ModuleType(name)

    def from_the_module(attribute: str) -> Any:
        if attribute.startswith("__"):  # the import system asks whether there are some
            raise AttributeError(attribute)
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]
        return getattr(importlib.import_module(name), attribute)

    vars(stand_in).update(known, __getattr__=from_the_module)
    sys.modules[name] = stand_in
    try:
        yield
    finally:
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]


with hidden("ssl", "_hashlib"):
    import hashlib  # noqa: F401 - each as the program gets it from here on
    import hmac  # noqa: F401

os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
