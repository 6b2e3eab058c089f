"""Changes to a module at the moment when it is imported, by whomever.

Importing it early would do: but what a program imports first decides what else it imports, and so
its start and its memory.
"""

import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

Change = Callable[[dict[str, Any]], None]


def change(name: str, by: Change) -> None:
    """Call this with the names of a module once it is imported, or now where it is already."""
    if name in sys.modules:
        by(vars(sys.modules[name]))
    else:
        sys.meta_path.insert(0, _ChangingFinder(name, by))


class _ChangingFinder:
    """Finds one module, and changes it right after it was loaded."""

    def __init__(self, name: str, by: Change) -> None:
        self._name = name
        self._change = by

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name != self._name:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_change(module: ModuleType) -> None:
                load(module)
                self._change(vars(module))

            vars(spec.loader)["exec_module"] = load_and_change
        return spec
