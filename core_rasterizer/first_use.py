"""Lazy imports for packages: a module is imported when one of its names is first used (PEP 562).

    if TYPE_CHECKING:
        from .camera import Camera
    else:
        __getattr__, __dir__ = names_on_first_use(__name__)

Type checkers and readers see plain imports; at run time they are parsed, not executed. A name must not
be that of a module of the package, because importing the module would replace it.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable, Iterator
from importlib.util import resolve_name
from typing import Any


def names_on_first_use(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` for a package that imports only under `if TYPE_CHECKING:`.

    Args:
        package: dotted name of a package whose source is installed, as in every wheel.
    """
    targets = dict(_targets(package))

    def get(name: str) -> Any:
        if name not in targets:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, original = targets[name]
        if module == package:  # `from . import module`
            return importlib.import_module(f"{package}.{original}")
        value = getattr(importlib.import_module(module), original)
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *targets})

    return get, names


def _targets(package: str) -> Iterator[tuple[str, tuple[str, str]]]:
    """Each name with its module and its name in that module."""
    spec: Any = sys.modules[package].__spec__
    source = spec.loader.get_source(package)
    for node in ast.parse(source).body:
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            continue
        for statement in node.body:
            if isinstance(statement, ast.ImportFrom):
                module = resolve_name("." * statement.level + (statement.module or ""), spec.parent)
                for alias in statement.names:
                    yield alias.asname or alias.name, (module, alias.name)
