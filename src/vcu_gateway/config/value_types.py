"""Kinds of value in the configuration, and what every section has in common."""

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer
from pydantic_core import PydanticCustomError

from vcu_gateway.core.j1939 import ID_MASK

_SOCKET_PATH_BYTES = 107

REFUSED = "refused"
"""The error type of our own refusals; their context holds `requirement` and `remedy`."""


def refusal(requirement: str, remedy: str = "") -> PydanticCustomError:
    """The error of a key that does not meet this requirement ("must be ...")."""
    context: dict[str, Any] = {"requirement": requirement, "remedy": remedy}
    return PydanticCustomError(REFUSED, "{requirement}", context)


def _fits_29_bits(identifier: int) -> int:
    if identifier > ID_MASK:
        remedy = f"bit 29 cannot exist on the wire: write 0x{identifier & ID_MASK:08X} (errata E2)"
        raise refusal(f"must be an identifier of 29 bits, at most 0x{ID_MASK:08X}", remedy)
    return identifier


def _as_hexadecimal(identifier: int) -> str:
    return f"0x{identifier:08X}"


def _confirmed(value: object) -> object:
    if value is not True:
        raise refusal("must be true", "it confirms that the wheels are off the ground")
    return value


def _absolute(path: str) -> str:
    if not path.startswith("/") or "\0" in path:
        raise refusal("must be an absolute path", "such as /run/vcu-gateway/control.sock")
    if len(path.encode("utf-8", "surrogateescape")) > _SOCKET_PATH_BYTES:
        raise refusal(f"must be at most {_SOCKET_PATH_BYTES} bytes long, as the kernel has it")
    return path


def _octal(mode: str) -> str:
    if not re.fullmatch(r"0?[0-7]{3}", mode):
        raise refusal("must be three octal digits", 'such as "0660"')
    return mode


Identifier = Annotated[
    int,
    Field(ge=0),
    AfterValidator(_fits_29_bits),
    PlainSerializer(_as_hexadecimal, return_type=str, when_used="json"),
]
Confirmation = Annotated[bool, BeforeValidator(_confirmed)]
MessageName = Annotated[str, Field(min_length=1)]
StatusCode = Annotated[int, Field(ge=0, le=0xFFFF)]
AgeMs = Annotated[int, Field(ge=1, le=60_000)]
SourceName = Annotated[str, Field(min_length=1, max_length=64)]
Priority = Annotated[int, Field(ge=0, le=100)]
File = Annotated[Path, Field(strict=False)]


SocketPath = Annotated[str, AfterValidator(_absolute)]
FileMode = Annotated[str, AfterValidator(_octal)]
UserName = Annotated[str, Field(min_length=1, max_length=64)]


class Section(BaseModel):
    """Nothing unknown, nothing coerced, nothing infinite, nothing changed afterwards."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
        field_title_generator=lambda name, _: name,
    )
