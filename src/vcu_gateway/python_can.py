"""python-can, imported without asammdf: every import of `can` or cantools comes after this one.

Where asammdf is installed, python-can's MF4 module imports it, and with it numpy and pandas, into
every process. Here asammdf cannot be found while `can` is imported; only `mf4_reader` imports it.
"""

import contextlib
import importlib
import sys
from collections.abc import Iterator

__all__ = ["can", "mf4_reader"]


@contextlib.contextmanager
def _hidden(name: str) -> Iterator[None]:
    """Importing this module fails as if it were not installed; one that was imported stays."""
    if name in sys.modules:
        yield
        return
    # None is what Python itself takes for "cannot be imported", in every thread; no gateway
    # process has begun another thread yet.
    sys.modules[name] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[name]


with _hidden("asammdf"):
    import can
    from can.io import mf4
    from can.io.generic import BinaryIOMessageReader


def mf4_reader() -> type[BinaryIOMessageReader]:
    """python-can's reader of MF4, with asammdf where it is installed."""
    reader: type[BinaryIOMessageReader] = importlib.reload(mf4).MF4Reader
    return reader
