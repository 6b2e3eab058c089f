"""python-can, imported without asammdf: every import of `can` or cantools comes after this one.

Where asammdf is installed, python-can's MF4 module imports it, and with it numpy and pandas, into
every process. Here asammdf cannot be found while `can` is imported; only `mf4_reader` imports it.
"""

import importlib

from vcu_gateway.lean_imports import hidden

__all__ = ["can", "mf4_reader"]


# wrapt is for a kind of bus that is not used here.
with hidden("asammdf", "wrapt"):
    import can
    from can.io import mf4
    from can.io.generic import BinaryIOMessageReader


def mf4_reader() -> type[BinaryIOMessageReader]:
    """python-can's reader of MF4, with asammdf where it is installed."""
    reader: type[BinaryIOMessageReader] = importlib.reload(mf4).MF4Reader
    return reader
