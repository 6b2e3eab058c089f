"""Value types of the configuration's keys: identifiers, paths, modes and names."""

import re
from pathlib import Path
from typing import Annotated

from annotated_types import Interval, Len
from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer

from vcu_gateway.core.j1939 import ID_MASK
from vcu_gateway.strict_yaml.section import refusal

_SOCKET_PATH_BYTES = 107


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
    Field(ge=0, json_schema_extra={"maximum": ID_MASK}),
    AfterValidator(_fits_29_bits),
    PlainSerializer(_as_hexadecimal, return_type=str, when_used="json"),
]
StatusCode = Annotated[int, Interval(ge=0, le=0xFFFF)]
Confirmation = Annotated[bool, BeforeValidator(_confirmed)]
File = Annotated[Path, Field(strict=False)]
SocketPath = Annotated[str, AfterValidator(_absolute)]
FileMode = Annotated[str, AfterValidator(_octal)]
UserName = Annotated[str, Len(1, 64)]
