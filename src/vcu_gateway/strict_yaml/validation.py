"""Validation against a model: pydantic's errors as problems in plain words, with a remedy.

Strict base of every model of a file, and the error of a value that it refuses.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from types import UnionType
from typing import Any, ClassVar, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError, create_model
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from vcu_gateway.errors import did_you_mean, nearest
from vcu_gateway.lean_imports import put_off
from vcu_gateway.strict_yaml.file_text import FileProblem, shown
from vcu_gateway.strict_yaml.file_text import KeyPath as Path
from vcu_gateway.strict_yaml.parser import YamlDocument

# pydantic looks for plugins in the metadata of packages when it makes its first model.
with put_off("importlib.metadata", entry_points=lambda **_: ()):
    create_model("First")

REFUSED = "refused"
"""The error type of our own refusals; their context is what `refusal` was given."""


def refusal(
    requirement: str, remedy: str = "", *, place: Path = (), complete: bool = False
) -> PydanticCustomError:
    """The error of a key that does not meet this requirement ("must be ...").

    `place` leads on to an item of the key's value; a `complete` requirement says itself what was
    given instead.
    """
    context: dict[str, Any] = {
        "requirement": requirement,
        "remedy": remedy,
        "place": place,
        "complete": complete,
    }
    return PydanticCustomError(REFUSED, "{requirement}", context)


class Section(BaseModel):
    """Strict model: nothing unknown, coerced or infinite, and nothing changed afterwards.

    Attributes:
        removed: keys of earlier versions, each with what to do instead.
        outline: what a file must be that this is the model of.
        alike: keys made of the same words, here or in other sections: an unknown key is answered
            with all that it may mean, and with none where what it means is not here.
    """

    removed: ClassVar[Mapping[str, str]] = {}
    alike: ClassVar[tuple[str, ...]] = ()
    outline: ClassVar[str] = "must be a mapping, key: value in each line"

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        validate_default=True,
        field_title_generator=lambda name, _: name,
    )


_Model = TypeVar("_Model", bound=Section)

_UNITS = {
    "rpm_per_kmh": "rpm per km/h",
    "bit_s": "bit/s",
    "bytes": "bytes",
    "ms": "ms",
    "pct": "%",
    "pct_per_s": "%/s",
    "w_per_s": "W/s",
    "rpm_per_s": "rpm/s",
    "kmh": "km/h",
    "rpm": "rpm",
    "w": "W",
    "s": "s",
}
_KEY = "[key]"
_MOST_FINDINGS = 500
_MUCH_ALIKE = 0.7
_A_LIST = "must be a list, - item in each line"
_KEY_AND_VALUE = "write `key: value`, with a space after the colon"
_SWITCH_WORDS = {"yes": "true", "on": "true", "no": "false", "off": "false"}
_STARTS_LIKE_NUMBER = re.compile(r"\s*[-+]?\.?[0-9]")


def validated(
    model: type[_Model], value: Any, context: Mapping[str, Any] | None = None
) -> tuple[_Model | None, list[FileProblem]]:
    """The value as this model, or None and what it refuses.

    `context` is what the model's own validators are told.
    """
    try:
        return model.model_validate(value, context=context), []
    except ValidationError as error:
        return None, list(_findings(error, model))


def validated_document(
    model: type[_Model], document: YamlDocument
) -> tuple[_Model | None, list[FileProblem]]:
    """A document as this model, or None; and everything that is wrong with it, each key once."""
    findings = list(document.findings)
    if not document.is_yaml:
        return None, findings
    value, refused = validated(model, document.value)
    known = {finding.path for finding in findings}
    return value, findings + [finding for finding in refused if finding.path not in known]


def _findings(error: ValidationError, root: type[Section]) -> Iterator[FileProblem]:
    """A finding for each thing that pydantic refused; the rest of very many is counted."""
    refused = error.errors(include_url=False)
    for details in refused[:_MOST_FINDINGS]:
        yield _finding(details, root)
    if rest := refused[_MOST_FINDINGS:]:
        yield FileProblem(rest[0]["loc"], f"from here on {len(rest)} more errors, not shown")


def unit(name: str) -> str:
    """The unit that a key's name ends in, as people write it; empty where there is none."""
    ends = (text for suffix, text in _UNITS.items() if name.endswith(f"_{suffix}"))
    return next(ends, "")


def _finding(details: ErrorDetails, root: type[Section]) -> FileProblem:
    path, kind = details["loc"], details["type"]
    if kind in ("extra_forbidden", "invalid_key"):
        return FileProblem(path, "unknown key", _remedy_for_unknown(path, root))
    field, _ = _at(path, root)
    if kind == "missing":
        return FileProblem(path, "is missing", _lower_first(field.description if field else None))
    requirement = _requirement(details, field) if path else root.outline
    if path[-1:] == (_KEY,):
        return FileProblem(path[:-1], f"the key {requirement}", _own_remedy(details))
    own: Mapping[str, Any] = details.get("ctx", {}) if kind == REFUSED else {}
    if own.get("complete"):
        return FileProblem((*path, *own["place"]), requirement, _own_remedy(details))
    of_items = kind == REFUSED and isinstance(details["input"], list | tuple)
    what = requirement if of_items else f"{requirement}, not {shown(details['input'])}"
    return FileProblem(path, what, _own_remedy(details) or _remedy(details, field))


