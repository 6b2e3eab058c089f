"""config/gateway.yaml: every key at its default, with its text, unit, default and range.

Generated from the model, for people who write a configuration:

    # Limits of every command, whoever asks.
    limits:
      # Largest SpeedLimit that is ever sent to a motor controller.
      # Unit rpm; default 12000; minimum 500; maximum 12000; live, while active only a smaller
      # value.
      speed_limit_max_rpm: 12000

A key whose default is null is commented out and shows its example, and so are the whole sections of
the tuning, of the pedals and of the test bench.
"""

import json
import re
import textwrap
from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, TypeAdapter
from pydantic.fields import FieldInfo

from vcu_gateway.config.model import Config
from vcu_gateway.config.tuning import TUNING_SECTIONS
from vcu_gateway.core.settings import KEYS, Reload
from vcu_gateway.strict_yaml import parser, validation

_COLUMNS = 97
_INDENT = "  "
_CURVE = "by_"
_COMMENTED_OUT = (*TUNING_SECTIONS, "pedals", "bench")
_UNQUOTED = re.compile(r"[A-Za-z/]")  # what begins otherwise is not text to every reader of YAML

_HEAD = """\
# vcu-gateway configuration, every key at its default.
#
#   vcu-gateway check-config -c FILE   says what is wrong with a changed file
#   vcu-gateway schema                 prints the JSON Schema, for editors
#
# A key that is left out has its default. An unknown key, a wrong type or a value out of range
# is refused and nothing starts. The last word of a number's name is its unit.
#
# A running gateway takes changes of the keys marked live, by `vcu-gateway reload` or `systemctl
# reload`; a change of any other key needs a restart.
"""


def text() -> str:
    """The file's contents."""
    sections = {name: _section(field) for name, field in Config.model_fields.items()}
    ordered = sorted(sections.items(), key=lambda item: item[0] in _COMMENTED_OUT)
    parts = [_head(section) + _lines(name, section) for name, section in ordered]
    return "\n".join([_HEAD, *("\n".join([*lines, ""]) for lines in parts)])


def _section(field: FieldInfo) -> type[BaseModel]:
    section = validation.section_of(field.annotation)
    if section is None:
        raise TypeError(f"the configuration holds sections only, not {field}")
    return section


def _lines(name: str, section: type[BaseModel]) -> list[str]:
    """A section's keys, commented out where it is a whole."""
    if name not in _COMMENTED_OUT:
        return _keys(name, section)
    return [f"#{line}" for line in _keys(name, section, commented_out=True)]


def _head(section: type[BaseModel]) -> list[str]:
    return _comment(section.__doc__ or "", "")


def _comment(words: str, indent: str) -> list[str]:
    lead = f"{indent}# "
    return textwrap.wrap(
        " ".join(words.split()),
        _COLUMNS,
        initial_indent=lead,
        subsequent_indent=lead,
        break_long_words=False,
        break_on_hyphens=False,
    )


def _keys(
    name: str,
    section: type[BaseModel],
    indent: str = "",
    *,
    commented_out: bool = False,
    example: Mapping[str, Any] | None = None,
) -> list[str]:
    """A section's name and its keys below it, the sections within it last.

    `example` has the values of a section whose keys are shown with others than their own examples.
    """
    fields = section.model_fields.items()
    ordered = sorted(fields, key=lambda item: validation.section_of(item[1].annotation) is not None)
    own = example or {}
    blocks = [
        _key(key, field, section, indent + _INDENT, commented_out, own.get(key))
        for key, field in ordered
    ]
    lines = [line for block in blocks for line in ("", *block)]
    return [f"{indent}{name}:", *lines[1:]]


def _key(
    name: str,
    field: FieldInfo,
    section: type[BaseModel],
    indent: str,
    commented_out: bool,
    given: Any,
) -> list[str]:
    default = None if field.is_required() else _json_default(name, section)
    comment = _comment(field.description or "", indent)
    within = validation.section_of(field.annotation)
    if within is None or default is None:
        facts = "; ".join(_facts(name, field, default))
        comment += _comment(f"{facts[0].upper()}{facts[1:]}.", indent)
    (example,) = [given] if given is not None else field.examples or [None]
    if within:
        return comment + _keys(name, within, indent, commented_out=commented_out, example=example)
    if default is None or (commented_out and field.examples):
        mark = "" if field.is_required() or commented_out else "#"
        return [*comment, f"{indent}{mark}{name}: {_flow(example)}"]
    return comment + _assignment(name, default, indent)


def _assignment(name: str, value: Any, indent: str) -> list[str]:
    if isinstance(value, dict) and value:
        lines = [f"{indent}{_INDENT}{key}: {_flow(one)}" for key, one in value.items()]
        return [f"{indent}{name}:", *lines]
    return [f"{indent}{name}: {_flow(value)}"]


def _facts(name: str, field: FieldInfo, default: Any) -> Iterator[str]:
    """Unit, default, choices, range and reload rule, as far as the key has them."""
    if (unit := validation.unit(name)) and not name.startswith(_CURVE):
        yield f"unit {unit}"
    if field.is_required():
        yield "required"
    else:
        yield f"default {_flow(default)}"
    extra = field.json_schema_extra
    if isinstance(extra, dict) and extra.get("const") is True:
        yield "must be true"
        return
    if words := _choices(field.annotation):
        yield f"one of {', '.join(words)}"
    yield from _ranges(field)
    if (key := KEYS.get(name)) and key.reload is not Reload.NEVER:
        yield key.reload.value


def _choices(kind: Any) -> tuple[str, ...]:
    if kind is bool:
        return "true", "false"
    return get_args(kind) if get_origin(kind) is Literal else ()


def _json_default(name: str, section: type[BaseModel]) -> Any:
    """A key's default as JSON has it: identifiers are hexadecimal text."""
    values = section.model_construct().model_dump(mode="json", include={name}, warnings=False)
    return values[name]


def _ranges(field: FieldInfo) -> Iterator[str]:
    """Lowest and highest value of a number, or of a mapping's keys and values."""
    if get_origin(field.annotation) is Mapping:
        for which, kind in zip(("keys", "values"), get_args(field.annotation), strict=True):
            yield from (f"{which}: {limits}" for limits in _range(kind))
    elif not validation.section_of(field.annotation):
        yield from _range(field.rebuild_annotation())


def _range(kind: Any) -> Iterator[str]:
    adapter: TypeAdapter[Any] = TypeAdapter(kind)
    schema = adapter.json_schema()
    for one in (schema, *schema.get("anyOf", ())):
        if "minimum" in one:
            ends = [adapter.dump_python(one[end], mode="json") for end in ("minimum", "maximum")]
            yield "minimum {}; maximum {}".format(*(_flow(end).strip('"') for end in ends))


def _flow(value: Any) -> str:
    """A value on one line, as the file's reader understands it."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_flow(one)}' for key, one in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_flow, value))}]"
    if isinstance(value, str) and _UNQUOTED.match(value) and parser.plain(value) == value:
        return value
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return json.dumps(value)
