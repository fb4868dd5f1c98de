"""The page for plugin authors is complete."""

from __future__ import annotations

import dataclasses
import inspect
import re
from pathlib import Path

import pytest

import core_rasterizer
import registry
from registry.contract.hook_points import HOOK_POINTS, OTHER_HOOKS, HookPoint
from registry.testing import check

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "plugin-authors.md").read_text("utf-8")
HOOKS = (*(point.hook for point in HOOK_POINTS), *OTHER_HOOKS)


@pytest.mark.parametrize("name", HOOKS)
def test_every_hook_is_documented_with_its_arguments(name: str) -> None:
    assert f"`{name}(register)`" in PAGE


def test_the_page_documents_no_other_hook() -> None:
    assert set(re.findall(r"stereogs_register_\w+", PAGE)) == set(HOOKS)


@pytest.mark.parametrize("point", HOOK_POINTS, ids=lambda point: point.section)
def test_every_hook_point_is_documented(point: HookPoint) -> None:
    row = next(line for line in PAGE.splitlines() if f"`{point.hook}(" in line)
    assert f"`{point.base.__name__}`" in row
    (method,) = getattr(point.base, "__abstractmethods__", None) or {""}
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


EDITS = PAGE.partition("## Edits")[2].partition("## ")[0]
ROWS = [
    line
    for line in PAGE.partition("## What you are given, and what you answer")[2].splitlines()
    if line.startswith("| `")
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("`")[1])
def test_the_page_names_every_field(row: str) -> None:
    name, of_engine = row.split("`")[1], row.split("|")[1].strip().endswith("*")
    fields = dataclasses.fields(getattr(core_rasterizer if of_engine else registry, name))
    whole = [other for other in ROWS if other.startswith(f"| `{name.removeprefix('Training')}`")]
    page = row + (EDITS if name == "Edit" else "") + ("the same" in row) * whole[0]
    told = {*re.findall(r"\w+", page), "coverage"}  # what `visible` is read from, nobody else's
    assert {field.name for field in fields if not field.name.startswith("_")} <= told
