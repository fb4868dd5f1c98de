"""The house keeps its shape: imports go one way, and plugins stand alone."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
import tomllib
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


PLUGIN_FILES = sorted((ROOT / "stereogs_plugins").rglob("*.py"))
FACES = {
    "core_rasterizer",
    "core_rasterizer.matching",
    "registry",
    "registry.confidence",
    "registry.events",
    "registry.priors",
    "registry.runners",
    "registry.runs",
    "registry.toolkit",
    "registry.toolkit.cache",
    "registry.toolkit.drawing",
    "registry.toolkit.images",
    "registry.toolkit.networks",
    "registry.toolkit.networks.image_fitting",
    "registry.toolkit.photos",
    "registry.toolkit.progress",
    "registry.toolkit.views",
    "registry.toolkit.views.virtual_views",
    "registry.toolkit.web_page",
}
"""Modules whose public names plugins may import."""


TEST_FILES = sorted((ROOT / "tests").rglob("*.py"))
TEST_FACES = {
    *FACES,
    *("core_rasterizer.device", "registry.testing", "stereogs", "stereogs.api", "stereogs.testing"),
}
"""Modules that all tests may import from, beside those of components, `stereogs_plugins.KIND.NAME`."""
SUBJECT = re.compile(r"Tests of `([\w.]+)`.*, which import its modules\.")
"""How a file of tests, or the `__init__.py` of its folder, says whose modules it may import too."""


def subjects(file: Path) -> set[str]:
    """The packages that a file of tests or a folder that it is in names as its subject."""
    folders = [parent for parent in file.parents if ROOT in parent.parents]
    files = [file, *(folder / "__init__.py" for folder in folders)]
    return {name for f in files if f.exists() for name in SUBJECT.findall(f.read_text("utf-8"))}


@pytest.mark.parametrize("file", TEST_FILES, ids=label)
def test_tests_go_through_the_front_door(file: Path) -> None:
    """What is neither public nor of the tests' own subject comes from `tests/host.py`."""
    if file == ROOT / "tests" / "host.py":
        return
    own = tuple(subjects(file))
    for name in imports(file):
        top, _, rest = name.partition(".")
        if not rest or top not in (*MAY_IMPORT, "benchmarks"):
            continue
        module = name if is_module(name) else name.rpartition(".")[0]
        component = top == "stereogs_plugins" and module.count(".") <= 2
        ours = any(f"{module}.".startswith(f"{subject}.") for subject in own)
        assert module in TEST_FACES or component or ours, f"{label(file)} imports {name}"


def test_no_tests_have_the_whole_host_as_their_subject() -> None:
    all_subjects = {name for file in TEST_FILES for name in subjects(file)}
    assert not all_subjects & {"registry", "stereogs", "stereogs_plugins"}


def is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def plugin_of(file: Path) -> str:
    """The plugin that a file belongs to: `stereogs_plugins.HOOK_POINT.NAME`, a file or a folder."""
    return ".".join(file.relative_to(ROOT).with_suffix("").parts[:3])


@pytest.mark.parametrize("file", PLUGIN_FILES, ids=label)
def test_plugins_use_public_names_and_no_other_plugin(file: Path) -> None:
    for name in imports(file):
        top, own = name.split(".")[0], plugin_of(file)
        if top == "stereogs_plugins":
            assert f"{name}.".startswith(f"{own}."), f"{label(file)} reaches into {name}"
        elif top in ("registry", "core_rasterizer"):
            face, _, member = name.rpartition(".")
            public = name in FACES or (face in FACES and member in exported(face))
            assert public, f"{label(file)} imports {name}, which is not public"


def test_helpers_live_with_their_plugin() -> None:
    """In a plugin's own folder; what two plugins share, the host offers under a public name."""
    strangers = [label(f) for f in PLUGIN_FILES if f.name != "__init__.py" and f.name[0] == "_"]
    assert strangers == []


def test_every_plugin_is_an_entry_point() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    modules = set(project["entry-points"]["stereogs.plugins"].values())
    entries = {".".join(module.split(".")[:3]) for module in modules}
    plugins = {plugin_of(file) for file in PLUGIN_FILES}
    assert entries == {name for name in plugins if not name.endswith("__init__")}


def exported(module: str) -> set[str]:
    """The public names of a module."""
    return set(importlib.import_module(module).__all__)


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
    made_here = ROOT / "benchmarks" / "out"
    files = [file for file in files if made_here not in file.parents]
    guilty = [
        label(file)
        for file in files
        if file != Path(__file__) and any(p in file.read_text("utf-8") for p in places)
    ]
    assert guilty == []


def module_graph(package: str) -> dict[str, set[str]]:
    """Modules of a package and the modules of it that each imports, anywhere in its file.

    Lazy facades, packages that import only under TYPE_CHECKING to re-export, have no edges.
    """
    files = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file
        for file in FILES
        if file.relative_to(ROOT).parts[0] == package
    }
    return {
        module: set()
        if "names_on_first_use(__name__)" in file.read_text("utf-8")
        else {name for name in imports(file) if name in files and name != module}
        for module, file in files.items()
    }


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components of more than one module."""
    reached = {module: {module} for module in graph}
    for start, found in reached.items():
        pending = [start]
        while pending:
            new = graph[pending.pop()] - found
            found |= new
            pending += new
    groups = {tuple(sorted(b for b in reached[a] if a in reached[b])) for a in reached}
    return sorted(list(group) for group in groups if len(group) > 1)


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_have_no_cycle(package: str) -> None:
    assert cycles(module_graph(package)) == []


MAX_MODULES = 12
"""Modules in one folder, at most: more are hard to survey."""

LAYERS = (
    ("errors", "messages"),
    ("system",),
    ("contract",),
    ("calls",),
    ("toolkit", "discovery"),
    ("priors", "pipeline"),
    ("training",),
    ("runs",),
    ("testing",),
)
"""Packages of `registry`, lowest first: each imports from lower layers only."""
WITHIN = {
    "confidence": "contract",
    "events": "contract",
    "recognition": "pipeline",
    "runners": "contract",
}
"""Modules of `registry` that belong to the layer of a package."""


def test_every_package_of_the_host_has_a_layer() -> None:
    packages = {name.split(".")[1] for name in module_graph("registry") if "." in name}
    assert packages - WITHIN.keys() == {package for layer in LAYERS for package in layer}


def test_imports_of_the_host_go_to_lower_layers() -> None:
    layer_of = {package: number for number, layer in enumerate(LAYERS) for package in layer}
    for name, others in module_graph("registry").items():
        for other in others:
            if "." in name and "." in other:
                upper, lower = (WITHIN.get(m, m) for m in (name.split(".")[1], other.split(".")[1]))
                allowed = upper == lower or layer_of[lower] < layer_of[upper]
                assert allowed, f"{name} imports {other}"


@pytest.mark.parametrize("package", ["core_rasterizer", "registry", "stereogs", "stereogs_plugins"])
def test_no_folder_has_too_many_modules(package: str) -> None:
    for folder in sorted({file.parent for file in (ROOT / package).rglob("*.py")}):
        modules = [file for file in folder.glob("*.py") if file.name != "__init__.py"]
        assert len(modules) <= MAX_MODULES, folder
