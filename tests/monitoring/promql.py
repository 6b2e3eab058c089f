"""As much of PromQL as it takes to tell which metrics and labels an expression names."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

_TOKEN = re.compile(
    r"""\s*(?:
    (?P<string>"(?:[^"\\]|\\.)*")
  | (?P<range>\[[^\]]*\])
  | (?P<number>\d[\w.]*)
  | (?P<name>[A-Za-z_:][\w:]*)
  | (?P<mark>=~|!~|!=|==|<=|>=|[-+*/%^<>=(){},@])
  )""",
    re.VERBOSE,
)
_GROUPINGS = {"by", "without", "on", "ignoring", "group_left", "group_right"}
_KEYWORDS = {"and", "or", "unless", "bool", "offset"}
_FUNCTIONS = {
    *("sum", "min", "max", "avg", "count", "topk", "sort_desc", "histogram_quantile"),
    *("rate", "increase", "changes", "resets", "absent", "time"),
}


@dataclass
class Selector:
    """One metric: its name and what its labels must be, as (operator, value)."""

    name: str
    labels: dict[str, tuple[str, str]] = field(default_factory=dict)


@dataclass
class Named:
    """What an expression names.

    Attributes:
        grouping: labels of by(...) and its like.
    """

    selectors: list[Selector] = field(default_factory=list)
    grouping: set[str] = field(default_factory=set)


def named(expression: str) -> Named:
    """The metrics and labels of an expression; ValueError where it cannot be read."""
    found, tokens = Named(), list(_tokens(expression))
    while tokens:
        kind, text = tokens.pop(0)
        following = tokens[0][1] if tokens else ""
        if kind != "name" or text in _KEYWORDS:
            continue
        if text in _GROUPINGS:
            found.grouping |= {label for kind, label in _until(tokens, ")") if kind == "name"}
        elif text in _FUNCTIONS:
            if following != "(" and following not in _GROUPINGS:
                raise ValueError(f"{text} is a function: {expression}")
        elif following == "(":
            raise ValueError(f"{text} is not a function that is known here: {expression}")
        else:
            matchers = _until(tokens, "}") if following == "{" else []
            found.selectors.append(Selector(text, _matchers(matchers)))
    return found


def _tokens(expression: str) -> Iterator[tuple[str, str]]:
    at = 0
    while expression[at:].strip():
        match = _TOKEN.match(expression, at)
        if match is None or match.lastgroup is None:
            raise ValueError(f"cannot read {expression[at:]!r} of {expression}")
        yield match.lastgroup, match.group(match.lastgroup)
        at = match.end()


def _until(tokens: list[tuple[str, str]], end: str) -> list[tuple[str, str]]:
    """Take the tokens up to this one away."""
    taken = []
    while tokens:
        token = tokens.pop(0)
        if token[1] == end:
            return taken
        taken.append(token)
    raise ValueError(f"no {end}")


def _matchers(tokens: list[tuple[str, str]]) -> dict[str, tuple[str, str]]:
    texts = [text for _, text in tokens if text not in "{,"]
    triples = zip(texts[::3], texts[1::3], texts[2::3], strict=True)
    return {label: (operator, value[1:-1]) for label, operator, value in triples}
