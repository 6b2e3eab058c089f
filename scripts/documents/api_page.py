"""Generated part of docs/api.md: every method and type, from the OpenRPC document."""

from collections.abc import Iterator, Mapping
from typing import Any

from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.api.methods import METHODS

BEGIN, END = "<!-- generated: scripts/documents -->\n", "<!-- end of what is generated -->\n"

_PARAMS_MODELS = {method.params.__name__ for method in METHODS.values()}
"""Described with their methods, so not again among the types."""
_RIGHTS = {
    "read": "everybody who can open the socket",
    "operate": "operators",
    "service": "service",
}
_ERRORS: Mapping[ErrorCode, str] = {
    ErrorCode.PARSE_ERROR: "The line is not JSON, or not what is accepted of it.",
    ErrorCode.INVALID_REQUEST: "JSON, but no request.",
    ErrorCode.METHOD_NOT_FOUND: "There is no such method; the nearest is named.",
    ErrorCode.INVALID_PARAMS: "The parameters are not the method's.",
    ErrorCode.INTERNAL_ERROR: "A bug in the gateway.",
    ErrorCode.NO_RIGHT: "The peer's user may not do this.",
    ErrorCode.REFUSED: "Not now, or not this: `data.refusal` is a word for programs.",
    ErrorCode.TOO_MANY_CLIENTS: "Every place has a fresh demand; the connection is closed.",
    ErrorCode.NOT_READY: "The gateway is starting, ending or busy; try again.",
    ErrorCode.CONFIG_REFUSED: (
        "Nothing was changed; `data.problems` has a sentence for each reason."
    ),
}


def within(text: str, document: Mapping[str, Any]) -> str:
    """The page with its generated part, from BEGIN to END, made from this document."""
    before, after = text.partition(BEGIN)[0], text.partition(END)[2]
    return "".join([before, *_lines(document), after])


def _lines(document: Mapping[str, Any]) -> Iterator[str]:
    yield BEGIN
    yield "\n## Methods\n"
    for method in document["methods"]:
        yield from _method(method)
    for notification in document["x-notifications"]:
        yield f"\n### Notification `{notification['name']}`\n"
        yield f"\n{notification['summary']} Parameters: {_type(notification['schema'])}.\n"
    yield "\n## Errors\n\n| code | word | meaning |\n| --- | --- | --- |\n"
    for code in ErrorCode:
        yield f"| {code.value} | `{code.name.lower()}` | {_ERRORS[code]} |\n"
    yield "\n## Types\n"
    for name, schema in document["components"]["schemas"].items():
        if name not in _PARAMS_MODELS:
            yield from _named_type(name, schema)
    yield "\n"
    yield END


def _method(method: Mapping[str, Any]) -> Iterator[str]:
    yield f"\n### `{method['name']}`\n"
    right = _RIGHTS[method["x-right"]]
    level = "; at service level: service" if "x-right-service-level" in method else ""
    result = _type(method["result"]["schema"])
    yield f"\n{method['summary']} For: {right}{level}. Result: {result}.\n"
    if method["params"]:
        yield "\n| parameter | type | |\n| --- | --- | --- |\n"
    for param in method["params"]:
        default = "required" if param["required"] else f"default `{_json(param['schema'])}`"
        meaning = f"{param['description']} " if param["description"] else ""
        yield f"| `{param['name']}` | {_type(param['schema'])} | {meaning}({default}) |\n"


def _named_type(name: str, schema: Mapping[str, Any]) -> Iterator[str]:
    yield f"\n### {name}\n\n{schema.get('description', '').strip()}\n"
    yield "\n| field | type | |\n| --- | --- | --- |\n"
    required = schema.get("required", [])
    for key, field in schema["properties"].items():
        meaning = " ".join(field.get("description", "").split())
        absent = "" if key in required else " May be absent."
        yield f"| `{key}` | {_type(field)} | {meaning}{absent} |\n"


def _type(schema: Mapping[str, Any]) -> str:
    """Schema in a few words; a named type as a link."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(_type(one) for one in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{_json({'default': schema['const']})}`"
    kind = schema.get("type", "any")
    if kind == "array":
        return f"list of {_type(schema['items'])}"
    if kind == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"object of {_type(schema['additionalProperties'])}"
    return str(kind)


def _json(schema: Mapping[str, Any]) -> str:
    words = {None: "null", True: "true", False: "false"}
    default = schema.get("default")
    known = default is None or isinstance(default, bool)
    return words[default] if known else str(default)