def _at(path: Path, root: type[Section]) -> tuple[FieldInfo | None, type[Section] | None]:
    """The field that a path leads to, and the section that it holds.

    No field where the path leads into a mapping or a list, neither where it leads nowhere.
    """
    kind: Any = root
    field = None
    for name in path:
        section = section_of(kind)
        field = section.model_fields.get(str(name)) if section else None
        if section and field is None:
            return None, None
        kind = field.annotation if field else _item_of(kind)
    return field, section_of(kind)


def section_of(kind: Any) -> type[Section] | None:
    """The section that a field of this annotation holds (or may hold), if any."""
    candidates = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    return next((c for c in candidates if isinstance(c, type) and issubclass(c, Section)), None)


def _item_of(kind: Any) -> Any:
    """The type of a mapping's values or a list's items; None for anything else."""
    return get_args(kind)[-1] if get_origin(kind) in (dict, list, Mapping) else None


def _unit_at(path: Path) -> str:
    """The unit of a key, and of every value in it where it is a mapping."""
    return next((text for name in path if (text := unit(str(name)))), "")


def _requirement(details: ErrorDetails, field: FieldInfo | None) -> str:
    context: Mapping[str, Any] = details.get("ctx", {})
    written_unit = _unit_at(details["loc"])
    after = f" {written_unit}" if written_unit else ""
    in_unit = f" in {written_unit}" if written_unit else ""
    wordings: dict[str, Callable[[], str]] = {
        REFUSED: lambda: str(context["requirement"]),
        "int_type": lambda: f"must be a whole number{in_unit}",
        "float_type": lambda: f"must be a number{in_unit}",
        "finite_number": lambda: f"must be a finite number{in_unit}",
        "bool_type": lambda: "must be true or false",
        "string_type": lambda: "must be text",
        "path_type": lambda: "must be the path of a file",
        "string_too_short": lambda: "must not be empty",
        "literal_error": lambda: f"must be one of {', '.join(_choices(field))}",
        "greater_than": lambda: f"must be more than {_number(context['gt'])}{after}",
        "greater_than_equal": lambda: f"must be at least {_number(context['ge'])}{after}",
        "less_than_equal": lambda: f"must be at most {_number(context['le'])}{after}",
        "dict_type": lambda: "must be a mapping, key: value in each line",
        "list_type": lambda: _A_LIST,
        "tuple_type": lambda: _A_LIST,
        "model_type": lambda: "must be a section with keys below it",
    }
    return wordings[details["type"]]() if details["type"] in wordings else details["msg"]


def _number(limit: float) -> str:
    return str(int(limit)) if float(limit).is_integer() else str(limit)


def _choices(field: FieldInfo | None) -> tuple[str, ...]:
    return tuple(map(str, get_args(field.annotation))) if field else ()


def _own_remedy(details: ErrorDetails) -> str:
    return str(details.get("ctx", {}).get("remedy", ""))


def _remedy(details: ErrorDetails, field: FieldInfo | None) -> str:
    value, kind = details["input"], details["type"]
    if value is None:
        return _remedy_for_empty(kind, field) if details["loc"] else ""
    if kind in ("string_type", "path_type") and isinstance(value, int | float):
        return "put it in quotes"
    if not isinstance(value, str):
        return ""
    if kind == "bool_type" and value.lower() in _SWITCH_WORDS:
        return f"write {_SWITCH_WORDS[value.lower()]}"
    if kind in ("int_type", "float_type") and _STARTS_LIKE_NUMBER.match(value):
        return "write the plain number, without quotes, unit or leading zeros"
    if kind == "literal_error":
        return did_you_mean(value, _choices(field))
    return _KEY_AND_VALUE if kind == "model_type" else ""


def _remedy_for_empty(kind: str, field: FieldInfo | None) -> str:
    if kind == "model_type":
        return "remove the line, or write keys below it"
    if kind == "dict_type":
        return "write {} for none, or remove the line for the default"
    if field is None or field.is_required():
        return ""
    return f"remove the line for the default, which is {shown(field.default)}"


def _remedy_for_unknown(path: Path, root: type[Section]) -> str:
    *parents, key = path
    _, known = _at(tuple(parents), root)
    names = tuple(known.model_fields) if known else ()
    if known and key in known.removed:
        return known.removed[str(key)]
    if ":" in str(key):
        return _KEY_AND_VALUE
    alike = known.alike if known else ()
    if not alike and (near := did_you_mean(str(key), names)):
        return near
    meant = [name for name in _meant(str(key), alike) if name in names]
    if not meant and key not in alike:
        meant = [place for place in _places(root, "") if place.endswith(f".{key}")]
    if meant:
        *others, last = (f'"{name}"' for name in meant)
        return f"did you mean {', '.join(others)}{' or ' if others else ''}{last}?"
    return f"the keys here are {', '.join(names)}"


def _meant(key: str, known: tuple[str, ...]) -> list[str]:
    """The known keys with these words, whole or shortened; else the one that is much like it."""
    words = key.split("_")
    if key in known:
        return [key]
    if same := [one for one in known if all(f"_{word}" in f"_{one}" for word in words)]:
        return same
    near = nearest(key, known, cutoff=_MUCH_ALIKE)
    return [] if near is None else [near]


def _places(model: type[Section], prefix: str) -> Iterator[str]:
    for name, field in model.model_fields.items():
        yield prefix + name
        section = section_of(field.annotation)
        if section is not None:
            yield from _places(section, f"{prefix}{name}.")


def _lower_first(text: str | None) -> str:
    return text[0].lower() + text[1:].removesuffix(".") if text else ""
