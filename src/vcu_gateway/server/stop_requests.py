"""Requests to stop the vehicle: which they are, also malformed, and what they overtake."""

import json
from typing import Any

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
