"""Strict base of every model of a file, and the error of a value that it refuses."""

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError

REFUSED = "refused"
"""The error type of our own refusals; their context holds `requirement` and `remedy`."""


def refusal(requirement: str, remedy: str = "") -> PydanticCustomError:
    """The error of a key that does not meet this requirement ("must be ...")."""
    context: dict[str, Any] = {"requirement": requirement, "remedy": remedy}
    return PydanticCustomError(REFUSED, "{requirement}", context)


class Section(BaseModel):
    """Strict model: nothing unknown, coerced or infinite, and nothing changed afterwards.

    Attributes:
        removed: keys of earlier versions, each with what to do instead.
        outline: what a file must be that this is the model of.
    """

    removed: ClassVar[Mapping[str, str]] = {}
    outline: ClassVar[str] = "must be a mapping, key: value in each line"

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
        field_title_generator=lambda name, _: name,
    )
