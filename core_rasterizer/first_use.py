"""Lazy imports for packages: a module is imported when one of its names is first used (PEP 562).

    if TYPE_CHECKING:
        from .camera import Camera as Camera
    else:
        __all__, __dir__, __getattr__ = names_on_first_use(__name__)

Type checkers read `Camera as Camera` as a re-export; at run time the imports are parsed, not executed. A name
must not be that of a module of the package, because importing the module would replace it.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable, Iterator
from importlib.util import resolve_name
from typing import Any

LazyNames = tuple[list[str], Callable[[], list[str]], Callable[[str], Any]]


def names_on_first_use(package: str) -> LazyNames:
    """Return `__all__`, `__dir__` and `__getattr__` of a package that imports under `if TYPE_CHECKING:`.

    Args:
        package: dotted name of a package or module whose source is installed, as in every wheel.
    """
    spec: Any = sys.modules[package].__spec__
    targets = dict(_targets(spec.loader.get_source(package), spec.parent))

    def get(name: str) -> Any:
        if name not in targets:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, original = targets[name]
        value = getattr(importlib.import_module(module), original)
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *targets})

    return sorted(targets), names, get


def _targets(source: str, package: str) -> Iterator[tuple[str, tuple[str, str]]]:
    """Each name with its module and its name in that module."""
    for node in ast.parse(source).body:
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            continue
        for statement in node.body:
            if isinstance(statement, ast.ImportFrom):
                module = resolve_name("." * statement.level + (statement.module or ""), package)
                for alias in statement.names:
                    yield alias.asname or alias.name, (module, alias.name)
