"""Small mistakes, made on purpose: every mutant of a module, one change each.

Module-level constants and tables are mutated too: the core's limits and transitions are there.
"""

import ast
import copy
import difflib
from collections.abc import Callable, Iterator, Set
from typing import Any, NamedTuple

_COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_ARITHMETIC = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.BitXor: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_CALLS = {"min": "max", "max": "min", "all": "any", "any": "all"}
_TYPES = ("Rule", "Asked", "ControllerDemands", "__slots__")
_REMOVABLE = (ast.Expr, ast.AugAssign, ast.Raise, ast.Continue, ast.Delete)


class Mutant(NamedTuple):
    """One changed module.

    key: where and what, without line numbers, so that it survives edits elsewhere.
    """

    key: str
    line: int
    source: str
    diff: str


class _Change(NamedTuple):
    """Replace the child at `field` (and `index` in a list) of a node; None removes it."""

    path: tuple[tuple[str, int | None], ...]
    replacement: ast.AST | None
    line: int
    scope: str


def mutants(source: str, scopes: Set[str] | None = None) -> Iterator[Mutant]:
    """Every mutant of this source, each of which differs from it; of these scopes alone."""
    tree = ast.parse(source)
    original = ast.unparse(tree)
    seen = set()
    for change in _changes(tree, (), "module", 1):
        if scopes is not None and change.scope not in scopes:
            continue
        text = ast.unparse(_changed(tree, change.path, change.replacement))
        if text == original or text in seen:
            continue
        seen.add(text)
        yield _described(original, text, change)


def _described(original: str, text: str, change: _Change) -> Mutant:
    lines = list(difflib.ndiff(original.splitlines(), text.splitlines()))
    before = " ".join(line[2:].strip() for line in lines if line.startswith("- "))
    after = " ".join(line[2:].strip() for line in lines if line.startswith("+ "))
    diff = f"-{before}\n+{after}"
    return Mutant(f"{change.scope}: {before} => {after}", change.line, text, diff)


def _changed(node: ast.AST, path: tuple, replacement: ast.AST | None) -> ast.AST:
    """This tree with the child at `path` replaced; it shares all that is beside the path."""
    (field, index), *rest = path
    below = getattr(node, field)
    old = below if index is None else below[index]
    new = _changed(old, tuple(rest), replacement) if rest else replacement
    changed = copy.copy(node)
    if index is None:
        setattr(changed, field, new)
    else:
        kept = [] if new is None else [new]
        setattr(changed, field, [*below[:index], *kept, *below[index + 1 :]])
    return changed


def _changes(node: ast.AST, path: tuple, scope: str, line: int) -> Iterator[_Change]:
    line = getattr(node, "lineno", line)
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        scope = node.name if scope == "module" else f"{scope}.{node.name}"
    if path:
        for replacement in _replacements(node):
            yield _Change(path, replacement, line, scope)
        yield from _removals(node, path, scope, line)
    for field, index, child in _children(node):
        yield from _changes(child, (*path, (field, index)), scope, line)


def _children(node: ast.AST) -> Iterator[tuple[str, int | None, ast.AST]]:
    """All but annotations, imports and docstrings."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        if isinstance(value, list):
            for index, child in enumerate(value):
                if isinstance(child, ast.AST) and not _is_fixed(child):
                    yield field, index, child
        elif isinstance(value, ast.AST):
            yield field, None, value


def _is_fixed(node: ast.AST) -> bool:
    if isinstance(node, ast.Import | ast.ImportFrom):
        return True
    if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in _TYPES:
        return True
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _removals(node: ast.AST, path: tuple, scope: str, line: int) -> Iterator[_Change]:
    stored = isinstance(node, ast.Assign) and not isinstance(node.targets[0], ast.Name | ast.Tuple)
    if isinstance(node, _REMOVABLE) or stored:
        yield _Change(path, ast.Pass(), line, scope)


def _replacements(node: ast.AST) -> Iterator[ast.AST]:
    kind = type(node)
    if kind in _BY_KIND:
        yield from _BY_KIND[kind](node)


def _compare(node: ast.Compare) -> Iterator[ast.AST]:
    for index, operator in enumerate(node.ops):
        for other in _COMPARISONS[type(operator)]:
            ops = [other() if i == index else op for i, op in enumerate(node.ops)]
            yield ast.Compare(node.left, ops, node.comparators)


def _arithmetic(node: ast.BinOp) -> Iterator[ast.AST]:
    if type(node.op) in _ARITHMETIC:
        yield ast.BinOp(node.left, _ARITHMETIC[type(node.op)](), node.right)


def _boolean(node: ast.BoolOp) -> Iterator[ast.AST]:
    yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    for index in range(len(node.values)):
        rest = node.values[:index] + node.values[index + 1 :]
        yield rest[0] if len(rest) == 1 else ast.BoolOp(node.op, rest)


def _unary(node: ast.UnaryOp) -> Iterator[ast.AST]:
    yield node.operand


def _constant(node: ast.Constant) -> Iterator[ast.AST]:
    if isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node.value, int | float):
        yield ast.Constant(node.value + 1)
        yield ast.Constant(node.value - 1)


def _returned(node: ast.Return) -> Iterator[ast.AST]:
    """Nothing instead of something; constants are changed as constants."""
    if node.value is not None and not isinstance(node.value, ast.Constant):
        yield ast.Return(ast.Constant(None))
        yield ast.Return(ast.Constant(True))


def _tested(node: ast.If | ast.IfExp) -> Iterator[ast.AST]:
    for test in (ast.Constant(True), ast.Constant(False)):
        changed = copy.copy(node)
        changed.test = test
        yield changed


def _call(node: ast.Call) -> Iterator[ast.AST]:
    if isinstance(node.func, ast.Name) and node.func.id in _CALLS:
        yield ast.Call(ast.Name(_CALLS[node.func.id], ast.Load()), node.args, node.keywords)


def _sequence(node: ast.Tuple) -> Iterator[ast.AST]:
    """An entry of a table left out, or replaced by another one of the same table."""
    names = [one for one in node.elts if isinstance(one, ast.Name | ast.Attribute)]
    if len(names) != len(node.elts) or not isinstance(node.ctx, ast.Load):
        return
    for index, one in enumerate(node.elts):
        yield ast.Tuple([*node.elts[:index], *node.elts[index + 1 :]], node.ctx)
        others = (other for other in names if ast.dump(other) != ast.dump(one))
        if other := next(others, None):
            yield ast.Tuple([*node.elts[:index], other, *node.elts[index + 1 :]], node.ctx)


_BY_KIND: dict[type[ast.AST], Callable[[Any], Iterator[ast.AST]]] = {
    ast.Compare: _compare,
    ast.BinOp: _arithmetic,
    ast.BoolOp: _boolean,
    ast.UnaryOp: _unary,
    ast.Constant: _constant,
    ast.Return: _returned,
    ast.If: _tested,
    ast.IfExp: _tested,
    ast.Call: _call,
    ast.Tuple: _sequence,
}
