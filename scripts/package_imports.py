"""Imports between the packages of vcu_gateway in a source tree; used by scripts beside this one.

A package is a folder below vcu_gateway, or a module beside those folders; the root is left out.
"""

import importlib
import sys
from pathlib import Path

import grimp

ROOT = "vcu_gateway"

Edges = set[tuple[str, str]]
"""(importer, imported) by package."""


def graph_of(tree: Path) -> grimp.ImportGraph:
    """All imports between modules below TREE/src/vcu_gateway."""
    sys.path.insert(0, str(tree / "src"))
    importlib.invalidate_caches()
    try:
        return grimp.build_graph(ROOT, cache_dir=None)
    finally:
        del sys.path[0]


def package_edges(graph: grimp.ImportGraph) -> Edges:
    """Imports from one package to another."""
    pairs = {
        (package_of(importer), package_of(imported))
        for importer in graph.modules
        for imported in graph.find_modules_directly_imported_by(importer)
    }
    return {(one, other) for one, other in pairs if one and other and one != other}


def package_of(module: str) -> str:
    """`bus` of `vcu_gateway.bus.reader`; empty for the root."""
    return module.partition(".")[2].partition(".")[0]


def reached(edges: Edges) -> dict[str, set[str]]:
    """Every package that each importer imports, directly or over others."""
    found = {one: {other for start, other in edges if start == one} for one, _ in edges}
    for _ in found:
        for others in found.values():
            others.update(*(found.get(other, set()) for other in list(others)))
    return found


def cycles(edges: Edges) -> set[frozenset[str]]:
    """Sets of packages that import each other."""
    below = reached(edges)
    found = (
        frozenset(other for other in others if one in below.get(other, set()))
        for one, others in below.items()
    )
    return {cycle for cycle in found if cycle}


def reduced(edges: Edges) -> Edges:
    """Edges without those that others imply; ValueError where there is a cycle."""
    if cycles(edges):
        raise ValueError(f"packages import each other: {sorted(map(sorted, cycles(edges)))}")
    below = reached(edges)
    return {
        (one, other)
        for one, other in edges
        if not any(other in below.get(step, set()) for start, step in edges if start == one)
    }
