"""Imports of `registry.toolkit`: layers below it only, and no cycles."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "registry" / "toolkit"
ALLOWED = ("calls", "confidence", "contract", "errors", "messages", "system", "toolkit")


def name_of(file: Path) -> str:
    """Dotted name of a module; the name of the package for its `__init__.py`."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(file): file for file in sorted(FOLDER.rglob("*.py"))}


def imported(name: str) -> Iterator[str]:
    """Absolute names that a module imports anywhere, including inside functions and TYPE_CHECKING."""
    file = MODULES[name]
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = resolve_name("." * node.level + (node.module or ""), package)
            yield from (f"{origin}.{alias.name}" for alias in node.names)


def module_of(name: str) -> str:
    """The module of the toolkit that defines an imported name; empty for names from elsewhere."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name


@pytest.mark.parametrize("name", MODULES)
def test_a_module_imports_lower_layers_only(name: str) -> None:
    for other in imported(name):
        package, *rest = other.split(".")
        assert package not in ("stereogs", "stereogs_plugins"), f"{name} imports {other}"
        assert package != "registry" or rest[0] in ALLOWED, f"{name} imports {other}"


def test_modules_do_not_import_each_other_in_a_cycle() -> None:
    graph = {name: {*map(module_of, imported(name))} - {name, ""} for name in MODULES}
    TopologicalSorter(graph).prepare()


def test_folders_do_not_import_each_other_in_a_cycle() -> None:
    def folder(name: str) -> str:
        return ".".join(name.split(".")[:3])

    graph: dict[str, set[str]] = {}
    for name in MODULES:
        others = {folder(module_of(other)) for other in imported(name)}
        graph.setdefault(folder(name), set()).update(others - {folder(name), "registry", ""})
    TopologicalSorter(graph).prepare()


def test_a_folder_has_at_most_twelve_modules() -> None:
    for folder in {file.parent for file in MODULES.values()}:
        assert len(list(folder.glob("*.py"))) <= 12, folder.name
