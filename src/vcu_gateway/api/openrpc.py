"""OpenRPC 1.3 document of the API, generated from `methods` and `results`."""

from typing import Any

from pydantic import TypeAdapter

from vcu_gateway import __version__
from vcu_gateway.api import methods, results
from vcu_gateway.api.errors import ErrorCode
from vcu_gateway.api.methods import METHODS, Method

NOTIFICATION = "state.update"
_REFERENCE = "#/components/schemas/{model}"
_DOCUMENTED = {"use_attribute_docstrings": True, "extra": "forbid"}


def document() -> dict[str, Any]:
    """OpenRPC document; every schema is under `components`."""
    schemas, components = _schemas()
    return {
        "openrpc": "1.3.2",
        "info": {
            "title": "vcu-gateway",
            "version": __version__,
            "description": "JSON-RPC 2.0, one message a line, over a Unix stream socket.",
        },
        "methods": [_method(name, one, schemas) for name, one in METHODS.items()],
        "x-notifications": [
            {
                "name": NOTIFICATION,
                "summary": "One update of a subscription, from the gateway to the client.",
                "paramStructure": "by-name",
                "schema": schemas[NOTIFICATION],
            }
        ],
        "components": {"schemas": components},
    }


def result_adapter(result: type) -> TypeAdapter[Any]:
    """Validator and JSON schema of one result."""
    for one in vars(results).values():
        if isinstance(one, type) and one.__module__ == results.__name__:
            one.__pydantic_config__ = _DOCUMENTED  # type: ignore[attr-defined]  # pydantic reads it
    return TypeAdapter(result)


def _schemas() -> tuple[dict[str, Any], dict[str, Any]]:
    """Schemas of results and notification by name, and the definitions that they refer to."""
    adapters = {name: result_adapter(method.result) for name, method in METHODS.items()}
    adapters[NOTIFICATION] = result_adapter(results.Update)
    params = {f"{name} params": TypeAdapter(method.params) for name, method in METHODS.items()}
    found, described = TypeAdapter.json_schemas(
        [(name, "validation", adapter) for name, adapter in {**adapters, **params}.items()],
        ref_template=_REFERENCE,
    )
    schemas = {name: schema for (name, _), schema in found.items()}
    return schemas, described.get("$defs", {})


def _method(name: str, method: Method, schemas: dict[str, Any]) -> dict[str, Any]:
    model = method.params
    properties = model.model_json_schema(ref_template=_REFERENCE).get("properties", {})
    return {
        "name": name,
        "summary": method.summary,
        "paramStructure": "by-name",
        "params": [
            {
                "name": key,
                "required": field.is_required(),
                "description": field.description or "",
                "schema": properties[key],
            }
            for key, field in model.model_fields.items()
        ],
        "result": {"name": method.result.__name__, "schema": schemas[name]},
        "errors": [{"code": code.value, "message": code.name.lower()} for code in ErrorCode],
        "x-right": method.right.value,
        **({"x-right-service-level": "service"} if model is methods.ResetParams else {}),
    }
