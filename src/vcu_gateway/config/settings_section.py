"""Sections of the configuration made from the core's settings."""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_origin, get_type_hints

import pydantic
from pydantic import create_model

from vcu_gateway.core.settings import KEYS, Settings
from vcu_gateway.strict_yaml.section import Section


class SettingsSection(Section):
    """Section whose keys `with_settings` adds."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


_Made = TypeVar("_Made", bound=SettingsSection)


def with_settings(section: str) -> Callable[[type[_Made]], type[_Made]]:
    """Class decorator: add every key that `core.settings` has for this section, after its own."""
    hints = get_type_hints(Settings, include_extras=True)
    added: dict[str, Any] = {
        item.name: (_annotation(hints[item.name], KEYS[item.name].text), _default(item))
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
