"""The house keeps its shape: imports go one way, and plugins stand alone."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MAY_IMPORT = {
    "core_rasterizer": {"core_rasterizer"},
    "registry": {"registry", "core_rasterizer"},
    "stereogs": {"stereogs", "registry", "core_rasterizer"},
    "stereogs_plugins": {"stereogs_plugins", "registry", "core_rasterizer"},
}
FILES = [file for package in MAY_IMPORT for file in sorted((ROOT / package).rglob("*.py"))]


def imports(file: Path) -> Iterator[str]:
    """Absolute names of all modules that a file imports, anywhere in it."""
    package = file.relative_to(ROOT).parent.parts
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            name = ".".join([*base, *([node.module] if node.module else [])])
            yield name
            yield from (f"{name}.{alias.name}" for alias in node.names)


def label(file: Path) -> str:
    return str(file.relative_to(ROOT))


@pytest.mark.parametrize("file", FILES, ids=label)
def test_imports_go_one_way(file: Path) -> None:
    package = file.relative_to(ROOT).parts[0]
    ours = {name.split(".")[0] for name in imports(file)} & set(MAY_IMPORT)
    assert ours <= MAY_IMPORT[package]


PLUGINS = [
    file
    for file in sorted((ROOT / "stereogs_plugins").rglob("*.py"))
    if not file.name.startswith("_")
]


@pytest.mark.parametrize("file", PLUGINS, ids=label)
def test_plugins_use_the_public_api_and_no_other_plugin(file: Path) -> None:
    folder = ".".join(file.relative_to(ROOT).parent.parts)
    helpers = (f"{folder}._",)
    for name in imports(file):
        top = name.split(".")[0]
        if top == "stereogs_plugins":
            assert name == folder or name.startswith(helpers), f"{label(file)} imports {name}"
        elif top in ("registry", "core_rasterizer"):
            assert not any(part.startswith("_") for part in name.split("."))
            modules = {path.stem for path in (ROOT / top).glob("*.py")} - {"reference"}
            parts = name.split(".")
            public = len(parts) == 1 or parts[1] not in modules or parts[1] in exported(top)
            assert public, f"{label(file)} reaches into {name}"


def exported(package: str) -> set[str]:
    """What a package offers in its `__all__`."""
    tree = ast.parse((ROOT / package / "__init__.py").read_text("utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    raise AssertionError(f"{package} has no __all__")


def test_each_package_can_be_imported_alone() -> None:
    for package, allowed in MAY_IMPORT.items():
        others = set(MAY_IMPORT) - allowed
        code = f"import sys, {package}; print(*(set(sys.modules) & {others!r}))"
        result = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
        )
        assert result.stdout.strip() == ""


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    places = tuple(f"/{name}/" for name in ("work", "home", "root", "Users", "tmp"))
    kinds = {".py", ".md", ".toml", ".yaml", ".cl", ".txt"}
    folders = [*MAY_IMPORT, "docs", "tests", "pipelines", "benchmarks"]
    files = [f for folder in folders for f in (ROOT / folder).rglob("*") if f.suffix in kinds]
    files += [file for file in ROOT.iterdir() if file.suffix in kinds]
    guilty = [
        label(file)
        for file in files
        if file != Path(__file__) and any(p in file.read_text("utf-8") for p in places)
    ]
    assert guilty == []
