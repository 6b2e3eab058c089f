"""python-can, imported without asammdf: every import of `can` or cantools comes after this one.

Where asammdf is installed, python-can's MF4 module imports it, and with it numpy and pandas, into
every process. Here asammdf cannot be found while `can` is imported; only `mf4_reader` imports it.
"""

import importlib
import sys
from pathlib import Path

from vcu_gateway.lean_imports import hidden, put_off

__all__ = ["VERSION", "can", "mf4_reader"]


def _version(distribution: str) -> str:
    """As its folder of metadata says; ModuleNotFoundError where there is none."""
    pattern = f"{distribution.replace('-', '_')}-*.dist-info"
    found = next((one for folder in sys.path for one in Path(folder).glob(pattern)), None)
    if found is None:
        raise ModuleNotFoundError(distribution)
    return found.stem.partition("-")[2]


# wrapt is for a kind of bus that is not used here. asyncio is an annotation, for who gives the
# Notifier such a loop. The metadata of packages say this version and which other packages have
# kinds of bus, which are not used; reading them costs a tenth of a start and 2 MB.
with (
    hidden("asammdf", "wrapt"),
    put_off("asyncio", AbstractEventLoop=object),
    put_off(
        "importlib.metadata",
        PackageNotFoundError=ModuleNotFoundError,
        entry_points=lambda **_: (),
        version=_version,
    ),
):
    import can
    from can.io import mf4
    from can.io.generic import BinaryIOMessageReader

VERSION: str = getattr(can, "__version__", "unknown")


def mf4_reader() -> type[BinaryIOMessageReader]:
    """python-can's reader of MF4, with asammdf where it is installed."""
    reader: type[BinaryIOMessageReader] = importlib.reload(mf4).MF4Reader
    return reader
