"""Protocol: definition file -> specification -> DBC -> specification."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

_DATA = Path(__file__).parents[1] / "data"

DEFAULT_ALIASES: Mapping[int, str] = MappingProxyType({0x08F02DE2: "IMU_Attitude"})
"""Further identifiers that are received as a message, unless configured (docs/protocol.md E3)."""


def packaged(name: str) -> Path:
    """A file that ships with the program, such as vcu.dbc."""
    return _DATA / name
