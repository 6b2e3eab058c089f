"""JSON-RPC 2.0 codec, without sockets: a line to a request, a result to a line.

`parse` raises nothing, whatever the bytes; its cost is bounded for any line of 64 KiB.

Requests to stop the vehicle: which they are, also malformed, and what they overtake.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from pydantic import ValidationError

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.api.methods import METHODS, ControllerParams, Params
from vcu_gateway.errors import nearest as nearest_word

STOPS = frozenset({"estop", "disarm"})
"""Methods that are never refused to a peer."""

OVERTAKEN = frozenset({"arm", "reset", "demand.set"})
"""Methods that are refused where a stop passed over them on their connection,"""

OVERTAKEN_WORD = "overtaken"
"""with this word as `data.refusal`."""

MARKS = (*(name.encode() for name in sorted(STOPS)), b"\\u")
"""One of these stands in every line that names a stop."""


def stop_named(line: bytes) -> str | None:
    """Stop named by a line that `jsonrpc.parse` refuses; None where it names none.

    A JSON object, alone or alone in a list, whose every member `method` is the same one of `STOPS`,
    however wrong the rest.
    """
    if not any(mark in line for mark in MARKS):  # costs a hundredth of reading
        return None
    try:
        members = json.loads(
            line.decode("utf-8-sig", "replace"),
            object_pairs_hook=_Members,
            parse_int=str,  # of any length
            strict=False,
        )
    except (ValueError, RecursionError):
        return None
    if isinstance(members, list) and len(members) == 1:
        members = members[0]
    if not isinstance(members, _Members):
        return None
    methods = [value for name, value in members if name == "method"]
    named = next((stop for stop in STOPS if methods and methods[0] == stop), None)
    return named if methods.count(named) == len(methods) else None


class _Members(tuple[tuple[str, Any], ...]):
    """Members of a JSON object, duplicates included."""

    __slots__ = ()


MAX_DEPTH = 16
MAX_VALUES = 512
"""Members and elements of a request, all levels together."""
MAX_ID_CHARACTERS = 64
MAX_SENTENCE_CHARACTERS = 400

_MAX_QUOTED_CHARACTERS = 48
_MAX_ERRORS = 3
_STRUCTURE = (b",", b"[", b"{")
_MAX_STRUCTURE = 2_048
_MEMBERS = ("jsonrpc", "id", "method", "params")
_INTEGERS = range(-(2**63), 2**64)

RequestId = str | int

_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


class Request(NamedTuple):
    """Well-formed request; `id` is None for a notification, which is not answered."""

    method: str
    params: Params
    id: RequestId | None


class RefusedRequest(NamedTuple):
    """Line that is no valid request; `is_answered` is False where it was a notification.

    Attributes:
        stop: method of `STOPS` that it names, to be carried out all the same; None where none.
    """

    error: RequestError
    id: RequestId | None
    is_answered: bool
    stop: str | None = None


class _UnreadableError(Exception):
    """Line that is no JSON, or JSON beyond the limits."""


def parse(line: bytes) -> Request | RefusedRequest:
    """Request in this line, or the error to answer with."""
    parsed = _parse(line)
    if isinstance(parsed, RefusedRequest) and (stop := stop_named(line)) is not None:
        return parsed._replace(stop=stop, is_answered=True)
    return parsed


def stop_of(request: Request | RefusedRequest) -> str | None:
    """Stop that is to be carried out for this line; None for everything else."""
    if isinstance(request, RefusedRequest):
        return request.stop
    return request.method if request.method in STOPS else None


def _parse(line: bytes) -> Request | RefusedRequest:
    try:
        message = _read(line)
    except _UnreadableError as error:
        return RefusedRequest(_error(ErrorCode.PARSE_ERROR, str(error)), None, True)
    if not isinstance(message, dict):
        what = "a batch; send one request a line" if isinstance(message, list) else "no object"
        return RefusedRequest(_error(ErrorCode.INVALID_REQUEST, f"this is {what}"), None, True)
    request_id = message.get("id")
    if not _is_id(request_id) and "id" in message:
        wrong_id = f"id must be a string of up to {MAX_ID_CHARACTERS} characters or an integer"
        return RefusedRequest(_error(ErrorCode.INVALID_REQUEST, wrong_id), None, True)
    try:
        return _request(message, request_id)
    except RequestError as error:
        is_answered = "id" in message or error.code is ErrorCode.INVALID_REQUEST
        # Without its traceback, or it would keep itself alive through the frames of the caller.
        return RefusedRequest(error.with_traceback(None), request_id, is_answered)


def result_line(request_id: RequestId, result: Mapping[str, Any]) -> bytes:
    """Line of a result; ValueError where it holds NaN or an infinity."""
    return _line({"jsonrpc": "2.0", "id": request_id, "result": result})


def error_line(request_id: RequestId | None, error: RequestError) -> bytes:
    """Line of an error; the id is null where it could not be read."""
    return _line({"jsonrpc": "2.0", "id": request_id, "error": error.as_json()})


def notification_line(method: str, params: Mapping[str, Any]) -> bytes:
    return _line({"jsonrpc": "2.0", "method": method, "params": params})


def nearest(name: str, names: Iterable[str]) -> str:
    """End of a sentence with the most similar of these names; empty without a similar one."""
    # Comparing takes time that grows with the length.
    close = nearest_word(name[:_MAX_QUOTED_CHARACTERS], names)
    return f"; the nearest is {_quoted(close)}" if close else ""


def _line(message: Mapping[str, Any]) -> bytes:
    return _encode(message).encode("ascii") + b"\n"


def _read(line: bytes) -> object:
    if sum(map(line.count, _STRUCTURE)) > _MAX_STRUCTURE:  # costs a hundredth of reading
        raise _UnreadableError("more commas and brackets than any request has")
    try:
        text = line.decode("utf-8")
        message = json.loads(text, object_pairs_hook=_object, parse_constant=_constant)
    except RecursionError:
        raise _UnreadableError(f"nested more than {MAX_DEPTH} deep") from None
    except UnicodeDecodeError as error:
        raise _UnreadableError(f"not UTF-8 at byte {error.start + 1}") from None
    except json.JSONDecodeError as error:
        what = f"not JSON at character {error.pos + 1}: {error.msg}"
        raise _UnreadableError(what) from None
    except ValueError:
        raise _UnreadableError("a number has too many digits") from None
    _check_extent(message)
    if "\\u" in text:
        _check_surrogates(message)
    return message


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        counts = Counter(name for name, _ in pairs)
        first = next(name for name, count in counts.items() if count > 1)
        raise _UnreadableError(f"duplicate key {_quoted(first)}")
    return members


def _constant(name: str) -> object:
    raise _UnreadableError(f"{name} is no number in JSON")


def _check_extent(message: object) -> None:
    """Check the number of values, their depth and the size of integers."""
    level: list[Any] = [message] if isinstance(message, (dict, list)) else []
    count = 0
    for _ in range(MAX_DEPTH):
        inner = [v for one in level for v in (one.values() if isinstance(one, dict) else one)]
        count += len(inner)
        if count > MAX_VALUES:
            raise _UnreadableError(f"more than {MAX_VALUES} values")
        if any(type(value) is int and value not in _INTEGERS for value in inner):
            raise _UnreadableError("an integer needs more than 64 bits")
        level = [value for value in inner if isinstance(value, (dict, list))]
        if not level:
            return
    raise _UnreadableError(f"nested more than {MAX_DEPTH} deep")


def _check_surrogates(message: object) -> None:
    try:
        json.dumps(message, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise _UnreadableError("half of a surrogate pair") from None


def _is_id(value: object) -> bool:
    if isinstance(value, str):
        return len(value) <= MAX_ID_CHARACTERS
    return type(value) is int


def _request(message: dict[str, Any], request_id: RequestId | None) -> Request:
    """Request from a decoded message; RequestError where it is none."""
    for name in message:
        if name not in _MEMBERS:
            what = f"there is no member {_quoted(name)} in a request{nearest(name, _MEMBERS)}"
            raise _error(ErrorCode.INVALID_REQUEST, what)
    if message.get("jsonrpc") != "2.0":
        raise _error(ErrorCode.INVALID_REQUEST, 'jsonrpc must be "2.0"')
    method = message.get("method")
    if not isinstance(method, str):
        raise _error(ErrorCode.INVALID_REQUEST, "method must be a string")
    if method not in METHODS:
        what = f"there is no method {_quoted(method)}{nearest(method, METHODS)}"
        raise _error(ErrorCode.METHOD_NOT_FOUND, what)
    return Request(method, _params(METHODS[method].params, message.get("params", {})), request_id)


def _params(model: type[Params], values: object) -> Params:
    if not isinstance(values, dict):
        raise _error(ErrorCode.INVALID_PARAMS, "params must be an object: parameters go by name")
    try:
        return model.model_validate(values)
    except ValidationError as error:
        sentence = _error_sentence(model, error)
    raise _error(ErrorCode.INVALID_PARAMS, sentence)


def _error_sentence(model: type[Params], error: ValidationError) -> str:
    """Sentence about the first few errors in the parameters."""
    found = error.errors(include_url=False, include_context=False, include_input=False)
    sentences = [_one_error(model, one) for one in found[:_MAX_ERRORS]]
    if len(found) > _MAX_ERRORS:
        sentences.append(f"and {len(found) - _MAX_ERRORS} more")
    return "; ".join(sentences)


def _one_error(model: type[Params], error: Any) -> str:
    path: Sequence[str | int] = error["loc"]
    where = _quoted(".".join(str(part) for part in path if part != "[key]"))
    if error["type"] == "missing":
        return f"{where} is missing"
    if error["type"] == "extra_forbidden":
        beside = model if len(path) == 1 else ControllerParams
        return f"there is no parameter {where}{nearest(str(path[-1]), beside.model_fields)}"
    what = re.sub("^Input ", "", error["msg"])
    return f"{where} {what}" if what.startswith("should") else f"{where}: {what}"


def _quoted(text: str) -> str:
    """Input quoted for a sentence: short, in printable ASCII."""
    if len(text) > _MAX_QUOTED_CHARACTERS:
        text = text[:_MAX_QUOTED_CHARACTERS] + "..."
    return json.dumps(text)


def _error(code: ErrorCode, sentence: str) -> RequestError:
    return RequestError(code, sentence[:MAX_SENTENCE_CHARACTERS])
