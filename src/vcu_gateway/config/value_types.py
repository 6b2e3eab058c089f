"""Value types of the configuration's keys, and sections made from the core's settings."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_origin, get_type_hints

import pydantic
from annotated_types import Interval, Len
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainSerializer,
    WithJsonSchema,
    create_model,
)

from vcu_gateway.core.j1939 import ID_MASK
from vcu_gateway.core.settings import KEYS, Settings
from vcu_gateway.strict_yaml.validation import Section, refusal

_SOCKET_PATH_BYTES = 107
_MODE = "^0?[0-7]{3}$"
_LEAST_MODE = 600  # without quotes: the owner reads and writes
_MODE_SCHEMA = {
    "anyOf": [
        {"type": "string", "pattern": _MODE},
        # 0660 without quotes is 660 to some editors, and 432 to others.
        {"type": "integer", "exclusiveMinimum": -1, "exclusiveMaximum": 778},
    ]
}


def _fits_29_bits(identifier: int) -> int:
    if identifier > ID_MASK:
        remedy = f"bit 29 cannot exist on the wire: write 0x{identifier & ID_MASK:08X} (errata E2)"
        raise refusal(f"must be an identifier of 29 bits, at most 0x{ID_MASK:08X}", remedy)
    return identifier


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


def _octal(mode: object) -> object:
    """As text; 660 without quotes is a whole number, and 432, which others make of 0660, is not."""
    digits = str(mode) if type(mode) is int and mode >= _LEAST_MODE else mode
    if not (isinstance(digits, str) and re.fullmatch(_MODE, digits)):
        quotes = "" if isinstance(mode, str) else " in quotes"
        raise refusal(f"must be three octal digits{quotes}", 'such as "0660"')
    return digits


Identifier = Annotated[
    int,
    Field(ge=0, json_schema_extra={"maximum": ID_MASK}),
    AfterValidator(_fits_29_bits),
    PlainSerializer(lambda identifier: f"0x{identifier:08X}", return_type=str, when_used="json"),
]
StatusCode = Annotated[int, Interval(ge=0, le=0xFFFF)]
Confirmation = Annotated[bool, BeforeValidator(_confirmed)]
File = Annotated[Path, Field(strict=False)]
SocketPath = Annotated[str, AfterValidator(_absolute)]
FileMode = Annotated[str, BeforeValidator(_octal), WithJsonSchema(_MODE_SCHEMA)]
UserName = Annotated[str, Len(1, 64)]
UserNames = Annotated[tuple[UserName, ...], Field(strict=False)]  # YAML has lists, no tuples


class SettingsSection(Section):
    """Section whose keys `with_settings` adds."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


_Made = TypeVar("_Made", bound=SettingsSection)
_HINTS = get_type_hints(Settings, include_extras=True)


def with_settings(section: str) -> Callable[[type[_Made]], type[_Made]]:
    """Class decorator: add every key that `core.settings` has for this section, after its own."""
    added: dict[str, Any] = {
        item.name: (_annotation(_HINTS[item.name], KEYS[item.name].text), _default(item))
        for item in dataclasses.fields(Settings)
        if item.name in KEYS and KEYS[item.name].section == section
    }

    def made(own: type[_Made]) -> type[_Made]:
        return create_model(
            own.__name__, __base__=own, __module__=own.__module__, __doc__=own.__doc__, **added
        )

    return made


def _annotation(hint: Any, text: str) -> Any:
    # YAML has lists, no tuples.
    strict = False if get_origin(hint.__origin__) is tuple else None
    return Annotated[hint, pydantic.Field(description=text, strict=strict)]


def _default(item: dataclasses.Field[Any]) -> Any:
    return item.default if item.default_factory is dataclasses.MISSING else item.default_factory()
