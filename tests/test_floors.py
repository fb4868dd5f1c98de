"""The host's rooms stand on floors: every import goes down, within each folder too."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MOST_ROOMS = 12
"""Modules that one folder may hold before a newcomer loses the way."""

FLOORS = (
    ("errors", "messages"),
    ("system",),
    ("contract", "calls"),
    ("toolkit", "plugins"),
    ("priors", "pipeline"),
    ("training", "inspection"),
    ("runs",),
    ("session", "testing"),
    ("commands",),
    ("cli",),
    ("__main__",),
)
"""The packages of `registry`, lowest first: each imports from lower rows only."""
WITHIN = {"events": "contract", "runners": "contract"}
"""Modules of `registry` that belong to a package."""


def modules(package: str) -> dict[str, Path]:
    """Every module of a package by its dotted name; a folder's `__init__` counts as the folder."""
    found = {}
    for file in sorted((ROOT / package).rglob("*.py")):
        parts = file.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imported(name: str, file: Path, known: dict[str, Path]) -> Iterator[str]:
    """The modules among `known` that one of them imports, anywhere but for its types alone."""
    package = name.split(".") if file.name == "__init__.py" else name.split(".")[:-1]
    tree = ast.parse(file.read_text("utf-8"))
    types_only = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or node in types_only:
            continue
        base = package[: len(package) - node.level + 1] if node.level else []
        source = ".".join([*base, *([node.module] if node.module else [])])
        names = {f"{source}.{alias.name}" for alias in node.names}
        yield from sorted((names & known.keys()) or ({source} & known.keys()))


def arrows(package: str) -> dict[str, set[str]]:
    """Which module imports which."""
    known = modules(package)
    return {name: set(imported(name, file, known)) - {name} for name, file in known.items()}


@pytest.mark.parametrize("package", ["core_rasterizer", "registry", "stereogs_plugins"])
def test_no_module_imports_itself_through_others(package: str) -> None:
    graph = arrows(package)
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join([*path[path.index(name) :], name])
        if name not in done:
            for other in sorted(graph[name]):
                visit(other, (*path, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_every_room_of_the_host_has_a_floor() -> None:
    rooms = {name.split(".")[1] for name in modules("registry") if "." in name}
    assert rooms - WITHIN.keys() == {room for floor in FLOORS for room in floor}


def test_imports_of_the_host_go_down() -> None:
    height = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
    for name, others in arrows("registry").items():
        parts = name.split(".")
        for other in sorted(others):
            below = other.split(".")
            if len(parts) == 1 or len(below) == 1:
                continue
            upper, lower = (WITHIN.get(part[1], part[1]) for part in (parts, below))
            assert upper == lower or height[lower] < height[upper], f"{name} imports {other}"


@pytest.mark.parametrize("package", ["core_rasterizer", "registry", "stereogs_plugins"])
def test_no_folder_is_a_heap(package: str) -> None:
    held: dict[str, set[str]] = {}
    for name, file in modules(package).items():
        if file.name != "__init__.py":
            folder, _, room = name.rpartition(".")
            held.setdefault(folder, set()).add(room)
    crowded = {folder: sorted(rooms) for folder, rooms in held.items() if len(rooms) > MOST_ROOMS}
    assert crowded == {}
