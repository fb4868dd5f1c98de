"""The page for plugin authors is complete, and its example package works as a stranger's would."""

from __future__ import annotations

import importlib.metadata
import inspect
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import registry
from registry.contract import hooks
from registry.contract.hook_points import HOOK_POINTS
from registry.plugins import Plugins
from registry.testing import check

from .conftest import Install

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "plugin-authors.md").read_text("utf-8")
EXAMPLE = DOCS / "examples" / "stereogs-flat-initializer"
HOOKS = {
    name: function
    for name, function in vars(hooks).items()
    if name.startswith("stereogs_register_")
}


@pytest.mark.parametrize("name", HOOKS)
def test_every_hook_is_documented_with_its_arguments(name: str) -> None:
    arguments = ", ".join(inspect.signature(HOOKS[name]).parameters)
    assert f"`{name}({arguments})`" in PAGE


def test_the_page_documents_no_other_hook() -> None:
    assert set(re.findall(r"stereogs_register_\w+", PAGE)) == set(HOOKS)


def test_every_hook_has_a_hook_point() -> None:
    assert {point.hook for point in HOOK_POINTS} == set(HOOKS)


@pytest.mark.parametrize("point", HOOK_POINTS, ids=lambda point: point.section)
def test_every_hook_point_is_documented(point: registry.hook_points.HookPoint) -> None:
    row = next(line for line in PAGE.splitlines() if f"`{point.hook}(" in line)
    assert f"`{point.base.__name__}`" in row
    (method,) = point.base.__abstractmethods__ or {""}
    if method:
        arguments = list(inspect.signature(getattr(point.base, method)).parameters)[1:]
        assert f"`{method}({', '.join(arguments)})" in row
    for name in point.host_settings:
        assert f"`{name}`" in PAGE


def test_the_page_names_only_what_there_is() -> None:
    for name in set(re.findall(r"registry\.([A-Za-z_]+)", PAGE)) - {"testing"}:
        assert hasattr(registry, name), name


def test_the_pages_example_keeps_the_contract() -> None:
    source = re.search(r"```py\n(   import registry.*?)```", PAGE, re.DOTALL)
    assert source is not None
    scope: dict[str, object] = {}
    exec(inspect.cleandoc("\n" + source[1]), scope)
    check(scope["Solid"], target=0.9)  # type: ignore[arg-type]


def test_the_example_package_is_found_through_its_entry_point(install: Install) -> None:
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text("utf-8"))["project"]
    entries = project["entry-points"]["stereogs.plugins"]
    modules = {module: (EXAMPLE / f"{module}.py").read_text("utf-8") for module in entries.values()}
    install(project["name"].replace("-", "_"), project["version"], entries, **modules)
    assert importlib.metadata.version(project["name"]) == project["version"]
    initializers = next(point for point in HOOK_POINTS if point.section == "initializer")
    offer = Plugins().find(initializers, "flat")
    assert offer.plugin == "flat"
    check(offer.component, points_per_view=20)


def test_the_example_packages_own_tests_pass() -> None:
    root = DOCS.parent
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(EXAMPLE)],
        cwd=EXAMPLE,
        env={
            "PYTHONPATH": f"{root}:{EXAMPLE}",
            "PATH": "",
            "PYTHONDONTWRITEBYTECODE": "1",
            "OMP_NUM_THREADS": "1",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
